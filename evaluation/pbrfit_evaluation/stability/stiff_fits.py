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
from pbrfit_evaluation.stability.double_precision import Array
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
        "fits_not_finite": sum(int(np.count_nonzero(~np.isfinite(a))) for a in _numbers(result)),
        "fits_beyond": sum(int(np.count_nonzero((a < 0) | (a > 1))) for a in maps.values()),
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


def _numbers(result: Result) -> list[Array]:
    """Every number that a fit hands back; all pixels of these scenes are valid."""
    known = result.uncertainty
    assert known is not None
    of_maps = (result.materials, known.deviation, known.low, known.high)
    maps = [getattr(values, name) for values in of_maps for name in MAPS]
    history = [result.history[name] for name in ("loss", "recon_rmse")]
    return [*maps, result.lighting, *history, np.array(list(result.metrics.values()))]


def _residual(case: StiffScene, result: Result) -> float:
    scene = case.scene
    rendered = render(
        *(result.materials, scene.normals, result.lighting, scene.fov), model=result.model
    )
    images = scene.images[:, case.counted].astype(np.float64)
    return metrics.rmse(rendered[:, case.counted], images) / math.sqrt(np.mean(images**2))
