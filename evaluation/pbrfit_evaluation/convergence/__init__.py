"""Error against run time: solvers, starts and peers on scenes of several sizes and difficulties."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from typing import Any

from pbrfit._core import InputError
from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_option
from pbrfit.synthetic.lights import condition
from pbrfit_evaluation.convergence import figures
from pbrfit_evaluation.convergence.cases import CASES, Case, chosen, make, true_lighting
from pbrfit_evaluation.convergence.measure import Budget, Tracker
from pbrfit_evaluation.convergence.solvers import BY_NAME, SOLVERS, Task
from pbrfit_evaluation.options import count
from pbrfit_evaluation.suite import Options, Part, Suite

FIRST_SEED = 100
"""Seeds below 100 and from 200 on were used to choose constants, of this package and of peers."""

MOST_SEEDS = 100

REHEARSAL = Case("rehearsal", 8, 0.0, "typical")
REHEARSAL_BUDGET = Budget(iterations=3, evaluations=3, seconds=60.0)


def tasks(options: Options) -> list[Task]:
    """All runs that are possible here, those of a seed one after the other.

    So a run that is broken off and resumed with fewer seeds is complete in those. `options.seconds`
    is where any run is cut off, for a picture of 64²; larger pictures have as much more as they
    have pixels. On a quiet machine of two cores none is: iterations and evaluations are the limits,
    so that only a busy one makes results depend on its speed.

    Raises
    ------
    InputError
        If there are too many seeds.
    """
    if options.seeds > MOST_SEEDS:
        raise InputError(f"--seeds: expected at most {MOST_SEEDS}, found {options.seeds}")
    return [
        Task(case, solver.name, FIRST_SEED + i, budget)
        for i in range(options.seeds)
        for case in chosen(options)
        for seconds in [options.seconds * max(1.0, (case.size / 64) ** 2)]
        for budget in [Budget(options.iterations, options.evaluations, seconds)]
        for solver in SOLVERS
        if not solver.why_not(case.model, case.size)
    ]


def run(task: Task, threads: int) -> dict[str, Any]:
    """Do one run, after a rehearsal off the clock that loads libraries and wakes threads."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    solver = BY_NAME[task.solver]
    rehearsal = make(replace(REHEARSAL, model=task.case.model), seed=0)
    solver.run(rehearsal, REHEARSAL_BUDGET, Tracker(rehearsal, threads), threads)
    scene = make(task.case, task.seed)
    tracker = Tracker(scene, threads)
    reason = solver.run(scene, task.budget, tracker, threads)
    return {
        "points": tracker.points,
        "stop_reason": reason,
        "condition": condition(true_lighting(scene)),
        "threads": threads,
        "load": load,
    }


SUITE = Suite(
    name="convergence",
    title="Error against run time",
    description="Run every solver on scenes of several sizes, noise levels and light matrices, and "
    "measure the errors of reconstruction, maps and relit pictures on the way. Writes report.html, "
    "a plot a quantity, convergence.md, curves.csv and summary.json. Exit code 1 if the "
    "second-order solver is not as much sooner than others as it must be. Peers need PyTorch: pip "
    "install pbrfit-evaluation[peers]; they know the paper's model alone.",
    protocol="pbrfit-convergence-1, {effort}",
    parts=[
        Part(
            "runs",
            tasks,
            run,
            figures.rows,
            verdicts=figures.verdicts,
            sections=figures.sections,
            csvs=figures.csvs,
        ),
    ],
    options=(
        lambda parser: add_option(parser, "model", MODEL_OF_PICTURES, "paper"),
        count("--seeds", "K", "scenes of a case"),
    ),
    effort={
        "cases": (tuple(CASES)[:-2], tuple(CASES)[-2:]),
        "seeds": (3, 1),
        "iterations": (500, 200),
        "evaluations": (2000, 200),
        "seconds": (60.0, 20.0),
    },
    quick="half a minute: two cases of 24 × 24 pixels, few steps",
    about=(
        "Errors are RMSE in float64, measured from the maps and lights of a run at numbers of "
        "evaluations that grow by 12 %, for all solvers by the same function; “recon” against the "
        "pictures that were fitted, noise included, “relight” under the true held-out lights. The "
        "clock does not run meanwhile, nor while libraries and a start that is handed in are made.",
        "A run of ours ends after so many iterations, one of a peer after so many evaluations, and "
        "any after so many seconds (more above 64², in proportion to the pixels).",
        "At 512² the second-order solver is held against the others by when it reaches the "
        "reconstruction error that the paper's recipe ends at.",
    ),
    jobs=1,  # times mean something only if nothing else runs
    timed=True,
    verdict_rows=True,
)
