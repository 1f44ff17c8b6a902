"""Parts "rooms", errors against the size of a disturbance, and "exact", without noise.

Without noise everything should come back. For scenes where it does not, it is told how much of the
picture is to blame, and whether what is left is a common turn of all normals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from pbrfit.model.geometry import angles_between
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normal_errors import Array
from pbrfit_evaluation.normals.disturbances import Disturbance, disturbed
from pbrfit_evaluation.normals.fits import NOISE, REFINE, decision, fit, off, room
from pbrfit_evaluation.scores import score

MAPS = ("albedo", "roughness", "metallic")

EXACT: tuple[Disturbance, ...] = ("correlated", "biased")
EXACT_DEGREES = 10.0
"""Disturbances without noise, and their size."""

MATERIAL, ANGLE = 1e-2, 0.3
"""Largest RMSE of a map, and largest mean angle in degrees, of a scene that came back."""

BEST = 0.95
"""Share of the pixels whose errors are told beside those of all."""

WRONG_DEGREES, WRONG_MATERIAL = 1.0, 0.05
"""A pixel beyond one of these is wrong."""

GRAZING, DARK, SMOOTH, ROUGH = 0.2, 0.1, 0.3, 0.9
"""Kinds of pixels: n·v below, largest albedo below, roughness below and above."""


Name = Literal["rooms", "exact"]


@dataclass(frozen=True)
class Case:
    """A scene under one disturbance; "true" in place of one leaves the true normals."""

    part: Name
    scene: str
    seed: int
    size: int
    disturbance: Disturbance | Literal["true"]
    degrees: float
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.part}_{self.disturbance}_{self.degrees:g}_{self.scene}_{self.seed}"

    @property
    def in_words(self) -> str:
        """What normals are given."""
        return f"{self.disturbance} {self.degrees:g}°" if self.degrees else "true normals"


def run(case: Case, threads: int) -> dict[str, Any]:
    """Scores, angles and decision of each fit; without noise, also what is wrong."""
    noisy = case.part == "rooms"
    scene = given = room(case.scene, case.seed, case.size, noise=NOISE if noisy else 0.0)
    if case.disturbance != "true":
        normals = disturbed(scene, case.disturbance, case.degrees, case.seed)
        given = replace(scene, normals=normals)
    found: dict[str, Any] = {"given": off(given.normals, scene.normals, scene.valid)}
    for refine in REFINE if noisy else REFINE[-1:]:
        if refine == "on" and noisy and found["auto"]["decision"]["refined"]:
            found[refine] = found["auto"]  # the same fit, but for the time before it
            continue
        result = fit(given, refine, iterations=case.iterations, threads=threads)
        found[refine] = {
            "scores": score(result, scene, threads).as_json(),
            "angle": off(result.normals, scene.normals, scene.valid),
            "decision": decision(result),
        }
        if not noisy:
            found["came_back"] = came_back(found[refine])
            found["wrong"] = wrong(scene, result)
    return found


def came_back(values: dict[str, Any]) -> bool:
    """Whether materials and normals of a scene are what they were."""
    maps = max(values["scores"][name] for name in MAPS)
    return bool(maps <= MATERIAL and values["angle"]["mean"] <= ANGLE)


def wrong(scene: Scene, result: Result) -> dict[str, Any]:
    """Where a fit differs from the ground truth.

    Returns
    -------
    dict
        "best": RMSE of the maps and mean angle over the best `BEST` of the pixels, each for itself.
        "share": of pixels that are wrong. "kinds": of what kind those are, as shares of them;
        "kinds_of_all": the same of all pixels.
    """
    assert scene.truth is not None
    valid, found, true = scene.valid, result.materials, scene.truth.materials
    off = angles_between(result.normals, scene.normals)[valid]
    errors = {name: (getattr(found, name) - getattr(true, name))[valid] for name in MAPS}
    errors["albedo"] = np.sqrt(np.mean(np.square(errors["albedo"]), axis=-1))
    errors = {name: np.abs(error) for name, error in errors.items()}
    best = {name: float(np.sqrt(np.mean(_best(error) ** 2))) for name, error in errors.items()}
    bad = (off > WRONG_DEGREES) | (np.max(list(errors.values()), axis=0) > WRONG_MATERIAL)
    kinds = {
        "grazing": np.einsum("hwi,hwi->hw", scene.normals, scene.views) < GRAZING,
        "dark": true.albedo.max(axis=-1) < DARK,
        "smooth": true.roughness < SMOOTH,
        "rough": true.roughness > ROUGH,
        "metal": true.metallic >= 0.5,
    }
    shares = {name: kind[valid] for name, kind in kinds.items()}
    return {
        "best": best | {"angle": float(_best(off).mean())},
        "share": float(bad.mean()),
        "kinds": {name: float(of[bad].mean()) if bad.any() else 0.0 for name, of in shares.items()},
        "kinds_of_all": {name: float(of.mean()) for name, of in shares.items()},
    }


def _best(errors: Array) -> Array:
    return np.asarray(np.sort(errors)[: max(1, int(BEST * errors.size))])
