"""The second-order solvers: whether they reach what they are there for, and at what cost.

Seven parts, each a file with its tasks, which can be run alone. `plan` says what is to be done,
`work` does one task; what must hold, and whether it does, is in `report/verdicts.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.solvers import exact, gap, memory, noise, priors, race, start

__all__ = ["FULL", "PARTS", "QUICK", "Effort", "Measured", "Part", "Task", "plan", "work"]

Part = Literal["exact", "noise", "start", "gap", "priors", "race", "memory"]
PARTS: tuple[Part, ...] = get_args(Part)

ALONE: tuple[Part, ...] = ("race", "memory")
"""Parts whose tasks want the machine for themselves."""

Task = exact.Task | noise.Task | start.Task | gap.Task | priors.Task | race.Task | memory.Task


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    scenes, size
        Number of scenes and side of their pictures, by part; of "memory" there is no number.
    cycles_scenes
        Of "gap": how many scenes of each row are rendered by Cycles.
    iterations
        Of each fit by L-BFGS-B; "auto" and "gauss-newton" get the same limit.
    memory_sizes
        Sides of the pictures whose fits' memory is measured.
    """

    name: str
    scenes: Mapping[Part, int]
    size: Mapping[Part, int]
    cycles_scenes: int
    iterations: int
    memory_sizes: tuple[int, ...]


FULL = Effort(
    name="full",
    scenes={"exact": 67, "noise": 10, "start": 2, "gap": 20, "priors": 5, "race": 3},
    size={"exact": 128, "noise": 128, "start": 64, "gap": 128, "priors": 64, "race": 512},
    cycles_scenes=5,
    iterations=500,
    memory_sizes=(512, 1024),
)

QUICK = Effort(
    name="quick",
    scenes={"exact": 2, "noise": 1, "start": 1, "gap": 1, "priors": 1, "race": 1},
    size={"exact": 32, "noise": 32, "start": 24, "gap": 32, "priors": 32, "race": 64},
    cycles_scenes=0,
    iterations=100,
    memory_sizes=(512,),
)

LARGE_SIZE = 2048
"""4 million pixels: only where it is asked for."""


@dataclass(frozen=True)
class Measured:
    """Tasks with their records, by part; `notes` say what could not be run."""

    effort: Effort
    jobs: int
    found: Mapping[Part, Sequence[tuple[Any, Record]]]
    notes: Mapping[Part, str]

    def finished(self, part: Part) -> list[tuple[Any, Mapping[str, Any]]]:
        """Tasks of a part that ended well, with what they found."""
        return [
            (task, record.values)
            for task, record in self.found.get(part, ())
            if record.values is not None
        ]

    @property
    def failed(self) -> list[Record]:
        """Records of the others."""
        return [
            record
            for pairs in self.found.values()
            for _, record in pairs
            if record.error is not None
        ]


def plan(part: Part, effort: Effort, cycles_cache: Path | None = None) -> Sequence[Task]:
    """Tasks of a part; of "race" those that the others wait for (see `race.plan_rest`)."""
    if part == "memory":
        return memory.plan(effort.memory_sizes)
    scenes, size, iterations = effort.scenes[part], effort.size[part], effort.iterations
    match part:
        case "exact":
            return exact.plan(scenes, size, iterations)
        case "noise":
            return noise.plan(scenes, size, iterations)
        case "start":
            return start.plan(scenes, size, iterations)
        case "gap":
            return gap.plan(scenes, effort.cycles_scenes, size, iterations, cycles_cache)
        case "priors":
            return priors.plan(scenes, size, iterations)
        case "race":
            return race.plan_marks(scenes, size, iterations)


def work(task: Task, threads: int) -> Mapping[str, Any]:
    """Do one task."""
    match task:
        case exact.Task():
            return exact.work(task, threads)
        case noise.Task():
            return noise.work(task, threads)
        case start.Task():
            return start.work(task, threads)
        case gap.Task():
            return gap.work(task, threads)
        case priors.Task():
            return priors.work(task, threads)
        case race.Task():
            return race.work(task, threads)
        case memory.Task():
            return memory.work(task, threads)
