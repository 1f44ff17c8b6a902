"""Every way to fit a scene that the suite compares. A new solver is one more entry in `SOLVERS`.

All but the first minimise the same objective, that without priors.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from pbrfit._core import InputError
from pbrfit.fit.decompose import Progress, decompose
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.convergence import torch_peer
from pbrfit_evaluation.convergence.measure import Budget, Case, Tracker, chosen, trial
from pbrfit_evaluation.heldout.sources import find_sources
from pbrfit_evaluation.jobs import digest_of_files
from pbrfit_evaluation.recipes import paper_start
from pbrfit_evaluation.suite import Options

Run = Callable[[Scene, Budget, Tracker, int], str]
"""Fits a scene with so many threads, shows the tracker its states, returns why it ended."""


@dataclass(frozen=True)
class Solver:
    """One of those that are compared: a name for files and tables, a sentence, and what runs it.

    `torch`: whether it is one of PyTorch's, which know the paper's model alone; `gpu`: on a GPU.
    """

    name: str
    what: str
    run: Run
    torch: bool = False
    gpu: bool = False

    def why_not(self, model: Model) -> str:
        """Why it does not fit pictures of a model here; empty if it does."""
        if self.torch and model != "paper":
            return f"not run: it knows no model {model}"
        if self.torch and find_spec("torch") is None:
            return "not run: torch is not installed"
        return "not run: no GPU, or no CuPy" if self.gpu and not _gpu() else ""


def _gpu() -> bool:
    import torch

    return torch.cuda.is_available() and find_spec("cupy") is not None


def fit_with_ours(
    scene: Scene,
    budget: Budget,
    tracker: Tracker,
    threads: int,
    *,
    solver: Any = "gauss-newton",
    start: Callable[[Scene], Materials] | None = None,
    **options: Any,
) -> str:
    """Run `pbrfit.decompose`, lights as harmonics: from its own start, or from that of `start`."""

    def visit(progress: Progress) -> None:
        tracker.visit(progress.elapsed_s, progress.iteration, progress.evaluations, progress.state)

    begin = None if start is None else start(scene)
    tracker.start()
    result = decompose(
        scene,
        refine_normals="off",
        solver=solver,
        light="sh",
        uncertainty=False,
        iterations=budget.iterations,
        time_limit=budget.seconds,
        start=begin,
        threads=threads,
        progress=visit,
        **options,
    )
    iterations = int(result.history["iteration"][-1])
    tracker.end(
        result.seconds, iterations, result.evaluations, lambda: (result.materials, result.lighting)
    )
    return result.stop_reason


OPTIMISERS: dict[torch_peer.Optimiser, str] = {
    "lbfgs": "LBFGS with the strong Wolfe line search",
    "adam": "Adam with a cosine of learning rates",
}

_ALL = (
    Solver(
        "default",
        "pbrfit.decompose with its priors, given the segments where there are some.",
        fit_with_ours,
    ),
    Solver(
        "gauss-newton",
        "The same without priors, as all below: lights and some pixels' materials together, then "
        "all pixels.",
        partial(fit_with_ours, priors=None),
    ),
    Solver(
        "lbfgsb",
        "scipy's L-BFGS-B in three stages that keep off roughness 0.",
        partial(fit_with_ours, solver="lbfgsb", priors=None),
    ),
    Solver(
        "lbfgsb-paper",
        "The paper's recipe as we read it: one run of L-BFGS-B from the mean picture exposed to a "
        "mean of 0.4, roughness 0.5, metallic 0.1.",
        partial(fit_with_ours, solver="lbfgsb", start=paper_start, priors=None),
    ),
    *(
        Solver(
            f"torch-{optimiser}{'-gpu' if gpu else ''}",
            f"torch.optim.{what}, maps through a sigmoid, from the default start; float32, "
            + ("a CUDA kernel by hand." if gpu else "automatic differentiation."),
            partial(torch_peer.fit, optimiser=optimiser, gpu=gpu),
            torch=True,
            gpu=gpu,
        )
        for gpu in (False, True)
        for optimiser, what in OPTIMISERS.items()
    ),
)

SOLVERS = {solver.name: solver for solver in _ALL}
"""By name."""


def asked(options: Options) -> list[Solver]:
    """Those of a run."""
    return [SOLVERS[name] for name in options.solvers or SOLVERS]


@dataclass(frozen=True)
class Task:
    """One run: a solver on a scene."""

    case: Case
    solver: str
    seed: int
    budget: Budget
    inputs: str = ""
    """Digest of real pictures."""

    @property
    def key(self) -> str:
        """Unique name, fit for a file."""
        return f"{self.case.name}.{self.solver}.{self.seed}"


REHEARSAL = Case("rehearsal", 8)
REHEARSAL_BUDGET = Budget(iterations=3, evaluations=3, seconds=60.0)


def run(task: Task, threads: int) -> dict[str, Any]:
    """Do one run, after a rehearsal off the clock that loads libraries and wakes threads."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    solver = SOLVERS[task.solver]
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


FIRST_SEED = 100
"""Seeds below 100 and from 200 on were used to choose constants, of this package and of peers."""

MOST_SEEDS = 100


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
