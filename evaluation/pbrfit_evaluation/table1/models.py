"""Both reflection models on the same pictures: whose maps are nearer to the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pbrfit.model.reflection import MODELS, Model
from pbrfit_evaluation.page import Cell, Section, Table
from pbrfit_evaluation.recipes import IN_WORDS, Recipe
from pbrfit_evaluation.table1.rows import COLUMNS
from pbrfit_evaluation.tables import Mean

if TYPE_CHECKING:
    from pbrfit_evaluation.table1.report import Outcome

SHOWN = (*COLUMNS, "albedo_scaled")

FITS: tuple[Recipe, ...] = ("plain", "default")


def both_models(
    found: Sequence[Outcome], mean: Callable[[Outcome, Recipe, str], Mean]
) -> list[Section]:
    """Errors with either model, for the setups whose pictures are Cycles'; none without these."""
    by_row: dict[str, dict[Model, Outcome]] = {}
    for outcome in found:
        if outcome.row.renderer == "cycles" and outcome.finished:
            by_row.setdefault(outcome.row.key, {})[outcome.model] = outcome
    rows = [
        line
        for of in by_row.values()
        if len(of) == len(MODELS)
        for recipe in FITS
        if recipe in next(iter(of.values())).row.recipes
        for line in _lines(of, recipe, mean)
    ]
    if not rows:
        return []
    columns = [Cell("Setup"), Cell("Explained by"), Cell("Model")]
    columns += [Cell(name.replace("_", ",\n"), "number") for name in SHOWN]
    return [
        Section(
            "The two models on the same pictures",
            [
                "Of Cycles' pictures; the smaller error of each pair is bold. The third line is "
                "the ratio of the two means."
            ],
            [Table(columns, rows)],
        )
    ]


def _lines(
    of: dict[Model, Outcome], recipe: Recipe, mean: Callable[[Outcome, Recipe, str], Mean]
) -> list[list[Cell]]:
    errors = {model: [mean(of[model], recipe, metric).mean for metric in SHOWN] for model in MODELS}
    least = np.fmin.reduce(list(errors.values()))
    lines = []
    for model in MODELS:
        first = model == MODELS[0]
        cells = [
            Cell("–" if math.isnan(error) else f"{error:.4f}", "best" if error == low else "number")
            for error, low in zip(errors[model], least, strict=True)
        ]
        heads = (of[model].row.name, IN_WORDS[recipe]) if first else ("", "")
        lines.append([*map(Cell, heads), Cell(model, "name"), *cells])
    one, other = (errors[model] for model in MODELS)
    ratios = [
        "–" if math.isnan(b) or not a > 0 else f"{b / a:.2f}"
        for a, b in zip(one, other, strict=True)
    ]
    ratio = Cell(f"{MODELS[1]} / {MODELS[0]}", "note")
    return [*lines, [Cell(""), Cell(""), ratio, *(Cell(text, "number") for text in ratios)]]
