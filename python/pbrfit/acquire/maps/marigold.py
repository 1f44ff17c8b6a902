"""Marigold-IID (Ke et al. 2025): albedo, roughness and metallicity of one picture, by diffusers."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire import weights
from pbrfit.acquire.marigold import seen_size
from pbrfit.acquire.padding import resized, resized_srgb8
from pbrfit.io.color import decode_srgb
from pbrfit.model.materials import Materials

MODEL = "prs-eth/marigold-iid-appearance-v1-1"

WHAT = "Marigold-IID"


class Marigold:
    """The pipeline, loaded: a model by its name on the Hugging Face Hub, or a local folder.

    `device` is as for `pbrfit.acquire.weights.placement`. Raises InputError if packages or weights
    are missing, or the checkpoint predicts other things.
    """

    def __init__(self, model: str = MODEL, *, device: str = "auto") -> None:
        weights.need("diffusion", "torch", "diffusers", "transformers", "accelerate")
        from diffusers import MarigoldIntrinsicsPipeline

        where = weights.placement(device, what=WHAT, half="float16")
        loader = partial(MarigoldIntrinsicsPipeline.from_pretrained, dtype=where.torch_dtype)
        loaded = weights.load(WHAT, model, loader=loader, marker="model_index.json")
        self._pipeline = loaded.network
        weights.place(self._pipeline, where, what=WHAT)
        self._pipeline.set_progress_bar_config(disable=True)
        self._targets = targets(model, self._pipeline.target_properties)

    def maps(
        self, srgb8: NDArray[np.uint8], *, seed: int, samples: int, steps: int | None
    ) -> Materials:
        """Maps of a picture (H, W, 3): the median of `samples` predictions, by the pipeline.

        `seed` is of the noise it starts from, `steps` of the sampler; None = as the model
        recommends.
        """
        import torch
        from PIL import Image

        height, width = srgb8.shape[:2]
        # Scaled here: in bfloat16 the pipeline's own scaling does not run everywhere.
        resolution = int(self._pipeline.default_processing_resolution)
        seen = resized_srgb8(srgb8, seen_size((height, width), resolution))
        with weights.memory_in_words(WHAT, "another --device"):
            found = self._pipeline(
                Image.fromarray(seen),
                processing_resolution=0,
                ensemble_size=samples,
                num_inference_steps=steps,
                generator=torch.Generator("cpu").manual_seed(seed),
            )
        planes = {
            name: self._plane(found.prediction[i], channel, space, (height, width))
            for name, (i, channel, space) in self._targets.items()
        }
        return Materials(planes["albedo"], planes["roughness"], planes["metallicity"])

    @staticmethod
    def _plane(
        prediction: NDArray[np.float32], channel: Any, space: str, size: tuple[int, int]
    ) -> NDArray[np.float64]:
        """A map of a predicted picture (h, w, 3): linear, at (height, width)."""
        encoded = prediction.astype(np.float64)
        linear = decode_srgb(encoded) if space == "srgb" else encoded
        return resized(linear, size)[..., channel].astype(np.float64)


def targets(model: str, properties: Any) -> dict[str, tuple[int, Any, str]]:
    """Where each map is in a prediction: which picture, which channels, in which encoding.

    The checkpoint's own `target_properties` say it: the order in ``target_names``; of each a
    ``prediction_space``, "srgb", "linear", or "stack" of up to three scalars.

    Raises InputError if albedo, roughness or metallicity is not among them.
    """
    found: dict[str, tuple[int, Any, str]] = {}
    for i, name in enumerate((properties or {}).get("target_names", ())):
        facts = properties.get(name, {})
        space = facts.get("prediction_space", "srgb")
        if space != "stack":
            found[name] = (i, slice(0, 3), space)
            continue
        for channel, part in enumerate(facts["sub_target_names"]):
            if part is not None:
                own = properties.get(part, {}).get("prediction_space", "srgb")
                found[part] = (i, channel, own)
    missing = {"albedo", "roughness", "metallicity"} - set(found)
    if missing:
        raise InputError(
            f"{model}: expected a checkpoint that predicts albedo, roughness and metallicity, "
            f"found {', '.join(found) or 'nothing'}"
        )
    return found
