"""Part "exact": pictures without noise, whose truth is a perfect fit, to the last digits.

Pictures are rendered in float64. Rounded once to float32, they leave a residual of about 1e-8 of
the picture at the truth itself; as they are, none but that of float64 arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.result import metrics
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.solvers.fits import (
    AUTO,
    FIRST_SEED,
    GAUSS_NEWTON,
    LBFGSB,
    Name,
    fit,
    in_float32,
    residual,
    rms,
    room,
)

RECON_FLOAT32 = 3e-8
"""Residual over RMS radiance that counts as exact where pictures are float32."""

RECON_FLOAT64 = 1e-12
MATERIAL = 1e-6
"""RMSE of a map that counts as exact."""

MAPS = ("albedo", "roughness", "metallic")

WRONG = 1e-4
"""A pixel is wrong if one of its numbers is off by more."""

LISTED = 20
"""Wrong pixels of a fit that are described one by one, the worst."""

DARK = 0.02
GRAZING = 0.1
SMOOTH, ROUGH = 0.1, 0.95
FLAT = 1e2
"""Conditional deviation of roughness, a unit of noise at mean radiance 0.4: noise of 1e-8 moves
such a pixel by 1e-6."""

FITS: tuple[tuple[str, Name, bool], ...] = (
    ("gauss-newton", GAUSS_NEWTON, True),
    ("auto", AUTO, True),
    ("lbfgsb", LBFGSB, True),
    ("gauss-newton, float64", GAUSS_NEWTON, False),
)
"""(Name, solver, whether the pictures are rounded to float32)."""


@dataclass(frozen=True)
class Task:
    """A room that every solver fits."""

    seed: int
    size: int
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"exact_{self.seed}"


def plan(scenes: int, size: int, iterations: int) -> list[Task]:
    """Rooms of table1's seeds."""
    return [Task(FIRST_SEED + i, size, iterations) for i in range(scenes)]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Errors of each fit, and what is wrong where some pixels are."""
    scene = room(task.seed, task.size, held_out=1)
    rounded = in_float32(scene)
    return {
        name: _outcome(rounded if in32 else scene, solver, task.iterations, threads)
        for name, solver, in32 in FITS
    }


def _outcome(scene: Scene, solver: Name, iterations: int, threads: int) -> dict[str, Any]:
    assert scene.truth is not None
    result = fit(scene, solver, priors=None, iterations=iterations, threads=threads)
    found, true = result.materials, scene.truth.materials
    errors = {name: metrics.rmse(getattr(found, name), getattr(true, name)) for name in MAPS}
    return {
        "recon": residual(scene, result, threads) / rms(scene),
        **errors,
        "seconds": result.seconds,
        "evaluations": result.evaluations,
        "stop_reason": result.stop_reason,
        "wrong": describe_wrong(scene, result),
    }


def describe_wrong(scene: Scene, result: Result) -> dict[str, Any]:
    """How many pixels are wrong, how many of them are of which kind, and the worst one by one.

    A pixel can be of several kinds, or of none.
    """
    assert scene.truth is not None
    true, found = scene.truth.materials, result.materials
    off = np.stack(
        [
            np.abs(found.albedo - true.albedo).max(axis=-1),
            np.abs(found.roughness - true.roughness),
            np.abs(found.metallic - true.metallic),
        ],
        axis=-1,
    )
    worst = np.where(scene.valid, off.max(axis=-1), 0.0)
    wrong = worst > WRONG
    radiance = scene.images.mean(axis=(0, -1), dtype=np.float64)
    cosine = np.einsum("hwi,hwi->hw", scene.normals, scene.views)
    flat = _conditional_roughness(scene, result)
    kinds: dict[str, NDArray[np.bool_]] = {
        "dark": radiance < DARK,
        "grazing": cosine < GRAZING,
        "smooth": true.roughness < SMOOTH,
        "rough": true.roughness > ROUGH,
        "metal": true.metallic >= 0.5,
        "flat": flat > FLAT,
    }
    places = np.argwhere(wrong)
    order = np.argsort(-worst[wrong], kind="stable")[:LISTED]
    return {
        "count": int(wrong.sum()),
        "kinds": {name: int((kind & wrong).sum()) for name, kind in kinds.items()},
        "worst": [
            {
                "pixel": [int(y), int(x)],
                "off": off[y, x].tolist(),
                "roughness": [float(true.roughness[y, x]), float(found.roughness[y, x])],
                "metallic": [float(true.metallic[y, x]), float(found.metallic[y, x])],
                "radiance": float(radiance[y, x]),
                "cosine": float(cosine[y, x]),
                "deviation": float(flat[y, x]),
            }
            for y, x in places[order]
        ],
    }


def _conditional_roughness(scene: Scene, result: Result) -> NDArray[np.float64]:
    """(H, W): deviation of roughness given the lights, a unit of noise; 0 where nothing is told."""
    known = result.uncertainty
    if known is None or not known.noise:
        return np.zeros(scene.valid.shape)
    return np.asarray(known.conditional.roughness / known.noise)


def is_exact(outcome: Mapping[str, Any], recon: float = RECON_FLOAT32) -> bool:
    """Whether residual and maps are within their bounds."""
    return bool(outcome["recon"] <= recon and all(outcome[name] <= MATERIAL for name in MAPS))
