"""Wrong normals: what they cost, and how much of it refining them wins back.

Four parts, each a file with its tasks, which can be run alone. `plan` says what is to be done,
`work` does one task; what must hold, and whether it does, is in `report/verdicts.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.normals import cost, exact, real, rooms
from pbrfit_evaluation.normals.disturbances import DISTURBANCES, Disturbance
from pbrfit_evaluation.normals.fits import FIRST_SEED
from pbrfit_evaluation.real.sources import Source

__all__ = ["ALONE", "FULL", "PARTS", "QUICK", "Effort", "Measured", "Part", "Task", "plan", "work"]

Part = Literal["rooms", "exact", "real", "cost"]
PARTS: tuple[Part, ...] = get_args(Part)

ALONE: tuple[Part, ...] = ("cost",)
"""Parts whose tasks want the machine for themselves."""

Task = rooms.Task | exact.Task | real.Task | cost.Task


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    scenes, size
        Number of rooms and side of their pictures, of "rooms" and "exact".
    first_seed
        Of the first room.
    disturbances, degrees
        Of "rooms"; `degrees` are θ above 0.
    real_degrees, real_size
        θ of "real", and the longer side of its pictures.
    repeats
        Of each fit of "cost", by side of the pictures.
    iterations
        Of each fit.
    """

    name: str
    scenes: int
    size: int
    disturbances: tuple[Disturbance, ...]
    degrees: tuple[float, ...]
    real_degrees: tuple[float, ...]
    real_size: int
    repeats: Mapping[int, int]
    iterations: int = 500
    first_seed: int = FIRST_SEED


FULL = Effort(
    name="full",
    scenes=12,
    size=128,
    disturbances=DISTURBANCES,
    degrees=(1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0),
    real_degrees=(5.0, 10.0, 20.0),
    real_size=256,
    repeats={64: 5, 128: 3, 256: 3, 512: 1},
)

QUICK = Effort(
    name="quick",
    scenes=2,
    size=32,
    disturbances=DISTURBANCES,
    degrees=(10.0,),
    real_degrees=(10.0,),
    real_size=48,
    repeats={32: 1, 64: 1},
    iterations=100,
)


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


def plan(part: Part, effort: Effort, sources: Sequence[Source] = ()) -> Sequence[Task]:
    """Tasks of a part; `sources` are those of "real"."""
    seed, iterations = effort.first_seed, effort.iterations
    match part:
        case "rooms":
            return rooms.plan(
                effort.scenes, effort.size, iterations, seed, effort.disturbances, effort.degrees
            )
        case "exact":
            return exact.plan(effort.scenes, effort.size, iterations, seed, effort.disturbances)
        case "real":
            return real.plan(
                sources, effort.real_size, iterations, effort.disturbances, effort.real_degrees
            )
        case "cost":
            return cost.plan(effort.repeats, iterations, seed)


def work(task: Task, threads: int) -> Mapping[str, Any]:
    """Do one task."""
    match task:
        case rooms.Task():
            return rooms.work(task, threads)
        case exact.Task():
            return exact.work(task, threads)
        case real.Task():
            return real.work(task, threads)
        case cost.Task():
            return cost.work(task, threads)
