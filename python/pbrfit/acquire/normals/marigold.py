"""Normals by Marigold (Ke et al. 2024 and 2025), through diffusers.

`MarigoldNormalsPipeline` of diffusers 0.42 gives X right, Y up and Z towards the observer (stated
in `MarigoldImageProcessor.visualize_normals`), which is our camera space. It pads a picture right
and below to whole blocks and cuts that off again, so pixels stay where they are at any size.

Scaling to the network's resolution and back, and the ensemble, are done here, because the pipeline
does both in the network's precision. In bfloat16 its scaling is missing on the processor, the
smallest angle whose cosine is not 1 is 5 degrees; and of several normals it keeps the one nearest
to the mean, not the mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire import weights
from pbrfit.acquire.padding import resized, resized_srgb8
from pbrfit.model.depth_normals import FACING

MODEL = "prs-eth/marigold-normals-v1-1"

ENSEMBLE = 5

UNCERTAINTY_ENSEMBLE_MIN = 3
"""Predictions below which their spread is not worth using."""

WHAT = "Marigold (normals)"

Array = NDArray[np.float64]


def from_picture(
    srgb8: NDArray[np.uint8],
    *,
    model: str = MODEL,
    ensemble: int = ENSEMBLE,
    steps: int | None = None,
    resolution: int | None = None,
    seed: int = 0,
    device: str = "auto",
    dtype: str = "auto",
    offload: str = "none",
    progress: Callable[[], Any] = lambda: None,
) -> tuple[Array, Array | None, dict[str, Any]]:
    """Estimate normals of one picture.

    `model` is a name on the Hugging Face Hub or a local folder; `device`, `dtype` and `offload` are
    as for `pbrfit.acquire.weights.placement`. The answer is the mean of `ensemble` predictions,
    from seeds `seed`, `seed` + 1, ...; `progress` is called after each. `steps` of denoising, and
    the longer side in pixels (`resolution`) at which the network sees the picture (0 = that of the
    picture), are as the model recommends where they are None. Returns normals: (H, W, 3) unit
    vectors in camera space; uncertainty: (H, W) degrees, see `mean_and_spread`; None for an
    ensemble below 3; record: how they were made, as JSON. Raises InputError if a package or the
    weights are missing, an option cannot be used, or memory runs out.
    """
    weights.need("diffusion", "torch", "diffusers", "transformers", "accelerate")
    import torch
    from diffusers import MarigoldNormalsPipeline
    from PIL import Image

    where = weights.placement(device, dtype, offload, what=WHAT, half="float16")
    loader = partial(MarigoldNormalsPipeline.from_pretrained, dtype=where.torch_dtype)
    loaded = weights.load(WHAT, model, loader=loader, marker="model_index.json")
    pipeline = loaded.network
    weights.place(pipeline, where, what=WHAT)
    pipeline.set_progress_bar_config(disable=True)
    if resolution is None:
        resolution = int(pipeline.default_processing_resolution)
    height, width = srgb8.shape[:2]
    seen = Image.fromarray(resized_srgb8(srgb8, seen_size((height, width), resolution)))
    members = []
    with weights.memory_in_words(WHAT, "a smaller --resolution, --offload model, --dtype float16"):
        for i in range(ensemble):
            found = pipeline(
                seen,
                num_inference_steps=steps,
                processing_resolution=0,
                # On the processor, so that a seed means the same everywhere.
                generator=torch.Generator("cpu").manual_seed(seed + i),
            )
            members.append(found.prediction[0].astype(np.float64))
            progress()
    normals, spread = at_size(*mean_and_spread(members), (height, width))
    record = {
        "model": model,
        "revision": loaded.record["revision"],
        "ensemble": ensemble,
        "steps": steps or pipeline.default_denoising_steps,
        "resolution": resolution,
        "seed": seed,
        "device": where.device,
        "dtype": where.dtype,
        "packages": weights.versions("diffusers", "transformers", "torch"),
    }
    return normals, spread if ensemble >= UNCERTAINTY_ENSEMBLE_MIN else None, record


def mean_and_spread(members: Sequence[Array]) -> tuple[Array, Array]:
    """Mean direction of unit vectors, and how far a single one is off.

    For members n_i that scatter about a direction by small angles, the mean m = Σ n_i / |Σ n_i| is
    the direction with the least Σ θ_i², θ_i the angle between n_i and m. Two of the 2E degrees of
    freedom went into m, so

        σ² = Σ θ_i² / (E - 1)

    is the mean square angle between one member and the direction that all scatter about. It says
    how much the network's answers depend on the noise that it started from; an error that all
    members share is not in it. The mean is itself off by σ/√E on top of that. Returns mean: (H, W,
    3) unit vectors; (0, 0, 1) where the members cancel; spread: (H, W) σ in degrees; 0 of a single
    member.
    """
    total = np.zeros_like(members[0])
    for member in members:
        total += member
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    mean = np.where(length > 1e-6 * len(members), total / np.maximum(length, 1e-12), FACING)
    squares = np.zeros(mean.shape[:2])
    for member in members:
        # arccos of n·m would lose half of the digits.
        chord = np.linalg.norm(member - mean, axis=-1)
        squares += (2 * np.arcsin(np.clip(chord / 2, 0.0, 1.0))) ** 2
    return mean, np.degrees(np.sqrt(squares / max(len(members) - 1, 1)))


def seen_size(size: tuple[int, int], resolution: int) -> tuple[int, int]:
    """(height, width) with a longer side of `resolution` pixels, in proportion; 0 = as it is."""
    if resolution == 0:
        return size
    height, width = (max(1, round(side * resolution / max(size))) for side in size)
    return height, width


def at_size(normals: Array, spread: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Unit normals and their spread at (height, width), borders on borders."""
    if spread.shape == size:
        return normals, spread
    scaled = resized(normals, size).astype(np.float64)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    unit = np.where(length > 1e-6, scaled / np.maximum(length, 1e-6), FACING)
    return unit, resized(spread[..., None], size)[..., 0].astype(np.float64)
