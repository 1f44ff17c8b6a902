"""Marigold-IID (Ke et al. 2025): albedo, roughness and metallicity of one picture, by diffusers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire import weights
from pbrfit.acquire.extras import need
from pbrfit.color import decode_srgb
from pbrfit.evaluation.peers.maps import Maps

MODEL = "prs-eth/marigold-iid-appearance-v1-1"

WHAT = "Marigold-IID"


class Marigold:
    """The pipeline, loaded.

    Parameters
    ----------
    model
        Name on the Hugging Face Hub, or a local folder.
    device
        As for `pbrfit.acquire.weights.placement`.

    Raises
    ------
    InputError
        If packages or weights are missing, or the checkpoint predicts other things.
    """

    def __init__(self, model: str = MODEL, *, device: str = "auto") -> None:
        need("diffusion", "torch", "diffusers", "transformers", "accelerate")
        from diffusers import MarigoldIntrinsicsPipeline

        where = weights.placement(device, what=WHAT)
        loaded = weights.load(
            WHAT,
            model,
            loader=MarigoldIntrinsicsPipeline.from_pretrained,
            marker="model_index.json",
        )
        self._pipeline = loaded.network.to(where.torch_dtype)
        weights.place(self._pipeline, where, what=WHAT)
        self._pipeline.set_progress_bar_config(disable=True)
        self._targets = targets(model, self._pipeline.target_properties)

    def maps(self, srgb8: NDArray[np.uint8], *, seed: int, samples: int, steps: int | None) -> Maps:
        """Maps of a picture (H, W, 3): the median of some predictions, as the pipeline forms it.

        Parameters
        ----------
        srgb8
            The picture.
        seed
            Of the noise it starts from.
        samples
            How many predictions.
        steps
            Of the sampler; None = as the model recommends.
        """
        import torch
        from PIL import Image

        with weights.memory_in_words(WHAT, "another --device"):
            found = self._pipeline(
                Image.fromarray(srgb8),
                ensemble_size=samples,
                num_inference_steps=steps,
                generator=torch.Generator("cpu").manual_seed(seed),
            )
        planes = {
            name: decode_srgb(found.prediction[i, ..., channel].astype(np.float64))
            if space == "srgb"
            else found.prediction[i, ..., channel].astype(np.float64)
            for name, (i, channel, space) in self._targets.items()
        }
        return Maps(planes["albedo"], planes["roughness"], planes["metallicity"])


def targets(model: str, properties: Any) -> dict[str, tuple[int, Any, str]]:
    """Where each map is in a prediction: which picture, which channels, in which encoding.

    The checkpoint's own `target_properties` say it: the order in ``target_names``; of each a
    ``prediction_space``, "srgb", "linear", or "stack" of up to three scalars.

    Raises
    ------
    InputError
        If albedo, roughness or metallicity is not among them.
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
