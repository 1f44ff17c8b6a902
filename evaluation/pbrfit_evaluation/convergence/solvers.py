"""Every way to fit a scene that the suite compares. A new solver is one more entry in `SOLVERS`.

All minimise the same objective, that without priors: otherwise a lower loss would say nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from numpy.typing import NDArray

from pbrfit.fit.decompose import Progress
from pbrfit.fit.objective import Objective
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.convergence import torch_peer
from pbrfit_evaluation.convergence.cases import Case, true_lighting
from pbrfit_evaluation.convergence.measure import Budget, Tracker
from pbrfit_evaluation.recipes import fit, paper_start

Start = Materials | tuple[Materials, NDArray[Any]]

RACE_SIZE = 512
"""Side of pictures from which only those run whose times are held against each other."""

Run = Callable[[Scene, Budget, Tracker, int], str]
"""Fits a scene with so many threads, shows the tracker its states, returns why it ended."""


@dataclass(frozen=True)
class Solver:
    """One of those that are compared: a name for files and tables, a sentence, and what runs it.

    `torch`: whether it is one of PyTorch's, which know the paper's model alone. `raced`: whether it
    runs on large pictures too.
    """

    name: str
    what: str
    run: Run
    torch: bool = False
    raced: bool = False

    def why_not(self, model: Model, size: int = 0) -> str:
        """Why it does not fit pictures of a model and size here; empty if it does."""
        if self.torch and model != "paper":
            return f"not run: it knows no model {model}"
        if size >= RACE_SIZE and not self.raced:
            return f"not run: too slow at {size}²"
        absent = self.torch and find_spec("torch") is None
        return "not run: torch is not installed" if absent else ""


def fit_with_ours(
    scene: Scene,
    budget: Budget,
    tracker: Tracker,
    threads: int,
    *,
    solver: Any = "lbfgsb",
    start: Callable[[Scene], Start] | None = None,
    known_lights: bool = False,
    times_iterations: int = 1,
) -> str:
    """Run `pbrfit.decompose`: from its own start, or in one stage from that of `start`."""
    if known_lights:
        scene = replace(scene, lighting=true_lighting(scene))

    def visit(progress: Progress) -> None:
        tracker.visit(progress.elapsed_s, progress.iteration, progress.evaluations, progress.state)

    result = fit(
        scene,
        solver=solver,
        iterations=times_iterations * budget.iterations,
        time_limit=budget.seconds,
        start=None if start is None else start(scene),
        threads=threads,
        priors=None,
        progress=visit,
    )
    iterations = int(result.history["iteration"][-1])
    tracker.end(
        result.seconds, iterations, result.evaluations, lambda: (result.materials, result.lighting)
    )
    return result.stop_reason


def default_start(scene: Scene) -> Start:
    """Where `pbrfit.decompose` starts if it is told nothing, lights included."""
    objective = Objective(scene)
    return objective.unpack(objective.start())


SOLVERS: tuple[Solver, ...] = (
    Solver(
        "lbfgsb",
        "pbrfit.decompose without priors: scipy's L-BFGS-B in three stages that keep off "
        "roughness 0.",
        fit_with_ours,
        raced=True,
    ),
    Solver(
        "lbfgsb-long",
        "The same with four times as many iterations. Its stages are as much longer.",
        partial(fit_with_ours, times_iterations=4),
    ),
    Solver(
        "lbfgsb-one-stage",
        "From the default start, without stages and restarts.",
        partial(fit_with_ours, start=default_start),
    ),
    Solver(
        "lbfgsb-paper",
        "The paper's recipe as we read it: one stage from the mean picture exposed to a mean of "
        "0.4, roughness 0.5, metallic 0.1.",
        partial(fit_with_ours, start=paper_start),
        raced=True,
    ),
    Solver(
        "gauss-newton",
        "Lights and some pixels' materials together, restarts pixel by pixel, then all pixels.",
        partial(fit_with_ours, solver="gauss-newton"),
        raced=True,
    ),
    Solver(
        "torch-lbfgs",
        "torch.optim.LBFGS with the strong Wolfe line search, maps through a sigmoid, from the "
        "default start; float32, automatic differentiation.",
        partial(torch_peer.fit, optimiser="lbfgs"),
        torch=True,
        raced=True,
    ),
    Solver(
        "torch-adam",
        "torch.optim.Adam with a cosine of learning rates, maps through a sigmoid, from the "
        "default start; float32, automatic differentiation.",
        partial(torch_peer.fit, optimiser="adam"),
        torch=True,
    ),
    Solver(
        "lbfgsb-known-lights",
        "L-BFGS-B, staged, given the true lights, so that only materials are fitted: what is slow "
        "or caught here is so for each pixel by itself. No solver of the whole problem, and no "
        "bound on those: they can end lower.",
        partial(fit_with_ours, known_lights=True),
    ),
)


BY_NAME = {solver.name: solver for solver in SOLVERS}


@dataclass(frozen=True)
class Task:
    """One run: a solver on a scene."""

    case: Case
    solver: str
    seed: int
    budget: Budget

    @property
    def key(self) -> str:
        """Unique name, fit for a file."""
        return f"{self.case.name}.{self.solver}.{self.seed}"
