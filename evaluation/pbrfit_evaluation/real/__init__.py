"""Real pictures: what is held out, and how well the materials of the rest explain it.

For each source (`sources.py`) and fold, one task splits the pictures, fits materials to those that
are kept and lights to those that are not (`held_out.py`).
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit._core import InputError
from pbrfit.model.reflection import MODELS, Model
from pbrfit_evaluation.real.held_out import (
    EXPLANATIONS,
    IN_WORDS,
    LEAST_KEPT,
    Explanation,
    PictureScore,
    explain_held_out,
    folds,
    relative_error,
    split,
)
from pbrfit_evaluation.real.pictures import draw_sheet
from pbrfit_evaluation.real.sources import Source, check_names, load

__all__ = [
    "EXPLANATIONS",
    "FULL",
    "IN_WORDS",
    "QUICK",
    "Effort",
    "Fold",
    "RealTask",
    "plan",
    "work",
]


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    name
        In reports.
    max_size
        Pictures are averaged down to this longer side.
    iterations
        Of each fit.
    folds
        At most so many ways to hold pictures out.
    held_out
        Pictures that are held out in each; None = a quarter.
    """

    name: str
    max_size: int
    iterations: int
    folds: int
    held_out: int | None = None


FULL = Effort("full", max_size=256, iterations=500, folds=4)
QUICK = Effort("quick", max_size=64, iterations=60, folds=1)


@dataclass(frozen=True)
class RealTask:
    """One fold of one source, explained with a model. `digest` is of the source's files."""

    source: Source
    effort: Effort
    fold: int
    digest: str
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.source.name}-{self.model}-{self.fold}"


def plan(
    sources: Sequence[Source], effort: Effort, models: Sequence[Model] = MODELS
) -> list[RealTask]:
    """Tasks for all folds of all sources and models; one that fails if there are too few pictures.

    Raises
    ------
    InputError
        If two sources have one name.
    """
    check_names(sources)
    return [
        RealTask(source, effort, fold, digest, model)
        for source in sources
        for digest in [source.digest()]
        for model in models
        for fold in range(
            min(effort.folds, folds(source.pictures, effort.held_out))
            if source.pictures >= _least(effort)
            else 1
        )
    ]


def _least(effort: Effort) -> int:
    return LEAST_KEPT + (effort.held_out or 1)


def work(task: RealTask, threads: int) -> Mapping[str, Any]:
    """Do one task; what it returns is read back by `Fold.of`.

    Raises
    ------
    InputError
        If there are too few pictures.
    """
    if task.source.pictures < _least(task.effort):
        raise InputError(
            f"{task.source.folder}: expected at least {_least(task.effort)} pictures, to fit some "
            f"and hold out others, found {task.source.pictures}"
        )
    scene = load(task.source, task.effort.max_size)
    which = split(len(scene.images), task.effort.held_out, task.fold)
    explained = explain_held_out(
        scene, which, model=task.model, iterations=task.effort.iterations, threads=threads
    )
    valid = scene.valid
    clipped = 0.0 if scene.weights is None else float(np.mean(scene.weights[:, valid] == 0))
    return {
        "size": [scene.width, scene.height],
        "pixels": int(np.count_nonzero(valid)),
        "kept": len(which.kept),
        "clipped": clipped,
        "explanations": {
            one.explanation: {
                "scores": [asdict(score) for score in one.scores],
                "kept_error": one.kept_error,
                "seconds": one.seconds,
            }
            for one in explained
        },
        # One sheet a source is enough to look at.
        "sheet": base64.b64encode(draw_sheet(scene, which, explained)).decode("ascii")
        if task.fold == 0
        else None,
    }


@dataclass(frozen=True)
class Outcome:
    """One explanation in one fold; attributes as in `held_out.Explained`."""

    scores: tuple[PictureScore, ...]
    kept_error: float | None
    seconds: float


@dataclass(frozen=True)
class Fold:
    """What a task found.

    Attributes
    ----------
    size
        Width and height of the pictures as they were used.
    pixels
        That were fitted.
    kept
        Pictures that materials were fitted to.
    clipped
        Share of the samples that have weight 0, because they are clipped.
    outcomes
        By explanation.
    sheet
        PNG with pictures, maps and errors; None but for the first fold.
    """

    size: tuple[int, int]
    pixels: int
    kept: int
    clipped: float
    outcomes: Mapping[Explanation, Outcome]
    sheet: bytes | None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Fold:
        """From the values of a record."""
        outcomes = {
            name: Outcome(
                tuple(PictureScore(**score) for score in one["scores"]),
                one["kept_error"],
                one["seconds"],
            )
            for name, one in values["explanations"].items()
        }
        width, height = values["size"]
        sheet = values["sheet"]
        return cls(
            (width, height),
            values["pixels"],
            values["kept"],
            values["clipped"],
            outcomes,
            None if sheet is None else base64.b64decode(sheet),
        )


@dataclass(frozen=True)
class Figures:
    """One explanation over all folds of a source.

    Attributes
    ----------
    error
        RMSE over RMS of all held-out pictures together.
    kept_error
        The same of the kept pictures, mean over folds; None where it is 0 by construction.
    psnr, ssim
        Means over held-out pictures.
    seconds
        Mean over folds.
    """

    error: float
    kept_error: float | None
    psnr: float
    ssim: float
    seconds: float


def figures(found: Sequence[Fold], explanation: Explanation) -> Figures:
    """Sum up the folds of one source, at least one."""
    outcomes = [fold.outcomes[explanation] for fold in found]
    scores = tuple(score for outcome in outcomes for score in outcome.scores)
    of_kept = [outcome.kept_error for outcome in outcomes if outcome.kept_error is not None]
    return Figures(
        relative_error(scores),
        float(np.mean(of_kept)) if of_kept else None,
        float(np.mean([score.psnr for score in scores])),
        float(np.mean([score.ssim for score in scores])),
        float(np.mean([outcome.seconds for outcome in outcomes])),
    )


def find_data(folders: Sequence[Path], environment: Mapping[str, str]) -> list[Path]:
    """Folders as given, else that of PBRFIT_DATA.

    Raises
    ------
    InputError
        If there is neither.
    """
    if folders:
        return list(folders)
    if environment.get("PBRFIT_DATA"):
        return [Path(environment["PBRFIT_DATA"])]
    raise InputError(
        "FOLDER: expected scene folders or a folder of public sets, found none, and PBRFIT_DATA is "
        "not set"
    )
