"""Table 1 as rows, tables and a plot; the tables that pages of the docs show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

from pbrfit.model.reflection import Model
from pbrfit_evaluation.grid.figures import Of, pictures
from pbrfit_evaluation.grid.figures import rows as grid_rows
from pbrfit_evaluation.options import models
from pbrfit_evaluation.plots import dots
from pbrfit_evaluation.scores import Scores
from pbrfit_evaluation.suite import Column, Picture, Section, Table, Value, digits
from pbrfit_evaluation.suite import Row as Figures
from pbrfit_evaluation.table1.measure import GRID
from pbrfit_evaluation.table1.rows import BY_KEY, COLUMNS, WAYS

METRICS = tuple(f.name for f in fields(Scores))

EXACT = 1e-6
"""RMSE below which a map is as good as the rounding of its pictures lets it be."""

LEAST_SHOWN = 1e-3
"""RMSE at which the plot's axes begin."""


def rows(results: Of) -> list[Figures]:
    """A row for each setup, model and way, by setups."""
    asked = models(results.options)
    of_model = [grid_rows(GRID, results.of(model=model), METRICS) for model in asked]
    titles = {row.name: row for row in BY_KEY.values()}
    order = list(titles)
    return sorted(
        (
            replace(row, name=f"{row.name}, {model}", paper=titles[row.name].paper or None)
            for model, found in zip(asked, of_model, strict=True)
            for row in found
        ),
        key=lambda row: order.index(row.name.rpartition(", ")[0]),
    )


def sections(results: Of, rows: Sequence[Figures]) -> Iterator[Section]:
    """Tables, the plot and the first scene of each setup."""
    labels = {way.words: way.words for way in WAYS.values()}
    caption = f"With intervals. What is exact stands at {LEAST_SHOWN:g}."
    plots = []
    if results.finished:
        plots = [Picture("table1", caption, dots(rows, labels, COLUMNS, LEAST_SHOWN))]
    columns = [Column(name, best="low") for name in COLUMNS]
    yield Section("The paper's columns", "RMSE, linear values.", [Table.of(rows, columns)], plots)
    yield Section(
        "In short",
        "The same without intervals: ours / the paper's recipe / the constant guess / what the "
        "paper reports of its own scenes.",
        [_in_short(rows, model) for model in models(results.options)],
    )
    labels = {key: way.words for key, way in WAYS.items()}
    examples = pictures(results, labels, "The first scene: the truth, and what was found.")
    if examples:
        yield Section("Examples", figures=examples)


def _in_short(rows: Sequence[Figures], model: Model) -> Table:
    """A line a setup; in a cell the error of each way, and the paper's number."""
    lines: list[list[Value]] = []
    for setup in BY_KEY.values():
        of = {row.solver: row for row in rows if row.name == f"{setup.name}, {model}"}
        first = next((row for row in of.values() if row.scenes), None)
        if first is None:
            continue
        recipe = "paper-priors" if "paper-priors" in setup.ways else "paper"
        ways = [of.get(WAYS[key].words) for key in ("default", recipe, "constant")]
        line: list[Value] = [setup.name, float(first.scenes)]
        for metric in COLUMNS[1:]:
            errors = [None if row is None else row.metrics.get(metric) for row in ways]
            line.append(" / ".join(map(_shown, [*errors, setup.paper.get(metric)])))
        lines.append(line)
    heads = [f"{metric}: ours / recipe / guess / paper" for metric in COLUMNS[1:]]
    return Table([f"model {model}", "scenes", *heads], lines)


def _shown(value: float | None) -> str:
    if value is None or value != value:
        return "–"
    return "exact" if value < EXACT else digits(value)
