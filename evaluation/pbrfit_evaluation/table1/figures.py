"""Table 1 as rows, tables, a plot and CSV files; the tables that pages of the docs show."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields

from pbrfit.model.reflection import Model
from pbrfit_evaluation.options import models
from pbrfit_evaluation.recipes import IN_WORDS, Recipe
from pbrfit_evaluation.scores import Scores, better
from pbrfit_evaluation.suite import (
    Column,
    Line,
    Options,
    Picture,
    Results,
    Section,
    Table,
    Value,
    digits,
    dots,
)
from pbrfit_evaluation.suite import Row as Figures
from pbrfit_evaluation.table1.measure import Task, why_not
from pbrfit_evaluation.table1.rows import COLUMNS, ROWS, Row

METRICS = tuple(f.name for f in fields(Scores))

SOLVERS: dict[Recipe, str] = {
    "default": "gauss-newton, default",
    "paper": "lbfgsb, paper's recipe",
    "paper-priors": "lbfgsb, paper's recipe and priors",
    "constant": "constant guess",
}

EXACT = 1e-6
"""RMSE below which a map is as good as the rounding of its pictures lets it be."""

LEAST_SHOWN = 1e-3
"""RMSE at which the plot's axes begin."""

FACTS = {
    "metal_share": "share of\nmetal pixels",
    "condition": "condition\nof the lights",
    "normals_mean": "normals off by,\nmean, degrees",
    "refined_mean": "refined to,\ndegrees",
    "refined_scenes": "share of\nscenes refined",
}
"""About the scenes of a setup."""


def asked_rows(options: Options) -> list[Row]:
    """Setups that `--rows` asks for."""
    return [row for row in ROWS if not options.rows or row.key in options.rows]


def _lines(results: Results[Task]) -> Iterator[tuple[Row, Model, Recipe | None, Results[Task]]]:
    """Setup, model and recipe of every row, and its cases; no recipe where nothing was finished."""
    for row in asked_rows(results.options):
        for model in models(results.options):
            of = results.of(row=row.key, model=model)
            for recipe in row.recipes if of.finished else (None,):
                yield row, model, recipe, of


def rows(results: Results[Task]) -> list[Figures]:
    """A row for each setup, model and recipe."""
    found = []
    for row, model, recipe, of in _lines(results):
        name, paper, status = f"{row.name}, {model}", row.paper or None, of.status("scenes")
        if recipe is None:
            if why := why_not(row, results.options):
                status = f"not run: {why}"
            found.append(Figures(name, 0, None, {}, paper, status))
        else:
            metrics = of.metrics(METRICS, "recipes", recipe)
            guess = recipe == "constant"
            scenes = len(of.finished)
            found.append(Figures(name, scenes, SOLVERS[recipe], metrics, paper, status, guess))
    return found


def csvs(results: Results[Task], _: Sequence[Figures]) -> Mapping[str, Sequence[Line]]:
    """Every scene."""
    scenes = [
        {"scene": task.key, "model": task.model, "recipe": recipe, **values}
        for task, found in results.finished
        for recipe, values in found["recipes"].items()
    ]
    return {"scenes.csv": scenes}


def sections(results: Results[Task], rows: Sequence[Figures]) -> Iterator[Section]:
    """Tables, where ours is not the best, the plot, the setups and the first scene of each."""
    effort = ("seconds", "evaluations")
    rest = [
        Column(name, best=None if name in effort else better(name))
        for name in METRICS
        if name not in COLUMNS
    ]
    labels = {solver: IN_WORDS[recipe] for recipe, solver in SOLVERS.items()}
    caption = f"With intervals. What is exact stands at {LEAST_SHOWN:g}."
    plot = dots("table1", rows, labels, COLUMNS, caption, LEAST_SHOWN)
    plots = [plot] if results.finished else []
    columns = [Column(name, best="low") for name in COLUMNS]
    yield Section("The paper's columns", "RMSE, linear values.", [Table.of(rows, columns)], plots)
    yield Section(
        "In short",
        "The same without intervals: ours / the paper's recipe / the constant guess / what the "
        "paper reports of its own scenes.",
        [_in_short(results, model) for model in models(results.options)],
    )
    yield Section(
        "Where ours is not the best",
        "Of the setups in which ours is compared.",
        [not_the_best(rows)],
    )
    yield Section(
        "More of the same results",
        "Errors on metal pixels alone; albedo and relit pictures after the best factor a channel, "
        "which pictures barely fix; PSNR in dB and SSIM; and the effort.",
        [Table.of([row for row in rows if row.scenes], rest)],
    )
    yield Section("The setups", tables=[_setups(results)])
    examples = [
        Picture(
            f"example-{task.row}-{task.model}",
            f"{task.row}, {task.model}, seed {task.seed}, our default: picture, reconstruction, "
            "maps and normals; below the ground truth and the errors.",
            base64.b64decode(found["preview"]),
        )
        for task, found in results.finished
        if "preview" in found
    ]
    if examples:
        yield Section("Examples", "The first scene of each setup.", figures=examples)


def _in_short(results: Results[Task], model: Model) -> Table:
    """A line a setup; in a cell the error of each recipe, and the paper's number."""
    lines: list[list[Value]] = []
    for row in asked_rows(results.options):
        of = results.of(row=row.key, model=model)
        if not of.finished:
            continue
        line: list[Value] = [row.name, float(len(of.finished))]
        for metric in COLUMNS[1:]:
            found = {
                recipe: of.mean("recipes", recipe, metric).mean
                for recipe in ("default", *_RECIPE_OF.get(row.key, ("paper",)), "constant")
            }
            line.append(" / ".join([*map(_shown, found.values()), _shown(row.paper.get(metric))]))
        lines.append(line)
    heads = [f"{metric}: ours / recipe / guess / paper" for metric in COLUMNS[1:]]
    return Table([f"model {model}", "scenes", *heads], lines)


_RECIPE_OF: dict[str, tuple[Recipe, ...]] = {"regularized": ("paper-priors",)}
"""What stands for the paper's recipe, by setup, where it is another."""


def _shown(value: float | None) -> str:
    if value is None or value != value:
        return "–"
    return "exact" if value < EXACT else digits(value)


def not_the_best(rows: Sequence[Figures]) -> Table:
    """Setups where something has less error than ours: in such a column ours, and the best."""
    lines: list[list[Value]] = []
    for ours in (row for row in rows if row.solver == SOLVERS["default"]):
        others = [row for row in rows if row.name == ours.name and row is not ours]
        cells = [_beaten(metric, ours, others) for metric in COLUMNS]
        if any(cells):
            lines.append([ours.name, *cells])
    return Table(["setup", *COLUMNS], lines)


def _beaten(metric: str, ours: Figures, others: Sequence[Figures]) -> str:
    """Our error and the least of the others, if that is less; else nothing."""
    mine = ours.metrics.get(metric)
    known = [
        (error, row.guess)
        for row in others
        if (error := row.metrics.get(metric)) is not None and not math.isnan(error)
    ]
    if mine is None or math.isnan(mine) or not known or min(known)[0] >= mine:
        return ""
    least, guess = min(known)
    return f"{digits(mine)}, {'guess' if guess else 'recipe'} {digits(least)}"


def _setups(results: Results[Task]) -> Table:
    lines: list[list[Value]] = []
    for row in asked_rows(results.options):
        of = results.of(row=row.key, model=models(results.options)[0])  # the same worlds for all
        lines.append([row.name, row.what, *(of.mean("facts", name).mean for name in FACTS)])
    return Table(["setup", "what it is", *FACTS.values()], lines)
