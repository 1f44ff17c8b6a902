"""Held-out pictures as rows, tables, a plot, sheets and a CSV file."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator, Sequence

import numpy as np

from pbrfit.model.reflection import Model
from pbrfit.report.html import Cell
from pbrfit_evaluation.real.held_out import (
    EXPLANATIONS,
    IN_WORDS,
    OF_KEPT_PICTURES,
    Explanation,
    PictureScore,
    relative_error,
)
from pbrfit_evaluation.real.measure import Task
from pbrfit_evaluation.real.public_sets import PublicSet
from pbrfit_evaluation.real.sources import Source, absent, find_data
from pbrfit_evaluation.suite import (
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
    digits,
)

SOLVERS = {"default": "gauss-newton", "plain": "gauss-newton", "paper": "lbfgsb"}

COLUMNS = ("relative_rmse", "psnr", "ssim", "kept_relative_rmse", "seconds")


def _groups(results: Results[Task]) -> Iterator[tuple[Source, Model, Results[Task]]]:
    """Folds of a source and model together."""
    for source, model in dict.fromkeys((task.source, task.model) for task, _ in results.pairs):
        yield source, model, results.of(source=source, model=model)


def _metrics(of: Results[Task], name: Explanation) -> dict[str, float | None]:
    """Over all folds: errors over the RMS of the pictures, of all held-out pictures together."""
    found = [values["explanations"][name] for _, values in of.finished]
    scores = tuple(PictureScore(**score) for one in found for score in one["scores"])
    mean = {
        key: float(np.mean([getattr(score, key) for score in scores])) for key in ("psnr", "ssim")
    }
    return {
        "relative_rmse": relative_error(scores),
        "kept_relative_rmse": of.mean("explanations", name, "kept_error").mean,
        **mean,
        "seconds": of.mean("explanations", name, "seconds").mean,
        "folds": float(len(found)),
    }


def _not_there(results: Results[Task]) -> list[PublicSet]:
    """Public sets that a folder of such does not hold."""
    found = list(dict.fromkeys(task.source for task, _ in results.pairs))
    paths = find_data(results.options.folders, os.environ)
    return [one for path in paths for one in absent(path.absolute(), found)]


def figures(results: Results[Task]) -> list[Row]:
    """A row a source, model and explanation; one that says why where there is nothing."""
    rows = []
    for source, model, of in _groups(results):
        error = next((record.error for record in of.failed), None)
        name = f"{source.name}, {model}"
        if not of.finished:
            rows.append(Row(name, 0, None, {}, status=error or "not run"))
            continue
        for how in EXPLANATIONS:
            metrics, status = _metrics(of, how), error or "ok"
            rows.append(Row(f"{name}, {how}", 1, SOLVERS.get(how), metrics, status=status))
    for missing in _not_there(results):
        rows.append(Row(missing.kind, 0, None, {}, status=f"not there: {missing.origin}"))
    return rows


def csvs(results: Results[Task], _: Sequence[Row]) -> dict[str, list[Line]]:
    """Every held-out picture as every explanation has it."""
    lines: list[Line] = [
        {
            "source": task.source.name,
            "model": task.model,
            "fold": task.fold,
            "explanation": name,
            "picture": score["name"],
            "rms": score["rms"],
            "rmse": score["rmse"],
            "relative_rmse": score["rmse"] / score["rms"] if score["rms"] > 0 else None,
            "psnr": score["psnr"],
            "ssim": score["ssim"],
        }
        for task, values in results.finished
        for name, outcome in values["explanations"].items()
        for score in outcome["scores"]
    ]
    return {"pictures.csv": lines}


def sections(results: Results[Task], rows: Sequence[Row]) -> Iterator[Section]:
    """All sources side by side, all figures, and what the sources are."""
    by_name = {row.name: row for row in rows}
    errors = {
        (source.name, model): {
            name: by_name[f"{source.name}, {model}, {name}"].metrics["relative_rmse"] or 0.0
            for name in EXPLANATIONS
        }
        for source, model, of in _groups(results)
        if of.finished
    }
    if errors:
        yield Section(
            "All sets",
            "Error of held-out pictures relative to their RMS; 1 is that of black. The best of the "
            "materials is bold. The models explain the same pictures by the same solver.",
            [_overview(errors)],
            [_plot(errors)],
        )
    yield Section("All figures", tables=[Table.of(rows, COLUMNS)])
    sheets = [
        Picture(
            f"sheet-{task.source.name}-{task.model}",
            f"{task.source.name}, {task.model}: maps, and a held-out picture as explained by them.",
            base64.b64decode(values["sheet"]),
        )
        for task, values in results.finished
        if values["sheet"] is not None
    ]
    yield Section("The sets", tables=[_sets(results)], figures=sheets)


def _overview(errors: dict[tuple[str, Model], dict[Explanation, float]]) -> Table:
    lines: list[list[Value]] = []
    for (source, model), of in errors.items():
        least = min(error for name, error in of.items() if name not in OF_KEPT_PICTURES)
        cells = [
            Cell(digits(error), "best" if error == least else "number", error)
            for error in of.values()
        ]
        lines.append([source, model, *cells])
    return Table(["set", "model", *IN_WORDS.values()], lines)


def _plot(errors: dict[tuple[str, Model], dict[Explanation, float]]) -> Plot:
    names = [f"{source}, {model}" for source, model in errors]
    series = [
        Series(words, [of[name] for of in errors.values()], names)
        for name, words in IN_WORDS.items()
    ]
    caption = "Error of held-out pictures; 1 is that of black."
    label = "held-out pictures: RMSE / RMS radiance"
    panel = Panel("dots", series, label, log="x")
    return Plot("held_out", caption, [panel], size=(8, 1 + 0.9 * len(names)))


def _sets(results: Results[Task]) -> Table:
    """What was used of each source."""
    lines: list[list[Value]] = []
    for source in dict.fromkeys(task.source for task, _ in results.pairs):
        of = results.of(source=source)
        used: list[Value] = [None] * 4
        if of.finished:
            first = of.finished[0][1]
            width, height = first["size"]
            used = [f"{width} × {height}", first["pixels"], 100 * first["clipped"], first["kept"]]
        lines.append([source.name, source.about, float(source.pictures), *used])
    head = ["set", "what it is", "pictures", "size", "pixels used", "% of samples clipped", "kept"]
    return Table(head, lines)
