"""One fold of a source: some pictures held out, and how well materials of the rest explain them."""

from __future__ import annotations

import base64
from dataclasses import asdict, dataclass

import numpy as np

from pbrfit._core import InputError
from pbrfit.model.reflection import Model
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.real.held_out import LEAST_KEPT, explain_held_out, folds, split
from pbrfit_evaluation.real.pictures import draw_sheet
from pbrfit_evaluation.real.sources import Source, load


@dataclass(frozen=True)
class Task:
    """One fold of one source, explained with a model.

    Attributes
    ----------
    digest
        Of the source's files.
    max_size
        Pictures are averaged down to this longer side.
    iterations
        Of each fit.
    held_out
        Pictures that are held out; None = a quarter.
    """

    source: Source
    model: Model
    fold: int
    digest: str
    max_size: int
    iterations: int
    held_out: int | None

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.source.name}-{self.model}-{self.fold}"


def least(held_out: int | None) -> int:
    """Pictures that a source must have."""
    return LEAST_KEPT + (held_out or 1)


def folds_of(source: Source, held_out: int | None, most: int) -> range:
    """Folds to run; one, which fails, if there are too few pictures."""
    enough = source.pictures >= least(held_out)
    return range(min(most, folds(source.pictures, held_out)) if enough else 1)


def run(task: Task, threads: int) -> Values:
    """Fit materials to the kept pictures and lights to the others.

    Returns
    -------
    `size` and `pixels` that were used, how many pictures were `kept`, the share of samples that are
    `clipped`, and by explanation the attributes of `held_out.Explained`; `sheet` is a PNG of the
    first fold.

    Raises
    ------
    InputError
        If there are too few pictures.
    """
    if task.source.pictures < least(task.held_out):
        raise InputError(
            f"{task.source.folder}: expected at least {least(task.held_out)} pictures, to fit some "
            f"and hold out others, found {task.source.pictures}"
        )
    scene = load(task.source, task.max_size)
    which = split(len(scene.images), task.held_out, task.fold)
    explained = explain_held_out(
        scene, which, model=task.model, iterations=task.iterations, threads=threads
    )
    valid = scene.valid
    clipped = 0.0
    if scene.limits is not None:
        clipped = float(np.mean([(of[valid] > 0).any(axis=-1).mean() for of in scene.limits]))
    sheet = base64.b64encode(draw_sheet(scene, which, explained)).decode("ascii")
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
        "sheet": sheet if task.fold == 0 else None,  # one of a source is enough to look at
    }
