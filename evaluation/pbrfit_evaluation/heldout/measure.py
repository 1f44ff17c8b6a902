"""One fold of a source, explained in one way."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from time import perf_counter, process_time
from typing import Any, Literal, cast

import numpy as np

from pbrfit._core import InputError
from pbrfit.export.rti import one_lamp_a_picture
from pbrfit.io.color import ColorSpace
from pbrfit.io.limits import AT_LEAST
from pbrfit.model.geometry import angles_between
from pbrfit.model.lamps import Lamps
from pbrfit.result.result import Result
from pbrfit.result.sheet import outside_grey
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Mask, known
from pbrfit_evaluation.estimator_errors import angle_errors
from pbrfit_evaluation.heldout.baselines import Baseline, explained_by_kept
from pbrfit_evaluation.heldout.light import explained_by
from pbrfit_evaluation.heldout.sources import Opened, Source, asked_sources, evenly, opened
from pbrfit_evaluation.jobs import Values, digest_of_files
from pbrfit_evaluation.panels import packed
from pbrfit_evaluation.recipes import PAPER, Way
from pbrfit_evaluation.suite import Options


@dataclass(frozen=True)
class OfPictures(Way):
    """A way to explain pictures, and what it is told beside them."""

    linear: bool = False
    """That values in the files are linear."""
    lamps: Literal["", "directions", "strengths", "found"] = ""
    """Of the lamps, where it is known: their directions; how strong they are, too; or directions
    that a fit finds where nobody knows them."""
    baseline: bool = False
    """Whether no materials are found (`baselines`)."""


WAYS: Mapping[str, OfPictures] = {
    "default": OfPictures("default"),
    "lamps": OfPictures("lamps", {"light": "lamps"}),
    "linear": OfPictures("linear", linear=True),
    "lamps-linear": OfPictures("lamps, linear", {"light": "lamps"}, linear=True),
    "sh-no-priors": OfPictures("harmonics, no priors", {"light": "sh", "priors": None}),
    "paper": OfPictures("paper's recipe", {**PAPER.options, "model": "paper"}, PAPER.start),
    "directions": OfPictures("directions told", lamps="directions"),
    "strengths": OfPictures("directions, strengths told", lamps="strengths"),
    "lambert": OfPictures("Lambert, rank 3", baseline=True),
    "nearest": OfPictures("nearest picture", baseline=True),
    "sum": OfPictures("sum of pictures", baseline=True),
    "lambert-known": OfPictures("Lambert, known lamps", lamps="directions", baseline=True),
    "lambert-trimmed": OfPictures("the same, trimmed", lamps="directions", baseline=True),
    "ptm": OfPictures("PTM", lamps="found", baseline=True),
    "hsh": OfPictures("HSH", lamps="found", baseline=True),
    "pca": OfPictures("PCA", lamps="found", baseline=True),
}
"""By key; words are those of tables."""

LEAST_KEPT = 2

LARGEST_SHOWN = 45.0
"""Degrees of an error that is white in its picture."""


@dataclass(frozen=True)
class Split:
    """Indices of the pictures that are fitted and of those that are not."""

    kept: tuple[int, ...]
    held_out: tuple[int, ...]


def split(pictures: int, held_out: int = 1, folds: int = 1, fold: int = 0, keep: int = 0) -> Split:
    """Hold out some pictures, spread evenly; none in two folds.

    With `keep` so many are kept, evenly chosen, and some of the others held out, if there are any.

    Raises InputError if fewer than two would be kept.
    """
    if keep:
        kept = evenly(pictures, keep)
        rest = [i for i in range(pictures) if i not in kept]
        return Split(tuple(kept), tuple(rest[i] for i in evenly(len(rest), held_out)))
    if held_out < 1 or pictures - held_out < LEAST_KEPT:
        raise InputError(
            f"held-out pictures: expected 1 or more and {LEAST_KEPT} to keep, "
            f"found {held_out} of {pictures}"
        )
    count = held_out * min(folds, pictures // held_out)
    out = tuple(k * pictures // count for k in range(fold, count, count // held_out))
    return Split(tuple(i for i in range(pictures) if i not in out), out)


@dataclass(frozen=True)
class Task:
    """One fold of one source, explained in one way."""

    source: Source
    way: str
    fold: int
    digest: str
    """Of the source's files."""
    held_out: int
    """Pictures that are held out at a time."""
    folds: int
    """How many there are."""
    pictures: int
    """That are used of a set, at most."""
    max_size: int
    """Longer side that pictures are averaged down to."""
    keep: int = 0
    """Pictures that are fitted; 0 = all that are not held out."""
    linear: bool = False
    """Whether all ways are told that values in the files are linear."""
    mapped: bool = False
    """Whether normals, and a picture of their errors, are kept."""

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.source.name}-{self.way}-{self.keep or self.fold}"


