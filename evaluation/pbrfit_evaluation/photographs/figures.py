"""Held-out photographs as rows, verdicts, tables, a plot, sheets and a CSV file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.sheet import Panel as SheetPanel
from pbrfit.result.sheet import Row as SheetRow
from pbrfit.result.sheet import as_png, sheet
from pbrfit_evaluation.panels import unpacked
from pbrfit_evaluation.photographs.explanations import IN_WORDS, WAYS, Way
from pbrfit_evaluation.photographs.measure import Task
from pbrfit_evaluation.real.held_out import PictureScore, relative_error
from pbrfit_evaluation.real.pictures import ERROR_SPAN
from pbrfit_evaluation.real.sources import Source, absent, find_data
from pbrfit_evaluation.suite import (
    Column,
    Line,
    Panel,
    Picture,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Value,
    Verdict,
    figure,
)

HELD_OUT = Column("relative_rmse", "error of\nheld-out pictures", best="low")

COLUMNS = (
    HELD_OUT,
    Column("kept_relative_rmse", "error of\nkept pictures"),
    Column("psnr", "PSNR, dB", best="high"),
    Column("ssim", "SSIM", best="high"),
    Column("normals_median", "normals off by,\nmedian, degrees", best="low"),
    Column("normals_mean", "mean,\ndegrees", best="low"),
    Column("seconds"),
)

GUESSES: tuple[Way, ...] = ("constant",)

WITHOUT: dict[Way, tuple[Way, ...]] = {
    "ours": ("lambert", "nearest"),
    "ours-known": ("lambert-known", "nearest"),
}
"""What can be had without ours, told as much."""

NO_WORSE = 1.0
"""Error of ours over that of the best of these, at most."""

GOOD_ERROR, GOOD_DEGREES = 0.02, 1.0
"""Relative error and median angle of normals below which nothing has to be better: what a file of 8
bits keeps of a picture, and of a normal."""

MAPS = ("relit", "error", "normals", "height", "albedo", "roughness", "metallic")
"""Panels of a way, in order."""

CAPTIONS = {
    "relit": "relit",
    "error": f"|error|, white = {ERROR_SPAN:g}",
    "normals": "normals",
    "height": "their height",
    "albedo": "albedo",
    "roughness": "roughness, white = 1",
    "metallic": "metallic, white = 1",
}

Of = Results[Task]


def _sources(results: Of) -> list[Source]:
    return list(dict.fromkeys(task.source for task, _ in results.pairs))


def _scores(of: Of) -> tuple[PictureScore, ...]:
    return tuple(PictureScore(**one) for _, values in of.finished for one in values["scores"])


def _metrics(of: Of) -> dict[str, float | None]:
    """Over all folds: errors of all held-out pictures together, means of the others."""
    scores = _scores(of)
    return {
        "relative_rmse": relative_error(scores),
        "kept_relative_rmse": of.mean("kept_error").mean,
        "psnr": float(np.mean([one.psnr for one in scores])),
        "ssim": float(np.mean([one.ssim for one in scores])),
        "normals_median": of.mean("normals", "median").mean,
        "normals_mean": of.mean("normals", "mean").mean,
        "seconds": of.mean("seconds").mean,
        "folds": float(len(of.finished)),
    }


def figures(results: Of) -> list[Row]:
    """A row a source and way; one that says why where there is nothing."""
    rows = []
    for source in _sources(results):
        for way in WAYS:
            of = results.of(source=source, way=way)
            if not of.pairs:
                continue
            error = next((record.error for record in of.failed), None)
            scenes, metrics = (1, _metrics(of)) if of.finished else (0, {})
            status = error or ("ok" if of.finished else "not run")
            rows.append(
                Row(
                    *(source.name, scenes, IN_WORDS[way], metrics),
                    status=status,
                    guess=way in GUESSES,
                )
            )
    found = _sources(results)
    paths = find_data(results.options.folders, os.environ)
    for missing in (one for path in paths for one in absent(path.absolute(), found)):
        rows.append(Row(missing.kind, 0, None, {}, status=f"not there: {missing.origin}"))
    return rows


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Ours explains pictures and finds normals no worse than what can be had without it."""
    for source in _sources(results):
        for way, others in WITHOUT.items():
            ours = results.of(source=source, way=way)
            least = {other: _error(results.of(source=source, way=other)) for other in others}
            best = min(least, key=lambda one: least[one])
            if not ours.finished or not math.isfinite(least[best]):
                continue
            what = f"{source.name}, {IN_WORDS[way]}: error over that of {IN_WORDS[best]}"
            level = max(least[best], GOOD_ERROR)
            yield Verdict(what, _error(ours) / level, NO_WORSE, _floor(level, least[best]))
            by_normals = ours.mean("normals", "median").mean
            matt = results.of(source=source, way="lambert-known").mean("normals", "median").mean
            if way == "ours-known" and math.isfinite(by_normals) and math.isfinite(matt):
                what = f"{source.name}, {IN_WORDS[way]}: normals off over those of "
                level = max(matt, GOOD_DEGREES)
                yield Verdict(
                    what + IN_WORDS["lambert-known"],
                    by_normals / level,
                    NO_WORSE,
                    _floor(level, matt),
                )


def _floor(level: float, value: float) -> str:
    return f"over {level:g}, as that is less" if level > value else ""


def _error(of: Of) -> float:
    """Inf where there is nothing."""
    return relative_error(_scores(of)) if of.finished else math.inf


