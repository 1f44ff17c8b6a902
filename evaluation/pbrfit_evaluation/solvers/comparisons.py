"""Parts that compare fits of one scene: "noise", "start", "gap" and "priors"."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, cast

from pbrfit.fit.objective import Objective
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene
from pbrfit.synthetic.scenes import ADDED_KINDS
from pbrfit.synthetic.scenes import KINDS as ALWAYS
from pbrfit_evaluation.ablation.cases import CaseName
from pbrfit_evaluation.ablation.cases import case as ablation_case
from pbrfit_evaluation.recipes import PAPER_PRIORS, explain
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.solvers.fits import (
    AUTO,
    GAUSS_NEWTON,
    LBFGSB,
    PICTURES,
    Case,
    clean_residual,
    fit,
    objective_value,
    room,
)
from pbrfit_evaluation.table1 import measure
from pbrfit_evaluation.table1.rows import BY_KEY

# ----------------------------------------------------------------------------------------- noise

LEVELS = (0.004, 0.01)
"""Standard deviations of the noise, in radiance: 1 % of the mean radiance of 0.4, as in the
convergence suite, and 1 % of a radiance of 1, as in the ablation."""

FROM_TRUTH = "gauss-newton from the ground truth"
NOISE_FITS = (FROM_TRUTH, "gauss-newton", "auto", "lbfgsb", "auto, priors", "lbfgsb, priors")


def run_noise(case: Case, threads: int) -> dict[str, Any]:
    """Objective (data term, float64) of each fit, also over the mark, less 1; and scores.

    The mark is the lower of L-BFGS-B's, and that of Gauss-Newton from the ground truth, which no
    search for a start can be blamed for.
    """
    scene = room(case.seed, case.size, noise=case.noise or 0.0)
    truth = scene.truth
    assert truth is not None
    common: dict[str, Any] = {"iterations": case.iterations, "threads": threads}
    plain = common | {"priors": None}
    start = truth.materials, truth.lighting
    results = {
        FROM_TRUTH: fit(scene, GAUSS_NEWTON, start=start, **plain),
        "gauss-newton": fit(scene, GAUSS_NEWTON, **plain),
        "auto": fit(scene, AUTO, **plain),
        "lbfgsb": fit(scene, LBFGSB, **plain),
        "auto, priors": fit(scene, AUTO, **common),
        "lbfgsb, priors": fit(scene, LBFGSB, **common),
    }
    objectives = {name: objective_value(scene, r, threads=threads) for name, r in results.items()}
    mark = min(objectives[FROM_TRUTH], objectives["lbfgsb"])
    return {
        name: {
            **score(result, scene, threads).as_json(),
            "objective": objectives[name],
            "above_mark": objectives[name] / mark - 1,
            "stop_reason": result.stop_reason,
        }
        for name, result in results.items()
    }


# ----------------------------------------------------------------------------------------- start

KINDS: tuple[str, ...] = (*ALWAYS, *ADDED_KINDS)
NOISES = (0.0, 0.01)

SETTINGS: dict[str, tuple[Priors | None, Literal["none", "huber"]]] = {
    "plain": (None, "none"),
    "smoothness": (replace(Priors.none(), smoothness=PAPER_PRIORS.smoothness), "none"),
    "cohesion": (replace(Priors.none(), cohesion=PAPER_PRIORS.cohesion), "none"),
    "paper's priors": (PAPER_PRIORS, "none"),
    "huber": (None, "huber"),
}
"""Objectives that do not change while a fit runs, but for the scale of the robust loss."""


def run_start(case: Case, threads: int) -> dict[str, Any]:
    """Objective of both solvers by setting.

    Each estimates the scale of a robust loss from its own residuals, so both are compared at that
    of the L-BFGS-B fit.
    """
    scene = make_scene(
        case.variant,
        size=case.size,
        lights=PICTURES,
        held_out=1,
        seed=case.seed,
        noise=case.noise or 0.0,
    )
    found = {}
    for name, (priors, loss) in SETTINGS.items():
        options: dict[str, Any] = {
            "priors": priors,
            "robust": loss,
            "iterations": case.iterations,
            "threads": threads,
            "uncertainty": False,
        }
        reference, ours = (fit(scene, solver, **options) for solver in (LBFGSB, AUTO))
        robust = None
        if loss != "none":
            objective = Objective(scene, threads=threads, model=reference.model)
            maps = reference.materials
            x = objective.pack(maps.albedo, maps.roughness, maps.metallic, reference.lighting)
            robust = objective.robust_around(x, loss)
        lower, value = (
            objective_value(scene, result, priors=priors, robust=robust, threads=threads)
            for result in (reference, ours)
        )
        found[name] = {
            "lbfgsb": lower,
            "auto": value,
            "seconds": {"lbfgsb": reference.seconds, "auto": ours.seconds},
            "stop_reason": ours.stop_reason,
        }
    return found


# ------------------------------------------------------------------------------------------- gap

ROWS = ("sh2", "fov90", "normals")
CYCLES_ROWS = (
    *("cycles-brdf", "cycles-shadows", "cycles-panorama", "cycles-points", "cycles-detailed"),
)
"""Rows of table1 whose pictures the model cannot explain: a lower loss can mean worse maps."""


def run_gap(case: Case, threads: int) -> dict[str, Any]:
    """Scores of `auto` as it is, and of the paper's recipe, L-BFGS-B in one stage, no priors."""
    row = BY_KEY[case.variant]
    told = measure.Task(
        row.key,
        case.seed,
        case.size,
        PICTURES,
        case.iterations,
        cycles_cache=case.cycles_cache,
    )
    scene, facts = measure.given(told, threads)
    common: dict[str, Any] = {
        "iterations": case.iterations,
        "sh_order": row.sh_order,
        "threads": threads,
    }
    ours = fit(scene, AUTO, **common)
    return {
        "facts": facts,
        "auto": score(ours, scene, threads).as_json(),
        "paper": score(explain(scene, "paper", **common), scene, threads).as_json(),
        "stop_reason": ours.stop_reason,
    }


# ---------------------------------------------------------------------------------------- priors

PRIORS_CASES: dict[str, float] = {
    "constant": 0.5,
    "shifted": 0.5,
    "merged": 0.5,
    "none": 0.5,
    "varying": 0.8,
}
"""The ablation's cases, and the largest ratio of the roughness RMSE to that without priors."""


def run_priors(case: Case, threads: int) -> dict[str, Any]:
    """Scores of `auto` without and with the default priors.

    "clean" is the reconstruction against the pictures without their noise: a prior can only raise
    the residual of those with it.
    """
    scene = ablation_case(cast("CaseName", case.variant), case.seed, size=case.size)
    common: dict[str, Any] = {"iterations": case.iterations, "threads": threads}
    results = {
        "none": fit(scene, AUTO, priors=None, **common),
        "default": fit(scene, AUTO, **common),
    }
    return {
        name: score(result, scene, threads).as_json()
        | {"clean": clean_residual(scene, result, threads)}
        for name, result in results.items()
    }
