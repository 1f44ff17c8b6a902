"""Marigold's networks (Ke et al. 2024 and 2025), through diffusers: normals, depth, materials.

Scaling to the network's resolution and back, and the ensembles of normals and depth, are done here,
because the pipelines do both in the network's precision. In bfloat16 scaling is missing on the
processor, and the smallest angle whose cosine is not 1 is 5 degrees.

`MarigoldNormalsPipeline` of diffusers 0.42 gives X right, Y up and Z towards the observer (stated
in `MarigoldImageProcessor.visualize_normals`), which is our camera space. It pads a picture right
and below to whole blocks and cuts that off again, so pixels stay where they are at any size. Of
several normals the pipeline would keep the one nearest to the mean; here the mean is taken.

`MarigoldDepthPipeline` gives depth between 0 and 1 up to an unknown factor and offset, another one
with each seed. Members of an ensemble are brought to the first by least squares, and averaged.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire import weights
from pbrfit.acquire.padding import resized, resized_srgb8
from pbrfit.io.color import decode_srgb
from pbrfit.model.depth_normals import FACING
from pbrfit.model.materials import Materials
from pbrfit.values.arrays import Array, Codes

NORMALS_MODEL = "prs-eth/marigold-normals-v1-1"
DEPTH_MODEL = "prs-eth/marigold-depth-v1-1"
MATERIALS_MODEL = "prs-eth/marigold-iid-appearance-v1-1"

ENSEMBLE = 5

UNCERTAINTY_ENSEMBLE_MIN = 3
"""Predictions below which their spread is not worth using."""


def normals_of(
    srgb8: Codes, *, model: str = NORMALS_MODEL, **options: Any
) -> tuple[Array, Array | None, dict[str, Any]]:
    """Estimate normals of one picture.

    Options, errors and the record are those of `predictions`. Returns normals, (H, W, 3) unit
    vectors in camera space; their uncertainty, (H, W) degrees, see `mean_and_spread`, None for an
    ensemble below 3; and the record.
    """
    members, record = predictions(srgb8, "Normals", model=model, **options)
    normals, spread = mean_and_spread(members)
    size = srgb8.shape[0], srgb8.shape[1]
    if spread.shape != size:
        scaled = resized(normals, size).astype(np.float64)
        length = np.linalg.norm(scaled, axis=-1, keepdims=True)
        normals = np.where(length > 1e-6, scaled / np.maximum(length, 1e-6), FACING)
        spread = resized(spread[..., None], size)[..., 0].astype(np.float64)
    return normals, spread if len(members) >= UNCERTAINTY_ENSEMBLE_MIN else None, record


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


def depth_of(
    srgb8: Codes, *, model: str = DEPTH_MODEL, **options: Any
) -> tuple[Array, dict[str, Any]]:
    """Estimate relative depth of one picture (H, W, 3), sRGB.

    Options, errors and the record are those of `predictions`. Returns depth (H, W), up to a factor
    and an offset, and the record.
    """
    members, record = predictions(srgb8, "Depth", model=model, **options)
    depth = aligned_mean([one[..., 0] for one in members])
    height, width = srgb8.shape[:2]
    return resized(depth[..., None], (height, width))[..., 0].astype(np.float64), record


def aligned_mean(members: Sequence[Array]) -> Array:
    """Mean of maps (H, W), each with the factor and offset by which it is nearest to the first."""
    first = members[0]
    total = first.copy()
    for member in members[1:]:
        both = np.stack([member.ravel(), np.ones(member.size)], axis=-1)
        total += (both @ np.linalg.lstsq(both, first.ravel())[0]).reshape(first.shape)
    return np.asarray(total / len(members))


def predictions(
    srgb8: Codes,
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
) -> tuple[list[Array], dict[str, Any]]:
    """Predict maps of a kind for one picture (H, W, 3), sRGB.

    `model` is a name on the Hugging Face Hub or a local folder; `device`, `dtype` and `offload` are
    as for `pbrfit.acquire.weights.placement`. There are `ensemble` predictions, from seeds `seed`,
    `seed` + 1, ...; `progress` is called after each. `steps` of denoising, and the longer side in
    pixels (`resolution`) at which the network sees the picture (0 = that of the picture), are as
    the model recommends where they are None. Returns maps (h, w, channels) at that size, and how
    they were made, as JSON. Raises InputError if a package or the weights are missing, an option
    cannot be used, or memory runs out.
    """
    what = f"Marigold ({kind.lower()})"
    loaded, where = _pipeline(kind, what, model, device, dtype, offload)
    network = loaded.network
    if resolution is None:
        resolution = int(network.default_processing_resolution)
    seen = _seen(srgb8, resolution)
    members = []
    with weights.memory_in_words(what, "a smaller --resolution, --offload model, --dtype float16"):
        for i in range(ensemble):
            found = _predicted(network, seen, seed + i, steps)
            members.append(found[0].astype(np.float64))
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


class MarigoldIID:
    """The network for materials, loaded: a model by its name on the Hub, or a local folder.

    `device` is as for `pbrfit.acquire.weights.placement`. Raises InputError if packages or weights
    are missing, or the checkpoint predicts other things.
    """

    def __init__(self, model: str = MATERIALS_MODEL, *, device: str = "auto") -> None:
        loaded, _ = _pipeline("Intrinsics", "Marigold-IID", model, device)
        self._network = loaded.network
        self._targets = targets(model, self._network.target_properties)

    def maps(self, srgb8: Codes, *, seed: int, samples: int, steps: int | None) -> Materials:
        """Maps of a picture (H, W, 3): the median of `samples` predictions, by the pipeline.

        `seed` is of the noise it starts from, `steps` of the sampler; None = as the model
        recommends.
        """
        seen = _seen(srgb8, int(self._network.default_processing_resolution))
        with weights.memory_in_words("Marigold-IID", "another --device"):
            found = _predicted(self._network, seen, seed, steps, ensemble_size=samples)
        planes = {}
        for name, (i, channel, space) in self._targets.items():
            stored = found[i].astype(np.float64)
            linear = decode_srgb(stored) if space == "srgb" else stored
            whole = resized(linear, (srgb8.shape[0], srgb8.shape[1]))
            planes[name] = whole[..., channel].astype(np.float64)
        return Materials(planes["albedo"], planes["roughness"], planes["metallicity"])


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
    if {"albedo", "roughness", "metallicity"} - set(found):
        raise InputError(
            f"{model}: expected a checkpoint that predicts albedo, roughness and metallicity, "
            f"found {', '.join(found) or 'nothing'}"
        )
    return found


def _pipeline(
    kind: str, what: str, model: str, *placed: str
) -> tuple[weights.Loaded, weights.Placement]:
    """The pipeline of diffusers that predicts maps of a kind, on its device."""
    weights.need("diffusion", "torch", "diffusers", "transformers", "accelerate")
    where = weights.placement(*placed, what=what, half="float16")
    pipeline = getattr(importlib.import_module("diffusers"), f"Marigold{kind}Pipeline")
    loader = partial(pipeline.from_pretrained, dtype=where.torch_dtype)
    loaded = weights.load(what, model, loader=loader, marker="model_index.json")
    weights.place(loaded.network, where, what=what)
    loaded.network.set_progress_bar_config(disable=True)
    return loaded, where


def _seen(srgb8: Codes, resolution: int) -> Image.Image:
    """A picture (H, W, 3) as the network is shown it, of a longer side of `resolution` pixels."""
    height, width = srgb8.shape[:2]
    return Image.fromarray(resized_srgb8(srgb8, seen_size((height, width), resolution)))


def _predicted(network: Any, seen: Image.Image, seed: int, steps: int | None, **more: Any) -> Any:
    import torch

    return network(
        seen,
        num_inference_steps=steps,
        processing_resolution=0,
        # On the processor, so that a seed means the same everywhere.
        generator=torch.Generator("cpu").manual_seed(seed),
        **more,
    ).prediction


def seen_size(size: tuple[int, int], resolution: int) -> tuple[int, int]:
    """(height, width) with a longer side of `resolution` pixels, in proportion; 0 = as it is."""
    if resolution == 0:
        return size
    height, width = (max(1, round(side * resolution / max(size))) for side in size)
    return height, width
