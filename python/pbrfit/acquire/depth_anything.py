"""Depth by Depth Anything V2 (Yang et al. 2024), through transformers.

Its metric checkpoints give distances along the axis in metres, its others inverse depth up to a
factor and an offset; which of both, a checkpoint's configuration says.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire import weights
from pbrfit.acquire.padding import resized

MODEL = "depth-anything/Depth-Anything-V2-Small-hf"

WHAT = "Depth Anything"


def from_picture(
    srgb8: NDArray[np.uint8], *, model: str = MODEL, device: str = "auto"
) -> tuple[NDArray[np.float64], bool, dict[str, Any]]:
    """Estimate depth of one picture (H, W, 3), sRGB.

    `model` is a name on the Hugging Face Hub or a local folder, `device` as for
    `pbrfit.acquire.weights.placement`; always in float32. Returns (H, W); whether that is depth in
    metres, or else inverse depth up to factor and offset; record: how it was made, as JSON. Raises
    InputError if a package or the weights are missing, or memory runs out.
    """
    weights.need("segment", "torch", "torchvision", "transformers")
    import torch
    from PIL import Image
    from transformers import AutoImageProcessor, AutoModelForDepthEstimation

    where = weights.placement(device, "float32", what=WHAT)
    loader = partial(AutoModelForDepthEstimation.from_pretrained, dtype=torch.float32)
    loaded = weights.load(WHAT, model, loader=loader, marker="config.json")
    processor = weights.load(
        WHAT, model, loader=AutoImageProcessor.from_pretrained, marker="preprocessor_config.json"
    ).network
    network = loaded.network
    with weights.memory_in_words(WHAT, "a smaller picture, --device cpu"), torch.inference_mode():
        network.to(where.device)
        inputs = processor(images=Image.fromarray(srgb8), return_tensors="pt").to(where.device)
        answer = network(**inputs).predicted_depth[0].cpu().numpy().astype(np.float64)
    metric = getattr(network.config, "depth_estimation_type", "relative") == "metric"
    height, width = srgb8.shape[:2]
    record = {
        "model": model,
        "revision": loaded.record["revision"],
        "metric": metric,
        "device": where.device,
        "packages": weights.versions("transformers", "torchvision", "torch"),
    }
    return resized(answer[..., None], (height, width))[..., 0].astype(np.float64), metric, record
