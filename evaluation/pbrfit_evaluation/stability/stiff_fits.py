"""Whole fits of scenes that are hard on a solver: a finite answer, known limits, honest flags."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from pbrfit.fit.decompose import decompose
from pbrfit.model.reflection import render
from pbrfit.result import metrics
from pbrfit.result.options import Priors
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.measure import Array, Effort, Figure, count, worst
from pbrfit_evaluation.stability.stiff_scenes import StiffScene, stiff_scenes

SOLVERS: tuple[str, ...] = ("auto", "gauss-newton", "lbfgsb")
REFERENCE = "lbfgsb"
ABOVE_NONE = "auto"
"""The solver that must end no higher than the reference."""

WITH_PRIORS = ", priors"
"""Marks fits with the default priors; all others have none."""

FLOOR = 3e-7
"""Residuals below this share of the pictures' RMS are rounding of the float32 objective."""

LIMITS = (0, 1, 3)
SHORT_SHARE = 0.2
"""A time limit that ends a fit on the way, as a share of the seconds of a whole fit."""

MAPS = ("albedo", "roughness", "metallic")


@dataclass(frozen=True)
class Fit:
    """A line of the table.

    Attributes
    ----------
    recon
        Residual over the pictures' RMS, of the pixels that count.
    errors
        RMSE by map, likewise.
    undetermined
        Share of these pixels in which the map is flagged, or held on a bound.
    overlooked
        Unknown maps of pixels that the pictures cannot tell, without a flag.
    not_finite, beyond, over_limit
        Numbers that are infinite or not a number, numbers of maps beyond [0, 1], and iterations
        beyond the limit.
    """

    scene: str
    solver: str
    recon: float
    errors: Mapping[str, float]
    undetermined: Mapping[str, float]
    overlooked: int
    not_finite: int
    beyond: int
    over_limit: int
    iterations: int
    evaluations: int
    seconds: float
    status: str


def measure(effort: Effort, _: Generator, threads: int) -> Values:
    """Fit every scene by every solver; then limits and threads on some."""
    cases = stiff_scenes(effort.fit_size, effort.fit_pictures)
    options = {"iterations": effort.fit_iterations, "threads": threads, "priors": None}
    fits = [fit for case in cases for fit in _fits_of(case, options)]
    short = {**options, "uncertainty": False}
    figures = of_fits(fits) | _limits(cases[0].scene, short) | _threads(cases, short)
    return {"figures": figures, "fits": [asdict(fit) for fit in fits]}


def _fits_of(case: StiffScene, options: Mapping[str, Any]) -> list[Fit]:
    fits = [_fit(case, solver, solver, options) for solver in SOLVERS]
    if ABOVE_NONE in SOLVERS:
        name = f"{ABOVE_NONE}{WITH_PRIORS}"
        fits.append(_fit(case, name, ABOVE_NONE, {**options, "priors": Priors()}))
    return fits


def _fit(case: StiffScene, name: str, solver: str, options: Mapping[str, Any]) -> Fit:
    result = _decompose(case.scene, solver, **options)
    found, truth, known = result.materials, case.scene.truth, result.uncertainty
    assert truth is not None
    assert known is not None
    unflagged = ~(known.undetermined | known.on_bound)[case.counted]
    pairs = {name: (getattr(found, name), getattr(truth.materials, name)) for name in MAPS}
    iterations = _iterations(result)
    return Fit(
        scene=case.name,
        solver=name,
        recon=_recon(case, result),
        errors={
            name: metrics.rmse(one[case.counted], true[case.counted])
            for name, (one, true) in pairs.items()
        },
        undetermined=dict(zip(MAPS, (1 - unflagged.mean(axis=0)).tolist(), strict=True)),
        overlooked=0 if case.determined else int(unflagged.sum()),
        not_finite=sum(int(np.count_nonzero(~np.isfinite(a))) for a in _numbers(result)),
        beyond=sum(int(np.count_nonzero((a < 0) | (a > 1))) for a, _ in pairs.values()),
        over_limit=max(0, iterations - int(options["iterations"])),
        iterations=iterations,
        evaluations=result.evaluations,
        seconds=result.seconds,
        status=str(result.status),
    )


