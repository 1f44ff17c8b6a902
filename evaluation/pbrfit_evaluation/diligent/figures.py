"""Angles as rows, verdicts, tables and pictures; normals as files for submission."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pbrfit.commands.arguments import positive, switch, value
from pbrfit_evaluation.heldout.figures import error_of
from pbrfit_evaluation.heldout.measure import LARGEST_SHOWN, Task, run
from pbrfit_evaluation.heldout.sources import asked_sources
from pbrfit_evaluation.jobs import digest_of_files
from pbrfit_evaluation.options import Setting, count, fixed, several
from pbrfit_evaluation.panels import in_lines, unpacked
from pbrfit_evaluation.suite import (
    Options,
    Picture,
    Results,
    Row,
    Section,
    Suite,
    Table,
    Value,
    Verdict,
)

IN_WORDS: dict[str, str] = {
    "default": "unknown lamps",
    "directions": "directions told",
    "strengths": "directions, strengths told",
    "lambert-known": "least squares",
    "lambert-trimmed": "trimmed least squares",
}
WAYS = tuple(IN_WORDS)

WORSE = 1.02
"""Mean angle over that of another way, at most: objects are few, and 2 % is less than what another
choice of pictures changes."""

BESIDE: tuple[tuple[str, str], ...] = (
    ("directions", "lambert-trimmed"),
    ("strengths", "directions"),
    ("directions", "default"),
)
"""Ways and what they are held against: a model of highlights is worth more than leaving them out,
and to be told more makes nothing worse."""

OBJECTS = ["ball", "cat", "pot1", "bear", "pot2", "buddha", "goblet", "reading", "cow", "harvest"]
PUBLISHED: dict[str, str] = {
    "known: least squares, Woodham 1980": "4.10 8.41 8.89 8.39 14.65 14.92 18.50 19.80 25.60 30.62",
    "known: Ikehata, Aizawa 2014": "3.34 6.74 6.64 7.11 8.77 10.47 9.71 14.19 13.05 25.95",
    "known: Shi et al. 2014": "1.74 6.12 6.51 6.12 8.78 10.60 10.09 13.63 13.93 25.44",
    "unknown: Alldrin et al. 2007": "7.27 31.45 18.37 16.81 49.16 32.81 46.54 53.65 54.72 61.70",
    "unknown: Papadhimitri, Favaro 2014": "4.77 9.54 9.51 9.07 15.90 14.92 29.93 24.18 19.53 29.21",
}
"""Mean angles in degrees by method, over `OBJECTS`, of all 96 pictures; Shi et al., TPAMI 2019."""

Of = Results[Task]


def _each(results: Of) -> Iterator[tuple[int, str, Of]]:
    """Numbers of pictures and ways, with the objects that have so many."""
    for keep in sorted({task.keep for task, _ in results.pairs}):
        for way in WAYS:
            if (of := results.of(keep=keep, way=way)).pairs:
                yield keep, way, of


def rows(results: Of) -> list[Row]:
    """A row an object, number of pictures and way."""
    found = []
    for _, _, of in _each(results):
        for task, record in of.pairs:
            values = record.values or {}
            metrics: dict[str, float | None] = {"pictures": float(task.keep)}
            metrics |= values.get("normals") or {}
            if values.get("own"):
                metrics["relighting"] = error_of(values["own"])
            if "seconds" in values:
                metrics["seconds"] = values["seconds"]
            reason = values.get("not_possible")
            status = record.error or (f"not possible: {reason}" if reason else "ok")
            of_source = task.source.name, 1, IN_WORDS[task.way]
            found.append(Row(*of_source, metrics, status=status, private=task.source.private))
    return found


def _angles(of: Of) -> dict[str, float]:
    """Mean angle by object."""
    return {
        task.source.name: values["normals"]["mean"]
        for task, values in of.finished
        if values.get("normals")
    }


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """To be told more makes nothing worse, unless the run was a quick look."""
    if results.options.effort == "quick":
        return
    for keep in sorted({task.keep for task, _ in results.pairs}):
        for way, other in BESIDE:
            ours, theirs = (_angles(results.of(keep=keep, way=one)) for one in (way, other))
            both = sorted(ours.keys() & theirs.keys())
            if both:
                ratio = sum(ours[name] for name in both) / sum(theirs[name] for name in both)
                what = (
                    f"{keep} pictures, {IN_WORDS[way]}: mean angle over that of {IN_WORDS[other]}"
                )
                yield Verdict(what, ratio, WORSE, f"{len(both)} objects")


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Angles by object, beside published ones; relighting and seconds; pictures of errors."""
    names = list(dict.fromkeys(task.source.name for task, _ in results.pairs))
    yield Section(
        "Mean angles",
        "Degrees between normals and the true ones.",
        [_table(results, names)],
    )
    published: list[list[Value]] = [
        [method, *angles, float(np.mean(angles))]
        for method, told in PUBLISHED.items()
        for angles in [list(map(float, told.split()))]
    ]
    yield Section(
        "Published",
        "DiLiGenT, all 96 pictures of each object (Shi et al. 2019); for comparison with as many.",
        [Table(["method", *OBJECTS, "mean"], published)],
    )
    yield Section(
        "Each object",
        "Relighting is the RMSE over RMS of pictures that were not fitted, whose light alone is.",
        [Table.of(found)],
    )
    sheets = [
        Picture(f"errors-{name}", f"{name}: black is 0°, white {LARGEST_SHOWN:g}°.", png)
        for name in names
        if (png := _errors(results, name)) is not None
    ]
    if sheets:
        yield Section("Where normals are off", figures=sheets)


