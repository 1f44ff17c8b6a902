"""The ablation: what each prior is worth, where segments are right, wrong or missing.

Three kinds of tasks: rooms whose truth is known (`cases.py`), real pictures of which some are held
out, and the time that each part costs (`cost.py`). `plan` says what is to be done, `work` does one
task.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pbrfit.model.reflection import DEFAULT_MODEL, Model
from pbrfit_evaluation.ablation import cost
from pbrfit_evaluation.ablation.cases import CASES, VARIED_IN, CaseName, case
from pbrfit_evaluation.ablation.configurations import (
    CAUCHY,
    CONFIGURATIONS,
    DEFAULT,
    FEW,
    HUBER,
    NONE,
    PAPER,
    Configuration,
    curves,
)
from pbrfit_evaluation.ablation.pictures import real_sheet, room_sheet
from pbrfit_evaluation.real.held_out import (
    explained_by,
    part,
    picture_scores,
    relative_error,
    split,
)
from pbrfit_evaluation.real.sources import Source, check_names, load
from pbrfit_evaluation.scores import score

__all__ = [
    "FIRST_SEED",
    "FULL",
    "QUICK",
    "CostTask",
    "Effort",
    "RealTask",
    "RoomTask",
    "Task",
    "plan_cost",
    "plan_real",
    "plan_rooms",
    "work",
]

FIRST_SEED = 3000
"""Rooms are those of the seeds from here on. Priors were designed and their weights chosen on seeds
2000 to 2099; none from 3000 on ever served for that."""


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    size, rooms
        Side of the rooms' pictures; rooms a case.
    iterations
        Of each fit.
    configurations
        The rows of the tables.
    weights
        Of the priors that are varied; none = no curves.
    main
        Configurations for real pictures and for timing.
    real_size
        Longer side of real pictures.
    cost_size
        Side of the pictures that are timed.
    model
        That rooms are rendered with and everything is fitted with.
    """

    size: int
    rooms: int
    iterations: int
    configurations: tuple[Configuration, ...]
    weights: tuple[float, ...]
    main: tuple[Configuration, ...]
    real_size: int
    cost_size: int
    model: Model = DEFAULT_MODEL


FULL = Effort(
    size=64,
    rooms=5,
    iterations=500,
    configurations=CONFIGURATIONS,
    weights=(0.01, 0.1, 1.0, 10.0),
    main=(NONE, DEFAULT, PAPER, HUBER, CAUCHY),
    real_size=128,
    cost_size=128,
)
QUICK = Effort(
    size=32,
    rooms=1,
    iterations=60,
    configurations=FEW,
    weights=(),
    main=(NONE, DEFAULT),
    real_size=64,
    cost_size=32,
)


@dataclass(frozen=True)
class RoomTask:
    """A room of a case, fitted in all configurations. `picture`: whether to draw a sheet."""

    case: CaseName
    seed: int
    size: int
    iterations: int
    configurations: tuple[Configuration, ...]
    picture: bool
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.case}_{self.seed}"


@dataclass(frozen=True)
class RealTask:
    """A source, some pictures held out, fitted in all configurations; digest of its files."""

    source: Source
    max_size: int
    iterations: int
    configurations: tuple[Configuration, ...]
    digest: str
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"real_{self.source.name}"


@dataclass(frozen=True)
class CostTask:
    """What the parts cost on a picture of a size."""

    size: int
    iterations: int
    seed: int
    configurations: tuple[Configuration, ...]
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"cost_{self.size}"


Task = RoomTask | RealTask | CostTask


def plan_rooms(effort: Effort, seed: int = FIRST_SEED) -> list[RoomTask]:
    """Rooms of all cases; `seed`: of the first."""
    return [
        RoomTask(
            name,
            seed + i,
            effort.size,
            effort.iterations,
            _configurations(name, effort),
            picture=i == 0,
            model=effort.model,
        )
        for i in range(effort.rooms)
        for name in CASES
    ]


def plan_real(sources: Sequence[Source], effort: Effort) -> list[RealTask]:
    """Real pictures.

    Raises
    ------
    InputError
        If two sources have one name.
    """
    check_names(sources)
    return [
        RealTask(
            source,
            effort.real_size,
            effort.iterations,
            effort.main,
            source.digest(),
            effort.model,
        )
        for source in sources
    ]


def plan_cost(effort: Effort, seed: int = FIRST_SEED) -> CostTask:
    """The one task that wants the machine for itself: what the parts cost."""
    return CostTask(effort.cost_size, effort.iterations, seed, effort.main, effort.model)


def _room(task: RoomTask, threads: int) -> dict[str, Any]:
    scene = case(task.case, task.seed, size=task.size, model=task.model)
    fitted = {
        one: one.fit(scene, iterations=task.iterations, threads=threads)
        for one in task.configurations
    }
    return {
        "scores": {one.key: score(fit, scene, threads).as_json() for one, fit in fitted.items()},
        "sheet": _text(room_sheet(scene, {one.title: fitted[one] for one in fitted if one in FEW}))
        if task.picture
        else None,
    }


def _real(task: RealTask, threads: int) -> dict[str, Any]:
    scene = load(task.source, task.max_size)
    which = split(len(scene.images))
    kept = part(scene, which.kept)
    values: dict[str, Any] = {
        "kept": len(which.kept),
        "held_out": len(which.held_out),
        "found": {},
    }
    shown = {}
    for one in task.configurations:
        fit = one.fit(kept, iterations=task.iterations, threads=threads, model=task.model)
        rendered = explained_by(fit.materials, scene, which.held_out, threads, model=fit.model)
        of_pictures = picture_scores(scene, which.held_out, rendered)
        values["found"][one.key] = {
            "error": relative_error(of_pictures),
            "psnr": float(np.mean([picture.psnr for picture in of_pictures])),
            "ssim": float(np.mean([picture.ssim for picture in of_pictures])),
            "recon": fit.metrics["recon_rmse"],
            "seconds": fit.seconds,
        }
        if one in FEW:
            shown[one.title] = (fit.materials, rendered[0])
    return values | {"sheet": _text(real_sheet(scene, which, shown))}


def _text(png: bytes) -> str:
    return base64.b64encode(png).decode("ascii")


def _configurations(name: CaseName, effort: Effort) -> tuple[Configuration, ...]:
    """Each once: a weight that is varied may be one of the table's."""
    varied = curves(effort.weights) if name in VARIED_IN else ()
    return tuple(dict.fromkeys((*effort.configurations, *varied)))


def work(task: Task, threads: int) -> Mapping[str, Any]:
    """Do one task."""
    match task:
        case RoomTask():
            return _room(task, threads)
        case RealTask():
            return _real(task, threads)
        case CostTask():
            return cost.measure(
                task.size, task.iterations, task.seed, task.configurations, task.model, threads
            )
