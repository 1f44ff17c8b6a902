"""Whole fits of scenes that are hard on a solver: a finite answer, honest flags."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.random import Generator

from pbrfit.fit.decompose import decompose
from pbrfit.model.reflection import render
from pbrfit.result import metrics
from pbrfit.result.options import Priors
from pbrfit.result.result import Result
from pbrfit.result.verdict import levels
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.double_precision import ROUNDING
from pbrfit_evaluation.stability.stiff_scenes import StiffScene, stiff_scenes

FITS: dict[str, tuple[str, Priors | None]] = {
    "gauss-newton": ("gauss-newton", None),
    "lbfgsb": ("lbfgsb", None),
    "gauss-newton, priors": ("gauss-newton", Priors()),
}
"""Solver and priors by name."""

REFERENCE = "lbfgsb"
ABOVE_NONE = "gauss-newton"
"""The fit that must end no higher than the reference."""

FLOOR = 3e-7
"""Residuals below this share of the pictures' RMS are rounding of the float32 objective."""

RESIDUAL = "residual / RMS"

MAPS = ("albedo", "roughness", "metallic")


def measure(_: Generator, threads: int, size: int, pictures: int, iterations: int) -> Values:
    """Fit every scene by every solver."""
    rows: dict[str, dict[str, Any]] = {}
    for case in stiff_scenes(size, pictures):
        of_case = {}
        for name, (solver, priors) in FITS.items():
            options: Any = {"solver": solver, "priors": priors, "iterations": iterations}
            result = decompose(case.scene, refine_normals="off", threads=threads, **options)
            of_case[name] = facts(case, result, iterations)
        if {REFERENCE, ABOVE_NONE} <= of_case.keys():
            found, reference = (of_case[name][RESIDUAL] for name in (ABOVE_NONE, REFERENCE))
            of_case[ABOVE_NONE]["fits_above_lbfgsb"] = above(found, reference)
        rows |= {f"{case.name}; {name}": row for name, row in of_case.items()}
    return {"rows": rows}


def above(residual: float, reference: float) -> float:
    """How much one residual is above another, relative to it."""
    return max(residual, FLOOR) / max(reference, FLOOR) - 1


def facts(case: StiffScene, result: Result, iterations: int) -> dict[str, Any]:
    """What has to hold of a fit, and what else is told of it.

    Errors and shares are of the pixels that count. "fits_overlooked" are unknown maps of pixels
    that the pictures cannot tell, with a deviation that calls them usable.
    """
    found, truth, known = result.materials, case.scene.truth, result.uncertainty
    assert truth is not None
    assert known is not None
    of_pixels = levels(known.deviation)
    told = np.stack([of_pixels[name] for name in MAPS], axis=-1)[case.counted] > 0
    maps = {name: getattr(found, name) for name in MAPS}
    errors = {
        f"{name}\nRMSE": metrics.rmse(
            one[case.counted], getattr(truth.materials, name)[case.counted]
        )
        for name, one in maps.items()
    }
    shares = {
        f"{name}:\nshare that is\nnot usable": float(share)
        for name, share in zip(MAPS, told.mean(axis=0), strict=True)
    }
    done = int(result.history["iteration"][-1])
    return {
        **nonsense(result),
        "fits_iterations_over": max(0, done - iterations),
        "fits_overlooked": 0 if case.determined else int((~told).sum()),
        RESIDUAL: _residual(case, result),
        **errors,
        **shares,
        "iterations": done,
        "evaluations": result.evaluations,
        "seconds": result.seconds,
        "ended by": str(result.status).replace("_", " "),
    }


def nonsense(result: Result) -> dict[str, int]:
    """How many numbers of a fit are not finite, and how many of its maps are out of range.

    Beyond [0, 1]; of bounds also on the wrong side of the value, but for rounding to float32.
    """
    told = result.uncertainty
    assert told is not None
    value, deviation, low, high = (
        np.concatenate([getattr(of, name)[result.mask].ravel() for name in MAPS])
        for of in (result.materials, told.deviation, told.low, told.high)
    )
    lamps = () if result.lamps is None else (result.lamps.places, result.lamps.colors)
    others = (result.lighting, result.normals[result.mask], *lamps, list(result.metrics.values()))
    history = (result.history[name] for name in ("loss", "recon_rmse"))
    all_of = [np.ravel(of) for of in (value, deviation, low, high, *others, *history)]
    maps = np.concatenate([value, deviation, low, high])
    beyond = [maps < 0, maps > 1, low > value + ROUNDING, high < value - ROUNDING]
    return {
        "fits_not_finite": int(np.count_nonzero(~np.isfinite(np.concatenate(all_of)))),
        "fits_beyond": sum(int(np.count_nonzero(of)) for of in beyond),
    }


def _residual(case: StiffScene, result: Result) -> float:
    scene = case.scene
    rendered = render(
        *(result.materials, scene.normals, result.lighting, scene.fov), model=result.model
    )
    images = scene.images[:, case.counted].astype(np.float64)
    return metrics.rmse(rendered[:, case.counted], images) / math.sqrt(np.mean(images**2))
