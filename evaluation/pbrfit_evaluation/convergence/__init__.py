"""Error against run time: solvers, starts and peers on scenes of several sizes and difficulties."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from pbrfit._core import InputError
from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_option
from pbrfit_evaluation.convergence import figures
from pbrfit_evaluation.convergence.cases import CASES, Case, chosen, trial
from pbrfit_evaluation.convergence.measure import Budget, Tracker
from pbrfit_evaluation.convergence.solvers import BY_NAME, Task, asked
from pbrfit_evaluation.heldout.sources import find_sources
from pbrfit_evaluation.jobs import digest_of_files
from pbrfit_evaluation.options import count, option, several
from pbrfit_evaluation.suite import Options, Part, Suite

FIRST_SEED = 100
"""Seeds below 100 and from 200 on were used to choose constants, of this package and of peers."""

MOST_SEEDS = 100

REHEARSAL = Case("rehearsal", 8)
REHEARSAL_BUDGET = Budget(iterations=3, evaluations=3, seconds=60.0)


def tasks(options: Options) -> list[Task]:
    """All runs that are possible here, those of a seed one after the other.

    So a run that is broken off and resumed with fewer seeds is complete in those. `options.seconds`
    is where any run is cut off. On a quiet machine of two cores almost none is: iterations and
    evaluations are the limits, so that only a busy one makes results depend on its speed.

    Raises InputError if there are too many seeds, or not one set of real pictures where there
    should be.
    """
    if options.seeds > MOST_SEEDS:
        raise InputError(f"--seeds: expected at most {MOST_SEEDS}, found {options.seeds}")
    inputs = ""
    if options.real is not None:
        if not options.real.is_dir() or len(find_sources(options.real)) != 1:
            raise InputError(
                f"{options.real}: expected a folder of one view's pictures, found none"
            )
        inputs = digest_of_files(options.real)
    budget = Budget(options.iterations, options.evaluations, options.seconds)
    return [
        Task(case, solver.name, FIRST_SEED + i, budget, inputs if case.folder else "")
        for i in range(options.seeds)
        for case in chosen(options)
        for solver in asked(options)
        if not solver.why_not(case.model)
    ]


def run(task: Task, threads: int) -> dict[str, Any]:
    """Do one run, after a rehearsal off the clock that loads libraries and wakes threads."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    solver = BY_NAME[task.solver]
    scene, errors = trial(replace(REHEARSAL, model=task.case.model), 0, threads)
    solver.run(scene, REHEARSAL_BUDGET, Tracker(errors), threads)
    scene, errors = trial(task.case, task.seed, threads)
    tracker = Tracker(errors)
    reason = solver.run(scene, task.budget, tracker, threads)
    return {
        "points": tracker.points,
        "stop_reason": reason,
        "threads": threads,
        "load": load,
    }


SUITE = Suite(
    name="convergence",
    title="Error against run time",
    protocol="pbrfit-convergence-2, {effort}",
    parts=[Part.shown_by(figures, "runs", tasks, run)],
    options=(
        lambda parser: add_option(parser, "model", MODEL_OF_PICTURES, "paper"),
        count("--seeds", "K", "scenes of a case"),
        several("--cases", "NAME", CASES, default="all but the last two"),
        several("--solvers", "NAME", BY_NAME),
        option(
            "--real",
            metavar="DIR",
            type=Path,
            help="pictures of one view, whose truth nobody knows: a case for each size",
        ),
        count("--seconds", "S", "after which a run is cut off"),
    ),
    effort={
        "cases": (tuple(CASES)[:-2], tuple(CASES)[-2:]),
        "seeds": (2, 1),
        "iterations": (500, 200),
        "evaluations": (2000, 200),
        "seconds": (100, 20),
    },
    about=(
        "Errors of reconstruction, maps and relit pictures while a solver runs, for every solver "
        "on scenes of several sizes, noise levels and light matrices. Peers need PyTorch (pip "
        "install pbrfit-evaluation[peers]); they know the paper's model alone.",
        "Errors are RMSE in float64, measured from the maps and lights of a run whenever "
        "evaluations or seconds have grown by 12 %, for all solvers by the same function; “recon” "
        "against the pictures that were fitted, noise included, “relight” under the true held-out "
        "lights. Of real pictures a quarter is held out, and errors are relative. The clock does "
        "not run meanwhile, nor while libraries and a start that is handed in are made.",
        "A run of ours ends after so many iterations, one of a peer after so many evaluations, "
        "and any after so many seconds. At 512² the default is held against the others by when it "
        "reaches the reconstruction error that the paper's recipe ends at.",
    ),
    jobs=1,  # times mean something only if nothing else runs
    timed=True,
)
