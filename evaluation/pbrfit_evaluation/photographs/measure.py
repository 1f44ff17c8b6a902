"""One fold of a source, explained in one way."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.model.geometry import angles_between
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.photographs.explanations import Way, explain
from pbrfit_evaluation.photographs.panels import kept_panels
from pbrfit_evaluation.photographs.pictures import read
from pbrfit_evaluation.real.held_out import picture_scores, relative_error, split
from pbrfit_evaluation.real.measure import least
from pbrfit_evaluation.real.sources import Source


@dataclass(frozen=True)
class Task:
    """One fold of one source, explained in one way.

    Attributes
    ----------
    digest
        Of the source's files.
    max_size
        Pictures are averaged down to this longer side.
    iterations
        Of the fit.
    held_out
        Pictures that are held out; None = a quarter.
    fov
        Horizontal field of view of scene folders in degrees; None = what they say.
    picture
        Whether panels for the report are kept.
    """

    source: Source
    way: Way
    fold: int
    digest: str
    max_size: int
    iterations: int
    held_out: int | None
    fov: float | None = None
    picture: bool = False

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.source.name}-{self.way}-{self.fold}"


def run(task: Task, threads: int) -> Values:
    """Explain held-out photographs.

    Returns
    -------
    `size` and `pixels` that were used, how many pictures were `kept`, the share of samples that are
    `clipped`; `scores` of the held-out pictures, `kept_error`, the same of the kept ones together,
    `normals`, the `mean` and `median` angle to the true ones in degrees, and `seconds`; `panels`
    for the report.

    Raises
    ------
    InputError
        If there are too few pictures, or our fit refuses them.
    """
    if task.source.pictures < least(task.held_out):
        raise InputError(
            f"{task.source.folder}: expected at least {least(task.held_out)} pictures, to explain "
            f"some by others, found {task.source.pictures}"
        )
    photographs = read(task.source, task.max_size, task.fov)
    scene = photographs.scene
    which = split(len(scene.images), task.held_out, task.fold)
    began = perf_counter()
    found = explain(task.way, photographs, which, iterations=task.iterations, threads=threads)
    seconds = perf_counter() - began
    clipped = 0.0
    if scene.limits is not None:
        clipped = float(np.mean([(of[scene.valid] > 0).any(axis=-1).mean() for of in scene.limits]))
    kept_error = None
    if found.kept is not None:
        kept_error = relative_error(picture_scores(scene, which.kept, found.kept, looks=False))
    values: dict[str, Any] = {
        "size": [scene.width, scene.height],
        "pixels": int(np.count_nonzero(scene.valid)),
        "kept": len(which.kept),
        "clipped": clipped,
        "scores": [asdict(one) for one in picture_scores(scene, which.held_out, found.held_out)],
        "kept_error": kept_error,
        "normals": _angles(found.normals, photographs.normals),
        "seconds": seconds,
    }
    if task.picture:
        values["panels"] = kept_panels(photographs, which, found)
    return values


def _angles(
    found: NDArray[np.float64] | None, true: NDArray[np.float64] | None
) -> dict[str, float] | None:
    if found is None or true is None:
        return None
    off = angles_between(found, true)
    off = off[np.isfinite(off)]
    return {"mean": float(off.mean()), "median": float(np.median(off))}
