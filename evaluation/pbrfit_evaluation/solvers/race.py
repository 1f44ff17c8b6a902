"""Part "race": seconds until the objective is as low as where the paper's recipe ends.

The mark is what L-BFGS-B ends at after the paper's 500 iterations from the paper's start. All
others run until their own objective, of all pixels and in float64, is at most that. Each run has a
process of its own, one after the other.

The clock does not run while the objective is measured. Importing and compiling libraries, and
making the start, are not on it; scaling the pictures and copying them is, for every runner.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.decompose import Progress
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, chosen_model
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.convergence import torch_peer
from pbrfit_evaluation.recipes import paper_start
from pbrfit_evaluation.solvers.fits import (
    AUTO,
    GAUSS_NEWTON,
    LBFGSB,
    Name,
    fit,
    in_float32,
    residual_of,
    rms,
    room,
)
from pbrfit_evaluation.solvers.own_process import call
from pbrfit_evaluation.suite import Results

Array = NDArray[np.float64]
State = Callable[[], tuple[Materials, Array]]

THREADS = 2
CHECKPOINT_RATIO = 1.12
"""Evaluations between two measurements, until one is near the mark."""

NEAR = 1.05
"""Below so many times the mark, by the runner's own account, every state is measured."""

PEER_EVALUATIONS = 1500
PEER_PATIENCE = 10.0
"""A peer that has not reached the mark after so many evaluations, or so many times the seconds of
the paper's recipe, is given up."""

OVER_LBFGSB, OVER_TORCH = 20.0, 10.0
"""How much sooner `gauss-newton` and `auto` have to be there, at least."""

REHEARSAL_SIZE = 32

MODEL: Model = "paper"
"""The one that PyTorch's runner has."""

NAMES = {
    "paper": "lbfgsb, paper's recipe",
    "gauss-newton": "gauss-newton",
    "auto": "auto",
    "lbfgsb": "lbfgsb",
    "torch": "torch.compile, L-BFGS",
}
"""Runners by key. All start where the paper's recipe does, but for "lbfgsb": without the product's
own start and stages it would be that recipe."""

SOLVERS: dict[str, Name] = {
    "paper": LBFGSB,
    "gauss-newton": GAUSS_NEWTON,
    "auto": AUTO,
    "lbfgsb": LBFGSB,
}
"""Of `pbrfit.decompose`."""


@dataclass(frozen=True)
class Task:
    """A runner on a scene; the mark is None for the paper's recipe, which makes it.

    Attributes
    ----------
    mark
        RMS residual in picture units, and seconds, of the paper's recipe at its end.
    """

    runner: str
    seed: int
    size: int
    iterations: int
    mark: tuple[float, float] | None = None

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"race_{self.runner}_{self.seed}"


def rest(results: Results[Task]) -> list[Task]:
    """All other runners on the scenes whose mark is known."""
    return [
        replace(task, runner=runner, mark=(values["residual"], values["seconds"]))
        for task, values in results.finished
        for runner in NAMES
        if runner != "paper" and not missing(runner)
    ]


def missing(runner: str) -> str:
    """Why it cannot run here; empty if it can."""
    absent = runner not in SOLVERS and find_spec("torch") is None
    return "torch is not installed" if absent else ""


def work(task: Task, threads: int) -> dict[str, Any]:
    """One run in a process of its own."""
    found: dict[str, Any] = call(run, task, min(threads, THREADS))
    return found


def run(task: Task, threads: int) -> dict[str, Any]:
    """One run, after a small one that loads libraries and wakes threads."""
    small = in_float32(room(0, REHEARSAL_SIZE, held_out=1, model=MODEL))
    rehearsal = replace(task, iterations=5, mark=(0.0, 0.1))
    _race(small, rehearsal, Tracker(small, 0.0, threads), threads)
    scene = in_float32(room(task.seed, task.size, held_out=1, model=MODEL))
    tracker = Tracker(scene, task.mark[0] if task.mark else 0.0, threads)
    reason = _race(scene, task, tracker, threads)
    points = tracker.points
    return {
        "points": points,
        "residual": points[-1][2],
        "seconds": points[-1][0],
        "evaluations": points[-1][1],
        "is_mark": task.mark is None,
        "reached": tracker.reached,
        "stop_reason": reason,
        "threads": threads,
        "pictures_rms": rms(scene),
    }


def _race(scene: Scene, task: Task, tracker: Tracker, threads: int) -> str:
    start = None if task.runner == "lbfgsb" else paper_start(scene)
    if task.runner not in SOLVERS:
        assert task.mark is not None
        limits = torch_peer.Limits(PEER_EVALUATIONS, PEER_PATIENCE * task.mark[1])
        settings = replace(torch_peer.LBFGS, compiled=True)
        try:
            return torch_peer.fit(scene, settings, limits, tracker, threads, start=start)
        except ReachedError:
            return "the mark is reached"

    def visit(progress: Progress) -> None:
        tracker.visit(
            progress.elapsed_s,
            progress.iteration,
            progress.evaluations,
            progress.state,
            claimed=progress.recon_rmse,
        )

    result = fit(
        scene,
        SOLVERS[task.runner],
        start=start,
        iterations=task.iterations,
        threads=threads,
        priors=None,
        uncertainty=False,
        progress=visit,
    )
    state = result.materials, result.lighting
    tracker.end(result.seconds, 0, result.evaluations, lambda: state)
    return result.stop_reason


class ReachedError(Exception):
    """The way out of a peer's loop: the mark is reached, and the rest of no interest."""


class Tracker:
    """Measures a run's residual over all pixels in float64, with the clock stopped.

    At the first states and at numbers of evaluations that grow by 12 %; and at every state that is
    near the mark by the runner's own account until one has reached it. A runner whose account is
    not known is measured at every state it shows, and stopped when it is there.
    """

    def __init__(self, scene: Scene, mark: float, threads: int) -> None:
        self._scene = scene
        self._mark = mark
        self._threads = threads
        self._next = 0.0
        self.points: list[tuple[float, int, float]] = []
        """(seconds, evaluations, residual)"""
        self.reached: float | None = None
        """Seconds when the mark was first reached."""

    def visit(
        self,
        seconds: float,
        _iteration: int,
        evaluations: int,
        state: State,
        claimed: float | None = None,
    ) -> None:
        """Measure, if it is time to."""
        near = claimed is None or claimed <= NEAR * self._mark
        if evaluations >= self._next or (near and self.reached is None):
            self._measure(seconds, evaluations, state)
            if claimed is None and self.reached is not None:
                raise ReachedError

    def end(self, seconds: float, _iteration: int, evaluations: int, state: State) -> None:
        """Measure what is handed back."""
        self._measure(seconds, evaluations, state)

    def _measure(self, seconds: float, evaluations: int, state: State) -> None:
        materials, lighting = state()
        # Maps of float32 runners may leave [0, 1] by a rounding.
        maps = (materials.albedo, materials.roughness, materials.metallic)
        inside = Materials(*(np.clip(values, 0, 1) for values in maps))
        model = chosen_model(None, self._scene.model)
        residual = residual_of(self._scene, inside, lighting, model, self._threads)
        self.points.append((seconds, evaluations, residual))
        self._next = max(evaluations + 1, CHECKPOINT_RATIO * evaluations)
        if self.reached is None and residual <= self._mark:
            self.reached = seconds