def csvs(results: Of, _: object) -> dict[str, list[Line]]:
    """Every held-out picture as every way has it."""
    lines: list[Line] = [
        {
            "source": task.source.name,
            "way": task.way,
            "fold": task.fold,
            "picture": score["name"],
            "rms": score["rms"],
            "rmse": score["rmse"],
            "relative_rmse": score["rmse"] / score["rms"] if score["rms"] > 0 else None,
            "psnr": score["psnr"],
            "ssim": score["ssim"],
        }
        for task, values in results.finished
        for score in values["scores"]
    ]
    return {"pictures.csv": lines}


def _in_short(rows: Sequence[Row]) -> Table:
    """Errors of held-out pictures, a line a set and a column a way; the least is bold."""
    ways = list(dict.fromkeys(row.solver for row in rows))
    lines: list[list[Value]] = []
    for name in dict.fromkeys(row.name for row in rows):
        of = {row.solver: row for row in rows if row.name == name}
        alike = [row for row in of.values() if not row.guess]
        cells = [figure(of[way], HELD_OUT, alike) if way in of else None for way in ways]
        lines.append([name, *cells])
    return Table(["set", *(way or "" for way in ways)], lines)


def sections(results: Of, rows: Sequence[Row]) -> Iterator[Section]:
    """The errors in short, all figures, a plot, a sheet a source and what the sources are."""
    done = [row for row in rows if row.scenes]
    if done:
        yield Section(
            "In short",
            "Errors of held-out pictures, RMSE over RMS radiance; 1 is that of black.",
            [_in_short(done)],
        )
    yield Section(
        "Held-out photographs",
        "Errors are RMSE over RMS radiance, 1 is that of black; angles are to the true normals, "
        "where these are known. Ways that are told the lamps are told those of held-out pictures, "
        "too, and fit their strength and colour.",
        [Table.of(rows, COLUMNS)],
        [_plot(rows)] if done else [],
    )
    for source in _sources(results):
        drawn = _sheet(results.of(source=source))
        if drawn is not None:
            caption = f"{source.name}: the first held-out picture, and what explains it."
            yield Section(
                source.name,
                "Normals as colours: red, green and blue are right, up and towards the viewer. "
                "Height is that of the normals, brighter towards the viewer, in light from the "
                "upper left.",
                figures=[Picture(f"sheet-{source.name}", caption, as_png(drawn))],
            )
    yield Section("The sets", tables=[_sets(results)])


def _plot(rows: Sequence[Row]) -> Plot:
    """A line a source, a colour a way."""
    series = []
    for look, way in enumerate(WAYS):
        of = [row for row in rows if row.solver == IN_WORDS[way] and row.scenes]
        if of:
            errors = [row.metrics["relative_rmse"] or math.nan for row in of]
            names = [row.name for row in of]
            series.append(Series(IN_WORDS[way], errors, names, look=look))
    count = len({row.name for row in rows if row.scenes})
    panel = Panel("dots", series, "held-out pictures: RMSE / RMS radiance", log="x")
    caption = "Error of held-out pictures; 1 is that of black."
    return Plot("held_out", caption, [panel], size=(8, 1 + 0.7 * count))


def _sheet(of: Of) -> NDArray[np.uint8] | None:
    """The photograph and what is known; below, a row a way that finds a shape; what others relight.

    None without anything.
    """
    kept = {
        task.way: unpacked(values["panels"]) for task, values in of.finished if "panels" in values
    }
    if not kept:
        return None
    first = next(iter(kept.values()))
    shapes = [way for way in WAYS if way in kept and "normals" in kept[way]]
    others = [way for way in WAYS if way in kept and way not in shapes]
    columns = [name for name in MAPS if any(name in kept[way] for way in shapes)]
    known = {
        "relit": ("photograph", "held-out picture"),
        "normals": ("true normals", "true normals"),
        "height": ("true height", "their height"),
    }
    top: SheetRow = []
    for name in columns or ["relit"]:
        panel, caption = known.get(name, ("", ""))
        top.append(SheetPanel(caption, first[panel]) if panel in first else None)
    rows, labels = [top], [""]
    captioned: set[str] = set()
    for way in shapes:
        row: SheetRow = []
        for name in columns:
            caption = "" if name in captioned else CAPTIONS[name]
            row.append(SheetPanel(caption, kept[way][name]) if name in kept[way] else None)
            captioned |= {name} & kept[way].keys()
        rows.append(row)
        labels.append(IN_WORDS[way])
    if others:
        rows.append([SheetPanel(IN_WORDS[way], kept[way]["relit"]) for way in others])
        rows.append([SheetPanel("", kept[way]["error"]) for way in others])
        labels += ["relit", CAPTIONS["error"]]
    return sheet(rows, labels=labels)


def _sets(results: Of) -> Table:
    """What was used of each source."""
    lines: list[list[Value]] = []
    for source in _sources(results):
        of = results.of(source=source)
        used: list[Value] = [None] * 4
        if of.finished:
            first = of.finished[0][1]
            width, height = first["size"]
            used = [f"{width} × {height}", first["pixels"], 100 * first["clipped"], first["kept"]]
        lines.append([source.name, source.about, float(source.pictures), *used])
    head = ["set", "what it is", "pictures", "size", "pixels used", "% of samples clipped", "kept"]
    return Table(head, lines)
