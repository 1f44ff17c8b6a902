"""Calibration: predicted deviations beside those of many refits under synthetic noise.

`plan` says what is to be done, `work` does one scene, `Calibration` is what it found. Nothing here
draws or writes.

The pictures follow the model exactly, so noise is all that is wrong with them. Materials are moved
away from the bounds, linearly into `INSIDE`: on a bound a deviation means little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

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
from pbrfit_evaluation.uncertainty.refits import with_free_lights, with_known_lights

Array = NDArray[np.float64]

Lights = Literal["known", "free"]
LIGHTS: tuple[Lights, ...] = get_args(Lights)

FIRST_SEED = 3000
"""Nothing was tuned on seeds from there on."""

INSIDE = (0.15, 0.85)

MARGIN = 4.0
"""Pixels that are compared: each unknown so many predicted deviations away from both bounds ..."""

LARGEST = 0.05
"""... and its predicted deviation below this."""

WITHIN = 0.2
"""A ratio this near to 1 counts as right."""


@dataclass(frozen=True)
class Bar:
    """What ratios of found to predicted deviations have to hold.

    The median lies in [`low`, `high`], and at least `share` of them are within `WITHIN` of 1.
    """

    low: float
    high: float
    share: float

    def holds(self, ratios: Array) -> bool:
        """Of at least one ratio."""
        return bool(
            ratios.size
            and self.low <= np.median(ratios) <= self.high
            and share_within(ratios) >= self.share
        )


BARS: dict[Lights, Bar] = {"known": Bar(0.9, 1.1, 0.9), "free": Bar(0.8, 1.25, 0.0)}


def share_within(ratios: Array) -> float:
    """Share of the ratios within `WITHIN` of 1."""
    return float(np.mean(np.abs(ratios - 1) <= WITHIN))


@dataclass(frozen=True)
class Setup:
    """Size of the scenes, number of pictures, levels of noise, refits at each of them."""

    size: int
    pictures: int
    noise: tuple[float, ...]
    draws: int


@dataclass(frozen=True)
class Effort:
    """What is run: scenes of each kind."""

    name: str
    kinds: tuple[str, ...]
    scenes: int
    setups: Mapping[Lights, Setup]


FULL = Effort(
    name="full",
    kinds=("room", "spheres", "textured"),
    scenes=2,
    setups={
        "known": Setup(32, 16, noise=(0.002, 0.01), draws=400),
        "free": Setup(20, 8, noise=(0.002, 0.005), draws=200),
    },
)

QUICK = Effort(
    name="quick",
    kinds=("room",),
    scenes=1,
    setups={
        "known": Setup(16, 16, noise=(0.002,), draws=100),
        "free": Setup(12, 8, noise=(0.002,), draws=30),
    },
)


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


@dataclass(frozen=True, eq=False)
class Calibration:
    """What was found of a scene.

    Attributes
    ----------
    task
        What was done.
    predicted
        (Q, 5): deviations of albedo, roughness and metallic of the pixels that were compared, from
        the true materials and lights and the true noise.
    predicted_by_fit
        (Q, 5): those that `pbrfit.fit.uncertainty.estimate` gives for the fit of one noisy set of
        pictures, which knows neither.
    found
        (Q, 5): standard deviations over the refits.
    bias
        (Q, 5): mean of the refits less the truth.
    compared
        Share of all pixels.
    converged
        Share of the refits (of pixels where the lights are known).
    on_bound
        Share of the refitted values of the compared pixels that lie on a bound.
    variance
        Mean over refits of the residual variance over the degrees of freedom, by the true variance.
    albedo_scale
        Largest of the three predicted relative deviations of the scale, by that fit.
    """

    task: Task
    predicted: Array
    predicted_by_fit: Array
    found: Array
    bias: Array
    compared: float
    converged: float
    on_bound: float
    variance: float
    albedo_scale: float

    @classmethod
    def from_values(cls, task: Task, values: Mapping[str, Any]) -> Calibration:
        """From what `work` returned."""

        def table(name: str) -> Array:
            return np.array(values[name], np.float64).reshape(-1, 5)

        return cls(
            task=task,
            predicted=table("predicted"),
            predicted_by_fit=table("predicted_by_fit"),
            found=table("found"),
            bias=table("bias"),
            compared=float(values["compared"]),
            converged=float(values["converged"]),
            on_bound=float(values["on_bound"]),
            variance=float(values["variance"]),
            albedo_scale=float(values["albedo_scale"]),
        )


def plan(effort: Effort, first_seed: int = FIRST_SEED) -> list[Task]:
    """All scenes."""
    return [
        Task(lights, kind, setup.size, setup.pictures, noise, setup.draws, first_seed + i)
        for lights, setup in effort.setups.items()
        for noise in setup.noise
        for kind in effort.kinds
        for i in range(effort.scenes)
    ]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Predict, refit, compare."""
    scene = inside(task)
    assert scene.truth is not None
    true, lighting = scene.truth.materials, scene.truth.lighting
    rng = np.random.default_rng(task.seed)

    def noisy() -> tuple[Objective, Array]:
        """An objective and the truth as its x."""
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
            squares, unknowns = float(refit.squares.sum()), refit.values.size
            samples = _samples(layout, len(chosen))
        else:
            x, whole, squares = with_free_lights(objective, x, sigma)
            found = x[layout.maps].reshape(-1, layout.pixels).T[chosen]
            done = float(whole)
            samples, unknowns = _samples(layout, layout.pixels), layout.size
        off.append(found - values)
        converged.append(done)
        variances.append(squares / (samples - unknowns) / sigma**2)
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


def calibrations(
    tasks: Sequence[Task], values: Sequence[Mapping[str, Any] | None]
) -> list[Calibration]:
    """Those of the tasks that ended well."""
    return [
        Calibration.from_values(task, found)
        for task, found in zip(tasks, values, strict=True)
        if found is not None
    ]
