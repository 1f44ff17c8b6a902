"""Part "exact": pictures without noise, where everything should come back.

For scenes where it does not, it is told how much of the picture is to blame, and whether what is
left is a common turn of all normals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pbrfit.model.geometry import angles_between
from pbrfit.model.materials import Materials
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normal_errors import Array
from pbrfit_evaluation.normals.disturbances import Disturbance, disturbed
from pbrfit_evaluation.normals.fits import Off, decision, fit, room, room_kind
from pbrfit_evaluation.scores import score

DEGREES = 10.0
KINDS: tuple[Disturbance, ...] = ("correlated", "biased")

MAPS = ("albedo", "roughness", "metallic")
MATERIAL = 1e-2
ANGLE = 0.3
"""Largest RMSE of a map, and largest mean angle in degrees, of a scene that came back."""

BEST = 0.95
"""Share of the pixels whose errors are told beside those of all."""

WRONG_DEGREES, WRONG_MATERIAL = 1.0, 0.05
"""A pixel beyond one of these is wrong."""

GRAZING, DARK, SMOOTH, ROUGH = 0.2, 0.1, 0.3, 0.9
"""Kinds of pixels: n·v below, largest albedo below, roughness below and above."""


@dataclass(frozen=True)
class Task:
    """A scene under a disturbance of `DEGREES`, refined."""

    scene: str
    seed: int
    size: int
    disturbance: Disturbance
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"exact_{self.disturbance}_{self.scene}_{self.seed}"


def plan(
    scenes: int, size: int, iterations: int, first_seed: int, disturbances: Sequence[Disturbance]
) -> list[Task]:
    """Every scene under those of `KINDS` that are asked for."""
    return [
        Task(room_kind(i), first_seed + i, size, kind, iterations)
        for i in range(scenes)
        for kind in KINDS
        if kind in disturbances
    ]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Scores, angles, and what is wrong."""
    scene = room(task.scene, task.seed, task.size, noise=0.0)
    normals = disturbed(scene, task.disturbance, DEGREES, task.seed)
    given = replace(scene, normals=normals)
    result = fit(given, "on", iterations=task.iterations, threads=threads)
    return {
        "given": Off.of(normals, scene.normals, scene.valid).as_json(),
        "scores": score(result, scene, threads).as_json(),
        "angle": Off.of(result.normals, scene.normals, scene.valid).as_json(),
        "decision": decision(result),
        "stop_reason": result.stop_reason,
        "wrong": wrong(scene, result),
    }


def came_back(values: Mapping[str, Any]) -> bool:
    """Whether materials and normals of a scene are what they were."""
    scores = values["scores"]
    return all(scores[name] <= MATERIAL for name in MAPS) and values["angle"]["mean"] <= ANGLE


def wrong(scene: Scene, result: Result) -> dict[str, Any]:
    """Which pixels are wrong.

    Returns
    -------
    dict
        "best": RMSE of the maps and mean angle over the best `BEST` of the pixels, each for itself.
        "share": of pixels that are wrong. "kinds": of what kind those are, as shares of them;
        "kinds_of_all": the same of all pixels.
    """
    assert scene.truth is not None
    valid = scene.valid
    off = angles_between(result.normals, scene.normals)[valid]
    errors = _errors(result.materials, scene.truth.materials, valid)
    best = {name: _rms(_best(error)) for name, error in errors.items()}
    best["angle"] = float(_best(off).mean())
    bad = (off > WRONG_DEGREES) | (np.max(list(errors.values()), axis=0) > WRONG_MATERIAL)
    kinds = _kinds(scene)
    return {
        "best": best,
        "share": float(bad.mean()),
        "kinds": {name: float(of[bad].mean()) if bad.any() else 0.0 for name, of in kinds.items()},
        "kinds_of_all": {name: float(of.mean()) for name, of in kinds.items()},
    }


def _errors(found: Materials, true: Materials, valid: Any) -> dict[str, Array]:
    """Absolute errors (P,) by map; of albedo the root mean square over channels."""
    albedo = np.sqrt(np.mean(np.square(found.albedo[valid] - true.albedo[valid]), axis=-1))
    return {
        "albedo": albedo,
        "roughness": np.abs(found.roughness[valid] - true.roughness[valid]),
        "metallic": np.abs(found.metallic[valid] - true.metallic[valid]),
    }


def _kinds(scene: Scene) -> dict[str, Any]:
    assert scene.truth is not None
    valid, true = scene.valid, scene.truth.materials
    cosine = np.einsum("pi,pi->p", scene.normals[valid], scene.views[valid])
    return {
        "grazing": cosine < GRAZING,
        "dark": true.albedo[valid].max(axis=-1) < DARK,
        "smooth": true.roughness[valid] < SMOOTH,
        "rough": true.roughness[valid] > ROUGH,
        "metal": true.metallic[valid] >= 0.5,
    }


def _best(errors: Array) -> Array:
    return np.asarray(np.sort(errors)[: max(1, int(BEST * errors.size))])


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
