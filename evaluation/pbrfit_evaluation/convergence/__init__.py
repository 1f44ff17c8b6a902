"""Error against run time: solvers, starts and peers on scenes of several sizes and difficulties.

`plan` says what is to be done, `work` does one run, `Curve` is what it found. Nothing here draws or
writes.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pbrfit.model.reflection import Model
from pbrfit.synthetic.lights import condition
from pbrfit_evaluation.convergence.cases import Case, make, true_lighting
from pbrfit_evaluation.convergence.measure import Point, Tracker
from pbrfit_evaluation.convergence.solvers import SOLVERS, Budget, Solver, by_name

__all__ = ["FULL", "QUICK", "SOLVERS", "Case", "Curve", "Effort", "Solver", "Task", "plan", "work"]

FIRST_SEED = 100
"""Seeds below 100 and from 200 on were used to choose constants, of this package and of peers."""

MOST_SEEDS = 100

REHEARSAL = Case("rehearsal", 8, 0.0, "typical")
REHEARSAL_BUDGET = Budget(iterations=3, evaluations=3, seconds=60.0)


@dataclass(frozen=True)
class Effort:
    """What is run: cases, and how long.

    `seconds` is where any run is cut off, for a picture of 64²; larger pictures have as much more
    as they have pixels. On a quiet machine of two cores none is: iterations and evaluations are the
    limits, so that only a busy one makes results depend on its speed.
    """

    name: str
    cases: tuple[Case, ...]
    seeds: int
    iterations: int
    evaluations: int
    seconds: float

    @property
    def model(self) -> Model:
        """That all cases have."""
        [model] = {case.model for case in self.cases}
        return model

    def of_model(self, model: Model) -> Effort:
        """The same with scenes and fits of a model."""
        return replace(self, cases=tuple(replace(case, model=model) for case in self.cases))

    def budget(self, case: Case) -> Budget:
        """What a run of the case may take."""
        share = max(1.0, (case.size / 64) ** 2)
        return Budget(self.iterations, self.evaluations, self.seconds * share)


FULL = Effort(
    name="full",
    cases=(
        Case("typical-32", 32, 0.0, "typical"),
        Case("typical-64", 64, 0.0, "typical"),
        Case("typical-128", 128, 0.0, "typical"),
        Case("noise-64", 64, 0.01, "typical"),
        Case("spread-64", 64, 0.0, "spread"),
        Case("nearly-one-64", 64, 0.0, "nearly one"),
        Case("alike-noise-64", 64, 0.01, "alike"),
    ),
    seeds=3,
    iterations=500,
    evaluations=2000,
    seconds=60.0,
)

QUICK = Effort(
    name="quick",
    cases=(
        Case("typical-24", 24, 0.0, "typical"),
        Case("alike-noise-24", 24, 0.01, "alike"),
    ),
    seeds=1,
    iterations=200,
    evaluations=200,
    seconds=20.0,
)


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


@dataclass(frozen=True)
class Curve:
    """What a run found.

    Attributes
    ----------
    points
        Checkpoints, the first at the start, the last of what the solver handed back.
    stop_reason
        In words.
    condition
        Of the matrix of the training lights.
    threads
        It had.
    load
        The machine's load average of the last minute before it began, NaN where there is none.
    """

    task: Task
    points: tuple[Point, ...]
    stop_reason: str
    condition: float
    threads: int
    load: float

    @classmethod
    def from_values(cls, task: Task, values: Mapping[str, Any]) -> Curve:
        """From what `work` returned."""
        return cls(
            task,
            tuple(Point.from_row(row) for row in values["points"]),
            str(values["stop_reason"]),
            float(values["condition"]),
            int(values["threads"]),
            float(values["load"]),
        )


def plan(effort: Effort, seeds: int | None = None) -> list[Task]:
    """All runs that are possible here, those of a seed one after the other.

    So a run that is broken off and resumed with fewer seeds is complete in those.
    """
    count = effort.seeds if seeds is None else seeds
    return [
        Task(case, solver.name, FIRST_SEED + i, effort.budget(case))
        for i in range(count)
        for case in effort.cases
        for solver in SOLVERS
        if not solver.why_not(case.model)
    ]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Do one run, after a rehearsal off the clock that loads libraries and wakes threads."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    solver = by_name(task.solver)
    rehearsal = make(replace(REHEARSAL, model=task.case.model), seed=0)
    solver.run(rehearsal, REHEARSAL_BUDGET, Tracker(rehearsal, threads), threads)
    scene = make(task.case, task.seed)
    tracker = Tracker(scene, threads)
    reason = solver.run(scene, task.budget, tracker, threads)
    return {
        "points": [point.as_row() for point in tracker.points],
        "stop_reason": reason,
        "condition": condition(true_lighting(scene)),
        "threads": threads,
        "load": load,
    }


def curves(tasks: Sequence[Task], values: Sequence[Mapping[str, Any] | None]) -> list[Curve]:
    """Those of the runs that ended well."""
    return [
        Curve.from_values(task, found)
        for task, found in zip(tasks, values, strict=True)
        if found is not None
    ]
