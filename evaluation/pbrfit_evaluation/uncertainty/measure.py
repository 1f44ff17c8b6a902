"""Predicted deviations of one scene beside those of many refits under synthetic noise.

The pictures follow the model exactly, so noise is all that is wrong with them. Materials are moved
away from the bounds, linearly into `INSIDE`: on a bound a deviation means little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import uncertainty
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import chosen_model, render
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.uncertainty.refits import with_free_lights, with_known_lights

Array = NDArray[np.float64]

Lights = Literal["known", "free"]
LIGHTS: tuple[Lights, ...] = get_args(Lights)

INSIDE = (0.15, 0.85)

MARGIN = 4.0
"""Pixels that are compared: each unknown so many predicted deviations away from both bounds ..."""

LARGEST = 0.05
"""... and its predicted deviation below this."""


@dataclass(frozen=True)
class Task:
    """One scene at one level of noise."""

    lights: Lights
    kind: str
    size: int
    pictures: int
    noise: float
    draws: int
    seed: int

    @property
    def key(self) -> str:
        """Unique name, fit for a file."""
        return f"{self.lights}.{self.kind}.{self.noise:g}.{self.seed}"


def work(task: Task, threads: int) -> Values:
    """Predict, refit, compare.

    Returns
    -------
    `predicted`, `predicted_by_fit`, `found` and `bias`: (Q, 5) of albedo, roughness and metallic of
    the pixels that were compared. Deviations predicted from the true materials, lights and noise;
    those by `pbrfit.fit.uncertainty.estimate` for the fit of one noisy set of pictures, which knows
    neither; standard deviations over the refits; and their mean less the ground truth.

    `compared`: share of all pixels. `converged`: share of the refits (of pixels where the lights
    are known). `on_bound`: share of the refitted values that lie on a bound. `variance`: mean over
    refits of the residual variance over the degrees of freedom, by the true variance.
    `albedo_scale`: largest predicted relative deviation of the scale, by that fit.
    """
    scene = inside(task)
    assert scene.truth is not None
    true, lighting = scene.truth.materials, scene.truth.lighting
    rng = np.random.default_rng(task.seed)

    def noisy() -> tuple[Objective, Array]:
        """An objective and the ground truth as its x."""
        images = scene.images + rng.normal(scale=task.noise, size=scene.images.shape)
        objective = Objective(replace(scene, images=images), threads=threads)
        x = objective.pack(true.albedo, true.roughness, true.metallic, lighting)
        return objective, x

    objective, x = noisy()
    layout = objective.layout
    everywhere = np.arange(layout.pixels, dtype=np.uint64)
    at_truth = uncertainty.estimate(objective, x)
    assert at_truth.noise is not None
    predicted = _columns(at_truth.marginal, layout) * (task.noise / at_truth.noise)
    values = _columns(true, layout)
    margin = np.minimum(values, 1 - values)
    fit = ((predicted < LARGEST) & (margin >= MARGIN * predicted)).all(axis=1)
    chosen = everywhere[fit]
    values = values[chosen]

    sigma = task.noise / objective.scale
    if task.lights == "known":
        x[layout.maps] = with_known_lights(objective, x, everywhere, sigma).values.T.ravel()
    else:
        x, _, _ = with_free_lights(objective, x, sigma)
    by_fit = uncertainty.estimate(objective, x)

    off, converged, variances = [], [], []
    for _ in range(task.draws):
        objective, x = noisy()
        sigma = task.noise / objective.scale
        if task.lights == "known":
            refit = with_known_lights(objective, x, chosen, sigma)
            found, done = refit.values, float(refit.converged.mean())
            sum_sq_residuals, unknowns = float(refit.sum_sq_residuals.sum()), refit.values.size
            samples = _samples(layout, len(chosen))
        else:
            x, whole, sum_sq_residuals = with_free_lights(objective, x, sigma)
            found = x[layout.maps].reshape(-1, layout.pixels).T[chosen]
            done = float(whole)
            samples, unknowns = _samples(layout, layout.pixels), layout.size
        off.append(found - values)
        converged.append(done)
        variances.append(sum_sq_residuals / (samples - unknowns) / sigma**2)
    errors = np.array(off)
    refitted = errors + values
    return {
        "predicted": predicted[chosen].tolist(),
        "predicted_by_fit": _columns(by_fit.marginal, layout)[chosen].tolist(),
        "found": errors.std(axis=0, ddof=1).tolist(),
        "bias": errors.mean(axis=0).tolist(),
        "compared": len(chosen) / layout.pixels,
        "converged": float(np.mean(converged)),
        "on_bound": float(np.mean((refitted <= 0) | (refitted >= 1))),
        "variance": float(np.mean(variances)),
        "albedo_scale": max(by_fit.albedo_scale),
    }


def _samples(layout: ParameterLayout, pixels: int) -> int:
    """Samples of so many pixels."""
    return layout.pictures * layout.channels * pixels


def _columns(maps: Materials, layout: ParameterLayout) -> Array:
    """(P, 5) of the valid pixels."""
    planes = (*np.moveaxis(maps.albedo, -1, 0), maps.roughness, maps.metallic)
    return np.stack([plane[layout.valid] for plane in planes], axis=-1)


def inside(task: Task) -> Scene:
    """Noise-free pictures of a scene whose materials keep away from the bounds."""
    scene = make_scene(task.kind, size=task.size, lights=task.pictures, held_out=1, seed=task.seed)
    assert scene.truth is not None
    assert scene.truth.lighting is not None
    low, high = INSIDE
    true = scene.truth.materials
    moved = Materials(
        *(low + (high - low) * values for values in (true.albedo, true.roughness, true.metallic))
    )
    images = render(
        *(moved, scene.normals, scene.truth.lighting, scene.fov),
        model=chosen_model(None, scene.model),
    )
    exposure = MEAN_RADIANCE / images[:, scene.valid].mean()
    lighting = exposure * scene.truth.lighting
    return replace(
        scene,
        images=exposure * images,
        lighting=lighting if task.lights == "known" else None,
        truth=replace(scene.truth, materials=moved, lighting=lighting),
    )