def _table(results: Of, names: Sequence[str]) -> Table:
    """A line a number of pictures and way; the mean is of ways that all objects have."""
    lines: list[list[Value]] = []
    for keep, way, of in _each(results):
        angles = _angles(of)
        whole = len(angles) == len(of.pairs)
        mean = float(np.mean(list(angles.values()))) if angles and whole else None
        shown = [angles.get(name) for name in names]
        lines.append([f"{keep} pictures, {IN_WORDS[way]}", *shown, mean])
    return Table(["", *names, "mean"], lines)


def _errors(results: Of, name: str) -> bytes | None:
    """PNG of errors by way."""
    errors = {
        f"{IN_WORDS[task.way]}, {task.keep}": unpacked(values["error"])["error"]
        for task, values in results.finished
        if task.source.name == name and "error" in values
    }
    return in_lines({"": errors}) if errors else None


def files(results: Of) -> Mapping[str, bytes]:
    """With `--mat` the normals of the most pictures, for the pages that take submissions."""
    return {
        f"{task.source.name}-{task.way}.mat": _mat(values)
        for task, values in results.finished
        if results.options.mat and "estimate" in values
    }


def _mat(values: Mapping[str, Any]) -> bytes:
    """MATLAB's form 5: Normal_est, (H, W, 3) float64 unit vectors, 0 outside the mask."""
    from scipy.io import savemat

    plain = np.frombuffer(base64.b64decode(values["estimate"]), "<f4")
    file = io.BytesIO()
    savemat(file, {"Normal_est": plain.reshape(values["shape"]).astype(np.float64)})  # type: ignore[arg-type]
    return file.getvalue()


PICTURES = (4, 8, 16, 24, 32, 96)
"""Pictures of an object that are fitted."""

HELD_OUT = 8
"""Pictures that are not, on which relighting is judged."""


def cases(options: Options) -> list[Task]:
    """All objects in every way, of every number of pictures that they have.

    Normals are kept of the most pictures alone.

    Raises InputError or FileNotFoundError if there are no pictures, or two objects have one name.
    """
    return [
        Task(
            *(source, way, 0, digest, HELD_OUT, 1, source.pictures, options.max_size),
            keep=keep,
            linear=source.linear,
            mapped=keep == numbers[-1],
        )
        for source in asked_sources(options.folders, os.environ)
        for digest in [digest_of_files(source.folder)]
        for numbers in [sorted({min(n, source.pictures) for n in options.pictures})]
        for keep in numbers
        for way in WAYS
        if way in options.ways
    ]


SUITE = Suite(
    name="diligent",
    title="Photometric stereo",
    protocol="pbrfit-diligent-1: mean angle in degrees over the mask; pictures evenly "
    f"chosen; relighting as of pbrfit-heldout-1 on at most {HELD_OUT} others; {{max_size}} pixels",
    cases=cases,
    run=run,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    files=files,
    folders="object, or folder of such, as DiLiGenT, DiLiGenT10², LUCES and Harvard publish them, "
    "or scene folders with set.json and normals.npz",
    settings={
        "ways": several("NAME", WAYS),
        "pictures": Setting(
            PICTURES,
            PICTURES[1:2],
            value(
                "N",
                positive,
                "numbers of pictures that are fitted, as far as an object has so many (default: "
                f"{' '.join(map(str, PICTURES))}, with --quick {PICTURES[1]})",
                nargs="+",
            ),
        ),
        "max_size": count("PIXELS", "average larger pictures down to this longer side", 1024, 64),
        "mat": fixed(
            False,
            switch("write the normals of the most pictures as NAME-WAY.mat, (H, W, 3) Normal_est"),
        ),
    },
    about=(
        "Mean angles between the normals of a fit and measured ones, of objects under far lamps, "
        "one a picture. A fit is told all of the lamps, their directions, or nothing. Least "
        "squares (Woodham 1980) is told all; trimmed, it leaves out a quarter of a pixel's "
        "samples at either end.",
    ),
    timed=True,
)
