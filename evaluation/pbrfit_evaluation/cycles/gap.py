"""How far a model is from pictures of a path tracer when the materials are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.model.reflection import DEFAULT_MODEL, Model, render, shade
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gap:
    """RMSE of a model with the true materials, over the mean of the pictures.

    Attributes
    ----------
    true_light
        Under the pictures' own lights; None where those are not spherical harmonics.
    best_light
        Under the SH light that comes closest, for each picture and channel: what the best fit of
        the lights leaves. A fit of the materials as well can hide more.
    """

    true_light: float | None
    best_light: float


def reflection_gap(scene: Scene, model: Model = DEFAULT_MODEL) -> Gap:
    """Render a scene's true materials by a model and compare.

    Parameters
    ----------
    scene
        With ground truth, from `render_scene`.
    model
        "paper" or "principled".

    Raises
    ------
    InputError
        If the scene has no ground truth.
    """
    if scene.truth is None:
        raise InputError("scene: expected one with ground truth, found none")
    known, of = scene.truth, scene.valid
    pictures = scene.images[:, of].astype(np.float64)  # (N, P, 3)
    true_light = None
    if known.lighting is not None:
        ours = render(known.materials, scene.normals, known.lighting, scene.fov, model=model)[:, of]
        true_light = _relative(ours, pictures)
    maps = known.materials
    weights = shade(
        scene.normals[of],
        scene.views[of],
        maps.albedo[of],
        maps.roughness[of],
        maps.metallic[of],
        model=model,
    )
    best = np.empty_like(pictures)
    for channel in range(3):
        w = weights[:, channel]  # (P, 16)
        light, *_ = np.linalg.lstsq(w, pictures[..., channel].T)
        best[..., channel] = (w @ light).T
    return Gap(true_light=true_light, best_light=_relative(best, pictures))


def _relative(found: Array, expected: Array) -> float:
    return float(np.sqrt(np.mean((found - expected) ** 2)) / np.mean(expected))