def _decompose(scene: Scene, solver: str, **options: Any) -> Result:
    chosen: Any = solver
    return decompose(scene, solver=chosen, refine_normals="off", **options)


def _iterations(result: Result) -> int:
    return int(result.history["iteration"][-1])


def _numbers(result: Result) -> list[Array]:
    """Every number that a fit hands back; all pixels of these scenes are valid."""
    known = result.uncertainty
    assert known is not None
    maps = [
        getattr(m, n) for m in (result.materials, known.conditional, known.marginal) for n in MAPS
    ]
    history = [result.history[name] for name in ("loss", "recon_rmse")]
    return [*maps, result.lighting, *history, np.array(list(result.metrics.values()))]


def _recon(case: StiffScene, result: Result) -> float:
    scene = case.scene
    rendered = render(
        *(result.materials, scene.normals, result.lighting, scene.fov), model=result.model
    )
    images = scene.images[:, case.counted].astype(np.float64)
    return metrics.rmse(rendered[:, case.counted], images) / math.sqrt(np.mean(images**2))


def of_fits(fits: Sequence[Fit]) -> dict[str, Figure]:
    """Figures of what has to hold of each fit."""
    by_name = {(fit.scene, fit.solver): fit for fit in fits}
    above = {
        scene: max(by_name[scene, ABOVE_NONE].recon, FLOOR) / max(reference.recon, FLOOR) - 1
        for (scene, solver), reference in by_name.items()
        if solver == REFERENCE and (scene, ABOVE_NONE) in by_name
    }
    counted = {
        "fits_not_finite": "not_finite",
        "fits_beyond": "beyond",
        "fits_iterations_over": "over_limit",
        "fits_overlooked": "overlooked",
    }
    return {
        key: count({f"{fit.scene}, {fit.solver}": getattr(fit, of) for fit in fits}, "fits")
        for key, of in counted.items()
    } | ({"fits_above_lbfgsb": worst(above)} if above else {})


def _limits(scene: Scene, options: Mapping[str, Any]) -> dict[str, Figure]:
    """What a fit does beyond its limits, by every solver."""
    over, more, late = {}, {}, {}
    for solver in SOLVERS:
        whole = _decompose(scene, solver, **options)
        start = None
        for limit in LIMITS:
            result = _decompose(scene, solver, **{**options, "iterations": limit})
            start = start or result
            over[f"{solver}, {limit} iterations"] = max(0, _iterations(result) - limit)
        assert start is not None
        none = _decompose(scene, solver, **options, time_limit=0.0)
        more[f"{solver}, 0 s"] = max(0, none.evaluations - start.evaluations)
        limit_s = SHORT_SHARE * whole.seconds
        short = _decompose(scene, solver, **options, time_limit=limit_s)
        late[f"{solver}, {limit_s:.2g} s"] = (short.seconds - limit_s) / whole.seconds
    return {
        "fits_limit_over": count(over, "fits"),
        "fits_time_evaluations": worst(dict(more)),
        "fits_late": worst(late),
    }


def _threads(cases: list[StiffScene], options: Mapping[str, Any]) -> dict[str, Figure]:
    """Bits that differ between one thread and three, where rounding is blown up most."""
    differing = {}
    for case in (cases[0], cases[len(cases) // 4]):
        for solver in SOLVERS:
            first, second = (
                _bits(_decompose(case.scene, solver, **{**options, "threads": threads}))
                for threads in (1, 3)
            )
            differing[f"{case.name}, {solver}"] = int(np.count_nonzero(first != second))
    return {"fits_threads": count(differing, "fits")}


def _bits(result: Result) -> Any:
    maps = result.materials
    parts = (maps.albedo, maps.roughness, maps.metallic, result.lighting)
    return np.concatenate([np.asarray(p, np.float64).ravel() for p in parts]).view(np.uint64)
