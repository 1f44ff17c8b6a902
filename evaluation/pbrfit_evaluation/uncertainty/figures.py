"""Coverage and verdicts of all conditions as rows, bars, tables and plots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from pbrfit.commands.arguments import choice
from pbrfit.model.reflection import DEFAULT_MODEL, MODELS
from pbrfit.result.verdict import (
    LEVELS,
    PARAMETERS,
    ROUGH_ERROR,
    ROUGH_MAX,
    USABLE_ERROR,
    USABLE_MAX,
)
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.grid.figures import Metrics, Of, grid_rows
from pbrfit_evaluation.options import count, fixed
from pbrfit_evaluation.plots import draw, dress, mark, panels, png
from pbrfit_evaluation.suite import Picture, Row, Section, Suite, Table, Value, Verdict, digits
from pbrfit_evaluation.uncertainty.measure import CONDITIONS, GRID, GROUPS, run

COVERED = (0.9, 0.99)
"""Share of the errors within two deviations, at least and at most: of a Gaussian 0.954."""

ABOVE_GUESS = 1.02
"""Mean error of a map over that of the constant guess, at most."""

USABLE_RIGHT, UNDETERMINED_WRONG = 0.95, 0.1
"""Share of the maps called usable whose error is so small, at least; and of those called not
determined whose error is that of a rough guide or better, at most."""

LEAST_ERROR = 1e-3
"""RMSE below which maps are drawn at it: far below all that verdicts tell apart."""

METRICS = ("within_1", "within_2", "in_interval", "deviation", "rmse", "guess", "expected_error")


# ------------------------------------------------------------------------------------------ rows


def rows(results: Of) -> list[Row]:
    """A row a condition: of each map means over scenes."""

    def more(_: str, __: str, of: Of) -> Metrics:
        found: dict[str, float | None] = {}
        for name in PARAMETERS:
            means = {key: of.average("said", name, key) for key in METRICS}
            over = means["rmse"] / means["guess"] if means["guess"] else math.nan
            of_map = {**means, **of.metrics(["within_2"], "said", name), "over_guess": over}
            found |= {f"{name}_{key}": value for key, value in of_map.items()}
        return found

    return grid_rows(GRID, results, ("seconds",), more)


# -------------------------------------------------------------------------------------- verdicts


def verdicts(results: Of, of_rows: Sequence[Row]) -> Iterator[Verdict]:
    """What coverage, errors and levels have to be."""
    for row in of_rows:
        yield from _row_verdicts(row)
    said = confusion(results)
    usable, undetermined = said[0], said[-1]
    yield _of_said(f"“{LEVELS[0]}” and right", usable[0], usable.sum(), USABLE_RIGHT, at_least=True)
    wrong = undetermined[:-1].sum()
    yield _of_said(f"“{LEVELS[-1]}” and wrong", wrong, undetermined.sum(), UNDETERMINED_WRONG)


def _row_verdicts(row: Row) -> Iterator[Verdict]:
    """Of the maps that are farthest off; a row without scenes holds nothing."""

    def of_maps(metric: str) -> dict[str, float]:
        found = {name: row.metrics.get(f"{name}_{metric}") for name in PARAMETERS}
        return {name: math.nan if value is None else value for name, value in found.items()}

    within, over = of_maps("within_2"), of_maps("over_guess")
    low, high = COVERED
    least, most = min(within, key=within.__getitem__), max(within, key=within.__getitem__)
    worst = max(over, key=over.__getitem__)
    what = f"{row.name}: share of errors within two deviations"
    yield Verdict(f"{what}, least", within[least], low, least, at_least=True)
    yield Verdict(f"{what}, largest", within[most], high, most)
    yield Verdict(f"{row.name}: error over the constant guess's", over[worst], ABOVE_GUESS, worst)


def _of_said(
    what: str, count: float, total: float, bar: float, *, at_least: bool = False
) -> Verdict:
    """A share of what was said; where it was never said there is nothing to hold."""
    if not total:
        return Verdict(f"share of maps called {what}", math.nan, None, "no map was called so")
    where = f"{count:.0f} of {total:.0f}"
    return Verdict(f"share of maps called {what}", count / total, bar, where, at_least=at_least)


def confusion(results: Of) -> Array:
    """(3, 3): how many maps were called each level (rows) and by their error are each (columns)."""
    found = np.zeros((len(LEVELS), len(LEVELS)))
    for _, values in results.finished:
        for one in values["said"].values():
            found[LEVELS.index(one["said"]), LEVELS.index(one["deserved"])] += 1
    return found


# --------------------------------------------------------------------------------- what is shown


def sections(results: Of, of_rows: Sequence[Row]) -> Iterator[Section]:
    """Coverage and errors in short, and the plot of verdicts."""
    yield Section(
        "In short",
        "Errors within two deviations, and RMSE in brackets, of each map.",
        [_in_short(of_rows)],
    )
    if results.finished:
        yield Section("Verdicts", figures=[_expected(results)])


def _in_short(of_rows: Sequence[Row]) -> Table:
    def of_map(row: Row, name: str) -> str:
        within, error = (row.metrics.get(f"{name}_{one}") for one in ("within_2", "rmse"))
        return "–" if within is None or error is None else f"{within:.3f} ({digits(error)})"

    lines: list[list[Value]] = [
        [row.name, float(row.scenes), *(of_map(row, name) for name in PARAMETERS)]
        for row in of_rows
    ]
    return Table(["", "scenes", *PARAMETERS], lines)


def _expected(results: Of) -> Picture:
    """Expected and true errors of the maps of all scenes."""
    figure, grid = panels(len(PARAMETERS), len(PARAMETERS), (3.3, 2.9))
    for axes, name in zip(grid, PARAMETERS, strict=True):
        for place, group in enumerate(GROUPS):
            found = [
                values["said"][name]
                for case, values in results.finished
                if CONDITIONS[case.condition].group == group
            ]
            x, y = (
                [max(one[key], LEAST_ERROR) for one in found] for key in ("expected_error", "rmse")
            )
            if found:
                draw(axes, x, y, place, group, joined=False)
        for axis, limits in (("x", (USABLE_MAX, ROUGH_MAX)), ("y", (USABLE_ERROR, ROUGH_ERROR))):
            for limit in limits:
                mark(axes, limit[name], axis=axis)
        axes.set(xlim=(LEAST_ERROR, 1.0), ylim=(LEAST_ERROR, 1.0))
        dress(axes, "RMSE expected", "RMSE", name, log="xy")
    caption = (
        "A point a scene. Lines: errors up to which a map is usable, or a rough guide, and "
        "expected ones up to which it is called so; right verdicts are in the squares along the "
        f"diagonal. What is below {LEAST_ERROR:g} is drawn there."
    )
    return Picture("verdicts", caption, png(figure))


SUITE = Suite(
    name="uncertainty",
    title="Is the uncertainty right?",
    protocol="pbrfit-uncertainty-2: values of maps within their deviations and intervals, RMSE of "
    "maps by their verdicts; {size} pixels, model {model}, {effort}",
    cases=GRID.cases,
    run=run,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    settings={
        **GRID.settings(9300, count("K", "of a condition", 10, 1), (64, 32), "rows"),
        "model": fixed(
            DEFAULT_MODEL, choice(MODELS, "that is fitted, of `pbrfit decompose --model`")
        ),
    },
    about=(
        "Rooms with known materials, 16 pictures each, fitted with all defaults. In some rows the "
        "pictures are as the model has them, in others something is wrong that no fit knows of: "
        "normals, field of view, order of the lights or reflection model, files of 8 bits, "
        "shadows, bounced light, lamps. A posterior is right where the errors of its values are "
        "as large as it says, whatever is wrong. docs/uncertainty.md says what must hold.",
    ),
)
