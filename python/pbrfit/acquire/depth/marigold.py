"""Depth by Marigold (Ke et al. 2024 and 2025), through diffusers.

`MarigoldDepthPipeline` gives depth between 0 and 1 up to an unknown factor and offset, another one
with each seed. Members of an ensemble are brought to the first by least squares, and averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire import weights
from pbrfit.acquire.normals.marigold import seen_size
from pbrfit.acquire.padding import resized, resized_srgb8

MODEL = "prs-eth/marigold-depth-v1-1"

ENSEMBLE = 5

WHAT = "Marigold (depth)"


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
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """Estimate relative depth of one picture (H, W, 3), sRGB.

    Options are those of `pbrfit.acquire.normals.marigold.from_picture`. Returns depth: (H, W) up to
    a factor and an offset; record: how it was made, as JSON. Raises InputError if a package or the
    weights are missing, an option cannot be used, or memory runs out.
    """
    weights.need("diffusion", "torch", "diffusers", "transformers", "accelerate")
    import torch
    from diffusers import MarigoldDepthPipeline
    from PIL import Image

    where = weights.placement(device, dtype, offload, what=WHAT, half="float16")
    loader = partial(MarigoldDepthPipeline.from_pretrained, dtype=where.torch_dtype)
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
            members.append(found.prediction[0, ..., 0].astype(np.float64))
            progress()
    depth = resized(aligned_mean(members)[..., None], (height, width))[..., 0].astype(np.float64)
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
    return depth, record


def aligned_mean(members: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Mean of maps (H, W), each with the factor and offset by which it is nearest to the first."""
    first = members[0]
    total = first.copy()
    for member in members[1:]:
        centred = member - member.mean()
        square = float(np.sum(centred**2))
        factor = float(np.sum(centred * first)) / square if square > 0 else 0.0
        total += first.mean() + factor * centred
    return np.asarray(total / len(members))
