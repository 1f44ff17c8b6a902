"""Predictions of Marigold's networks (Ke et al. 2024 and 2025), through diffusers.

Scaling to the network's resolution and back, and the ensemble, are done here, because the pipelines
do both in the network's precision. In bfloat16 scaling is missing on the processor, and the
smallest angle whose cosine is not 1 is 5 degrees.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire import weights
from pbrfit.acquire.padding import resized_srgb8

ENSEMBLE = 5


def predictions(
    srgb8: NDArray[np.uint8],
    kind: Literal["Depth", "Normals"],
    *,
    model: str,
    ensemble: int = ENSEMBLE,
    steps: int | None = None,
    resolution: int | None = None,
    seed: int = 0,
    device: str = "auto",
    dtype: str = "auto",
    offload: str = "none",
    progress: Callable[[], Any] = lambda: None,
) -> tuple[list[NDArray[np.float64]], dict[str, Any]]:
    """Predict maps of a kind for one picture (H, W, 3), sRGB.

    `model` is a name on the Hugging Face Hub or a local folder; `device`, `dtype` and `offload` are
    as for `pbrfit.acquire.weights.placement`. There are `ensemble` predictions, from seeds `seed`,
    `seed` + 1, ...; `progress` is called after each. `steps` of denoising, and the longer side in
    pixels (`resolution`) at which the network sees the picture (0 = that of the picture), are as
    the model recommends where they are None. Returns maps (h, w, channels) at that size, and how
    they were made, as JSON. Raises InputError if a package or the weights are missing, an option
    cannot be used, or memory runs out.
    """
    weights.need("diffusion", "torch", "diffusers", "transformers", "accelerate")
    import torch
    from PIL import Image

    what = f"Marigold ({kind.lower()})"
    where = weights.placement(device, dtype, offload, what=what, half="float16")
    pipeline = getattr(importlib.import_module("diffusers"), f"Marigold{kind}Pipeline")
    loader = partial(pipeline.from_pretrained, dtype=where.torch_dtype)
    loaded = weights.load(what, model, loader=loader, marker="model_index.json")
    network = loaded.network
    weights.place(network, where, what=what)
    network.set_progress_bar_config(disable=True)
    if resolution is None:
        resolution = int(network.default_processing_resolution)
    height, width = srgb8.shape[:2]
    seen = Image.fromarray(resized_srgb8(srgb8, seen_size((height, width), resolution)))
    members = []
    with weights.memory_in_words(what, "a smaller --resolution, --offload model, --dtype float16"):
        for i in range(ensemble):
            found = network(
                seen,
                num_inference_steps=steps,
                processing_resolution=0,
                # On the processor, so that a seed means the same everywhere.
                generator=torch.Generator("cpu").manual_seed(seed + i),
            )
            members.append(found.prediction[0].astype(np.float64))
            progress()
    return members, {
        "model": model,
        "revision": loaded.record["revision"],
        "ensemble": ensemble,
        "steps": steps or network.default_denoising_steps,
        "resolution": resolution,
        "seed": seed,
        "device": where.device,
        "dtype": where.dtype,
        "packages": weights.versions("diffusers", "transformers", "torch"),
    }


def seen_size(size: tuple[int, int], resolution: int) -> tuple[int, int]:
    """(height, width) with a longer side of `resolution` pixels, in proportion; 0 = as it is."""
    if resolution == 0:
        return size
    height, width = (max(1, round(side * resolution / max(size))) for side in size)
    return height, width
