"""Whole fits of scenes that are hard on a solver: a finite answer, known limits, honest flags."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pbrfit.fit.decompose import decompose
from pbrfit.model.reflection import render
from pbrfit.result import metrics
from pbrfit.result.options import Priors
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.stability.checks import Array, Check, worst_of
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.stiff_scenes import StiffScene, stiff_scenes

SOLVERS: tuple[str, ...] = ("auto", "gauss-newton", "lbfgsb")
REFERENCE = "lbfgsb"
ABOVE_NONE = "auto"
"""The solver that must end no higher than the reference."""

WITH_PRIORS = ", priors"
"""Marks fits with the default priors; all others have none."""

FLOOR = 3e-7
"""Residuals below this share of the pictures' RMS are rounding of the float32 objective."""

LEVEL = 1e-6

LIMITS = (0, 1, 3)
SHORT_SHARE = 0.2
"""Of the seconds of a whole fit: a time limit that ends it on the way."""

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


@dataclass(frozen=True, eq=False)
class StiffFits:
    """All fits."""

    checks: tuple[Check, ...]
    fits: tuple[Fit, ...]


def measure_stiff_fits(effort: Effort, threads: int) -> StiffFits:
    """Fit every scene by every solver; then limits and threads on some."""
    cases = stiff_scenes(effort.fit_size, effort.fit_pictures)
    options: dict[str, Any] = {
        "iterations": effort.fit_iterations,
        "threads": threads,
        "priors": None,
    }
    fits = tuple(fit for case in cases for fit in _fits_of(case, options))
    checks = [*of_fits(fits), *_limits(cases[0].scene, options), _threads(cases, options)]
    return StiffFits(tuple(checks), fits)


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
    silent = ~(known.undetermined | known.on_bound)[case.counted]
    iterations = int(result.history["iteration"][-1])
    return Fit(
        scene=case.name,
        solver=name,
        recon=_recon(case, result),
        errors={
            name: metrics.rmse(
                getattr(found, name)[case.counted], getattr(truth.materials, name)[case.counted]
            )
            for name in MAPS
        },
        undetermined=dict(zip(MAPS, (1 - silent.mean(axis=0)).tolist(), strict=True)),
        overlooked=0 if case.determined else int(silent.sum()),
        not_finite=sum(int(np.count_nonzero(~np.isfinite(a))) for a in _numbers(result)),
        beyond=sum(
            int(np.count_nonzero((a < 0) | (a > 1)))
            for a in (found.albedo, found.roughness, found.metallic)
        ),
        over_limit=max(0, iterations - int(options["iterations"])),
        iterations=iterations,
        evaluations=result.evaluations,
        seconds=result.seconds,
        status=str(result.status),
    )


def _decompose(scene: Scene, solver: str, **options: Any) -> Result:
    chosen: Any = solver
    return decompose(scene, solver=chosen, refine_normals="off", **options)


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


def of_fits(fits: Sequence[Fit]) -> list[Check]:
    """What has to hold of each fit."""
    by_name = {(fit.scene, fit.solver): fit for fit in fits}
    names = {f"{fit.scene}, {fit.solver}": fit for fit in fits}
    above = {
        scene: max(by_name[scene, ABOVE_NONE].recon, FLOOR) / max(reference.recon, FLOOR) - 1
        for (scene, solver), reference in by_name.items()
        if solver == REFERENCE and (scene, ABOVE_NONE) in by_name
    }
    checks = [
        _count(
            "fits_not_finite",
            "numbers of fits that are infinite or not a number",
            {name: fit.not_finite for name, fit in names.items()},
            "Maps, lights, deviations, history: whatever the pictures leave open has to be some "
            "number.",
        ),
        _count(
            "fits_beyond",
            "numbers of maps beyond [0, 1]",
            {name: fit.beyond for name, fit in names.items()},
            "Bounds hold at every step.",
        ),
        _count(
            "fits_iterations_over",
            "iterations beyond the limit",
            {name: fit.over_limit for name, fit in names.items()},
            "No loop without an end, however singular the equations are.",
        ),
        _count(
            "fits_overlooked",
            "unknowns that pictures cannot tell, neither flagged nor on a bound",
            {name: fit.overlooked for name, fit in names.items()},
            "With equal lights, or with one picture, a pixel has three numbers for five unknowns.",
        ),
    ]
    if above:
        where, worst = worst_of(above)
        checks.append(
            Check(
                "fits_above_lbfgsb",
                f"residual of {ABOVE_NONE} over that of {REFERENCE}, less 1",
                worst,
                LEVEL,
                "It ends no higher, but for what float32 sums can differ by; residuals below "
                "3·10⁻⁷ of the pictures count as that.",
                where,
            )
        )
    return checks


def _count(key: str, what: str, counts: Mapping[str, int], why: str) -> Check:
    where, worst = worst_of(dict(counts))
    return Check(key, what, sum(counts.values()), 0, why, where if worst else f"{len(counts)} fits")


def _limits(scene: Scene, options: Mapping[str, Any]) -> list[Check]:
    """What a fit does beyond its limits, by every solver."""
    options = {**options, "uncertainty": False}
    over, more, late = {}, {}, {}
    for solver in SOLVERS:
        whole = _decompose(scene, solver, **options)
        start = None
        for limit in LIMITS:
            result = _decompose(scene, solver, **{**options, "iterations": limit})
            start = start or result
            iterations = int(result.history["iteration"][-1])
            over[f"{solver}, {limit} iterations"] = max(0, iterations - limit)
        assert start is not None
        none = _decompose(scene, solver, **options, time_limit=0.0)
        more[f"{solver}, 0 s"] = max(0, none.evaluations - start.evaluations)
        limit_s = SHORT_SHARE * whole.seconds
        short = _decompose(scene, solver, **options, time_limit=limit_s)
        late[f"{solver}, {limit_s:.2g} s"] = (short.seconds - limit_s) / whole.seconds
    where, latest = worst_of(late)
    return [
        _count(
            "fits_limit_over",
            f"iterations beyond a limit of {', '.join(map(str, LIMITS))}",
            over,
            "A limit is a limit in every stage.",
        ),
        Check(
            "fits_time_evaluations",
            "evaluations after the start with a time limit of 0",
            max(more.values()),
            1,
            "At most the one that was under way.",
            worst_of(dict(more))[0],
        ),
        Check(
            "fits_late",
            "time beyond a limit of a fifth of a fit, over the whole fit's",
            latest,
            None,
            "At most a step; a clock decides no verdict.",
            where,
        ),
    ]


def _threads(cases: list[StiffScene], options: Mapping[str, Any]) -> Check:
    """Bits that differ between one thread and three, where rounding is blown up most."""
    options = {**options, "uncertainty": False}
    differing = {}
    for case in (cases[0], cases[len(cases) // 4]):
        for solver in SOLVERS:
            first, second = (
                _bits(_decompose(case.scene, solver, **{**options, "threads": threads}))
                for threads in (1, 3)
            )
            differing[f"{case.name}, {solver}"] = int(np.count_nonzero(first != second))
    return _count(
        "fits_threads",
        "numbers of a fit that differ between 1 and 3 threads",
        differing,
        "To the last bit, through every stage.",
    )


def _bits(result: Result) -> Any:
    maps = result.materials
    parts = (maps.albedo, maps.roughness, maps.metallic, result.lighting)
    return np.concatenate([np.asarray(p, np.float64).ravel() for p in parts]).view(np.uint64)
