"""Part "exact": pictures without noise, whose ground truth is a perfect fit, to the last digits.

Pictures are rendered in float64. Rounded once to float32, they leave a residual of about 1e-8 of
the picture at the ground truth itself; as they are, none but that of float64 arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from pbrfit.result import metrics
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.solvers.fits import (
    AUTO,
    GAUSS_NEWTON,
    LBFGSB,
    Case,
    Name,
    fit,
    in_float32,
    residual,
    rms,
    room,
)

RECON_FLOAT32, RECON_FLOAT64 = 3e-8, 1e-12
"""Residual relative to the pictures' RMS that counts as exact, by the precision of the pictures."""

MATERIAL = 1e-6
"""RMSE of a map that counts as exact."""

MAPS = ("albedo", "roughness", "metallic")

FITS: dict[str, tuple[Name, float]] = {
    "gauss-newton": (GAUSS_NEWTON, RECON_FLOAT32),
    "auto": (AUTO, RECON_FLOAT32),
    "lbfgsb": (LBFGSB, RECON_FLOAT32),
    "gauss-newton, float64": (GAUSS_NEWTON, RECON_FLOAT64),
}
"""Solver and largest residual by name; pictures of all but the last are rounded to float32."""

WRONG = 1e-4
"""A pixel is wrong if one of its numbers is off by more."""

DARK, GRAZING, SMOOTH, ROUGH = 0.02, 0.1, 0.1, 0.95
"""Kinds of wrong pixels: mean radiance below, n·v below, roughness below and above."""

FLAT = 1e2
"""Deviation of roughness, lights known, for each unit of noise at mean radiance 0.4, from which a
pixel counts as flat: noise of 1e-8 moves it by 1e-6."""


def run(case: Case, threads: int) -> dict[str, Any]:
    """Errors of each fit, and what is wrong where some pixels are."""
    scene = room(case.seed, case.size, held_out=1)
    rounded = in_float32(scene)
    return {
        name: _outcome(
            rounded if bound == RECON_FLOAT32 else scene, solver, bound, case.iterations, threads
        )
        for name, (solver, bound) in FITS.items()
    }


def _outcome(
    scene: Scene, solver: Name, bound: float, iterations: int, threads: int
) -> dict[str, Any]:
    assert scene.truth is not None
    result = fit(scene, solver, priors=None, iterations=iterations, threads=threads)
    found, true = result.materials, scene.truth.materials
    errors = {name: metrics.rmse(getattr(found, name), getattr(true, name)) for name in MAPS}
    recon = residual(scene, result, threads) / rms(scene)
    return {
        "exact": is_exact(recon, errors.values(), bound),
        "recon": recon,
        **errors,
        "worst_map": max(errors.values()),
        "seconds": result.seconds,
        "evaluations": result.evaluations,
        "stop_reason": result.stop_reason,
        "wrong": describe_wrong(scene, result),
    }


def describe_wrong(scene: Scene, result: Result) -> dict[str, Any]:
    """How many pixels are wrong, how many of them are of which kind, and the worst.

    A pixel can be of several kinds, or of none.
    """
    assert scene.truth is not None
    true, found = scene.truth.materials, result.materials
    off = np.maximum(
        np.abs(found.albedo - true.albedo).max(axis=-1),
        np.abs(found.roughness - true.roughness),
    )
    off = np.where(scene.valid, np.maximum(off, np.abs(found.metallic - true.metallic)), 0.0)
    wrong = off > WRONG
    radiance = scene.images.mean(axis=(0, -1), dtype=np.float64)
    cosine = np.einsum("hwi,hwi->hw", scene.normals, scene.views)
    known = result.uncertainty
    deviation = known.conditional.roughness / known.noise if known and known.noise else 0 * off
    kinds = {
        "dark": radiance < DARK,
        "grazing": cosine < GRAZING,
        "smooth": true.roughness < SMOOTH,
        "rough": true.roughness > ROUGH,
        "metal": true.metallic >= 0.5,
        "flat": deviation > FLAT,
    }
    y, x = np.unravel_index(np.argmax(off), off.shape)
    facts = {"off": off, "radiance": radiance, "n·v": cosine, "deviation": deviation}
    facts |= {"roughness": true.roughness, "roughness found": found.roughness}
    facts |= {"metallic": true.metallic, "metallic found": found.metallic}
    return {
        "count": int(wrong.sum()),
        **{name: int((kind & wrong).sum()) for name, kind in kinds.items()},
        "worst": {"y": int(y), "x": int(x)} | {name: float(of[y, x]) for name, of in facts.items()},
    }


def is_exact(recon: float, errors: Iterable[float], bound: float = RECON_FLOAT32) -> bool:
    """Whether residual and maps are within their bounds."""
    return recon <= bound and all(error <= MATERIAL for error in errors)