def run(task: Task, threads: int) -> Values:
    """Explain held-out pictures.

    Returns
    -------
    `size`, `pixels` and how many pictures were `kept`; `own` and `lamp`, scores of the held-out
    pictures by light of the way's own kind and by one far lamp (None without materials);
    `normals`, `mean` and `median` angle to the true ones in degrees, or None; `seconds` and
    `processor` seconds of the fit; `chosen`, what it decided; of a task that is `mapped` what
    `_mapped` gives. Where a way needs what the source lacks, only `not_possible`, the reason.

    Raises
    ------
    InputError
        If there are too few pictures, or the fit refuses them.
    """
    way = WAYS[task.way]
    found = _opened(task, "linear" if task.linear else None)
    if way.linear:
        if found.scene.response is None:
            return {"not_possible": "the encoding is known"}
        found = _opened(task, "linear")
    lamps = found.lamps
    if way.lamps == "found" and lamps is None:
        lamps = _found_lamps(replace(task, way="lamps", fold=0), threads)
    if way.lamps and lamps is None:
        return {"not_possible": "nobody knows the lamps"}
    if way.lamps == "strengths" and not known(lamps).colored:
        return {"not_possible": "nobody knows how strong the lamps are"}
    which = split(len(found.scene.images), task.held_out, task.folds, task.fold, task.keep)
    kept = found.scene.of_pictures(which.kept)
    if way.lamps and not way.baseline:
        far = known(lamps)
        far = far if way.lamps == "strengths" else Lamps(far.pictures, far.places)
        kept = replace(kept, lamps=far.of_pictures(which.kept))
    judged = judged_at(found.scene, kept.valid)
    result, lamp = None, None
    began = perf_counter(), process_time()
    if way.baseline:
        of = cast(Baseline, task.way)
        own, normals = explained_by_kept(of, judged, which.kept, which.held_out, lamps)
    else:
        result = way.explain(kept, threads=threads, refine_normals="auto")
        normals = result.normals
    seconds, processor = perf_counter() - began[0], process_time() - began[1]
    if result is not None:
        own = explained_by(result, judged, which.held_out, threads=threads)
        same = result.lamps is not None
        lamp = own if same else explained_by(result, judged, which.held_out, "lamp", threads)
    return {
        "size": [judged.width, judged.height],
        "pixels": int(np.count_nonzero(judged.valid)),
        "kept": len(which.kept),
        "own": [asdict(one) for one in own],
        "lamp": None if lamp is None else [asdict(one) for one in lamp],
        "normals": None
        if normals is None or found.normals is None
        else angle_errors(normals, found.normals),
        "seconds": seconds,
        "processor": processor,
        "chosen": None if result is None else _chosen(result),
        **(_mapped(normals, found.normals) if task.mapped else {}),
    }


def _opened(task: Task, color_space: ColorSpace | None = None) -> Opened:
    return _read(task.source, task.max_size, task.pictures, color_space, task.digest)


@lru_cache(maxsize=2)
def _read(*of: Any) -> Opened:
    """What `opened` gives, kept for the next task of a set; the last argument is its digest."""
    return opened(*of[:-1])


@lru_cache(maxsize=2)
def _found_lamps(task: Task, threads: int) -> Lamps | None:
    """Lamps, as far ones, as a fit to all pictures of a set finds them, one a picture.

    Relightable images need such; that they are of the held-out pictures, too, favours these.
    """
    scene = _opened(task, "linear" if task.linear else None).scene
    result = WAYS["lamps"].explain(scene, threads=threads, refine_normals="auto")
    if not one_lamp_a_picture(result.lamps, len(scene.images)):
        return None
    directions, colors = result.lamps_seen()
    return Lamps(np.arange(len(scene.images)), directions, colors=colors)


def judged_at(scene: Scene, valid: Mask) -> Scene:
    """The scene at some pixels; samples count unless they are clipped from above."""
    limits = scene.limits
    if limits is not None:
        limits = np.where(limits == AT_LEAST, limits, np.uint8(0))
    return replace(scene, mask=valid, limits=limits)


def _chosen(result: Result) -> dict[str, Any]:
    """What a fit decided, for a record."""
    held_out = getattr(result, "held_out", None)
    return {
        "light": "harmonics" if result.lamps is None else "lamps",
        "why": result.assumed.get("light"),
        "response": None if result.camera is None else result.camera.response,
        "held_out": None if held_out is None else asdict(held_out),
    }


def _mapped(found: Array | None, true: Array | None) -> dict[str, Any]:
    """`estimate`, the normals as float32 in base 64 with their `shape`, and `error` as a panel."""
    if found is None:
        return {}
    plain = np.nan_to_num(found).astype("<f4")
    kept: dict[str, Any] = {
        "shape": plain.shape,
        "estimate": base64.b64encode(plain.tobytes()).decode("ascii"),
    }
    if true is not None:
        off = angles_between(found, true) / LARGEST_SHOWN
        kept["error"] = packed({"error": outside_grey(np.clip(off, 0.0, 1.0))})
    return kept


def cases(options: Options) -> list[Task]:
    """All folds of all sources, in every way.

    Raises InputError or FileNotFoundError if there are no pictures, or two sources have one name.
    """
    of = options.held_out, options.folds, options.pictures, options.max_size
    return [
        Task(source, way, fold, digest, *of)
        for source in asked_sources(options.folders, os.environ)
        for digest in [digest_of_files(source.folder)]
        for count in [min(source.pictures, options.pictures)]
        for fold in range(max(1, min(options.folds, count // options.held_out)))
        for way in WAYS
        if way in options.ways
    ]
