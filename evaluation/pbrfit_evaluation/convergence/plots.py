"""The suite's plots, as PNG: one a quantity, a row of panels a case."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pbrfit.result.drawing import (
    AMBER,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    as_png,
    new_figure,
)
from pbrfit.synthetic.exposure import MEAN_RADIANCE
from pbrfit_evaluation.convergence import SOLVERS, Case, Curve
from pbrfit_evaluation.convergence.measure import Array, Quantity, on_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = (BLACK, GREY, BLUE, ORANGE, GREEN, PURPLE, SKY, AMBER, GREY)
"""By place in the roster."""

DASHES = ("-", "--", "-", "-", "-", "-", "-", "-", ":")
MARKERS = ("o", "o", "s", "^", "D", "v", "P", "X", "x")

LABELS: dict[Quantity, str] = {
    "recon": "recon RMSE (radiance)",
    "albedo": "albedo RMSE",
    "albedo_scaled": "albedo RMSE, best scale",
    "roughness": "roughness RMSE",
    "metallic": "metallic RMSE",
    "relight": "relight RMSE (radiance)",
}

GRID = 240
FINEST_S = 1e-2
"""Where the time axis begins."""


def draw(curves: Sequence[Curve], quantity: Quantity) -> bytes:
    """Error against wall time (left) and evaluations (right); medians, and spread over seeds."""
    cases = list(dict.fromkeys(curve.task.case for curve in curves))
    figure = new_figure(12, 1.0 + 2.5 * len(cases))
    axes = figure.subplots(len(cases), 2, sharex="col", squeeze=False)
    for (left, right), case in zip(axes, cases, strict=True):
        of_case = [curve for curve in curves if curve.task.case == case]
        _panel(left, of_case, quantity, "seconds", case)
        _panel(right, of_case, quantity, "evaluations", case)
        right.set_ylim(left.get_ylim())
        right.tick_params(which="both", labelleft=False)
        left.set_ylabel(LABELS[quantity])
        left.set_title(_title(of_case), loc="left", fontsize=10.5, fontweight="bold")
    axes[-1, 0].set_xlabel("wall time / s")
    axes[-1, 1].set_xlabel("evaluations of loss and gradient")
    handles = [
        axes[0, 0].plot([], [], **_look(name), linewidth=1.8, markersize=5, label=title)[0]
        for name, title in _solvers(curves)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False)
    return as_png(figure, dpi=100)


def _panel(axes: Axes, curves: Sequence[Curve], quantity: Quantity, cost: str, case: Case) -> None:
    for name, _ in _solvers(curves):
        runs = [curve for curve in curves if curve.task.solver == name]
        look = _look(name)
        grid, table = _table(runs, quantity, cost)
        shown = np.isfinite(table).all(axis=0)
        if not shown.any():
            continue
        middle = np.median(table[:, shown], axis=0)
        if len(runs) > 1:
            low, high = table[:, shown].min(axis=0), table[:, shown].max(axis=0)
            axes.fill_between(grid[shown], low, high, color=look["color"], alpha=0.10, linewidth=0)
        axes.plot(grid[shown], middle, color=look["color"], linestyle=look["linestyle"], lw=1.6)
        axes.plot(grid[shown][-1:], middle[-1:], **look, markersize=5)
    if quantity == "recon" and case.noise:
        axes.axhline(case.noise * MEAN_RADIANCE, color="0.4", linewidth=1, linestyle=(0, (1, 3)))
        axes.text(
            0.995,
            case.noise * MEAN_RADIANCE,
            "noise",
            transform=axes.get_yaxis_transform(),
            ha="right",
            va="bottom",
            fontsize=8,
            color="0.35",
        )
    axes.set(xscale="log", yscale="log")
    axes.grid(color="0.9", linewidth=0.8)
    axes.grid(which="minor", axis="y", color="0.95", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _table(runs: Sequence[Curve], quantity: Quantity, cost: str) -> tuple[Array, Array]:
    """Costs from the first that is shown to the last, and the runs' errors there."""
    costs = [[getattr(point, cost) for point in run.points] for run in runs]
    errors = [[getattr(point.errors, quantity) for point in run.points] for run in runs]
    first = max(max(of_run[0] for of_run in costs), FINEST_S if cost == "seconds" else 1.0)
    last = max(max(of_run) for of_run in costs)
    grid = np.geomspace(first, max(last, first * 1.01), GRID)
    table = np.stack([on_grid(grid, *run) for run in zip(costs, errors, strict=True)])
    return grid, table


def _title(curves: Sequence[Curve]) -> str:
    numbers = {curve.task.seed: curve.condition for curve in curves}.values()
    low, high = min(numbers), max(numbers)
    span = f"{low:,.0f}" if f"{low:,.0f}" == f"{high:,.0f}" else f"{low:,.0f} to {high:,.0f}"
    return f"{curves[0].task.case.title} (condition number {span})"


def _solvers(curves: Sequence[Curve]) -> list[tuple[str, str]]:
    """Names and titles of those that ran, in the order of the roster."""
    ran = {curve.task.solver for curve in curves}
    return [(solver.name, solver.title) for solver in SOLVERS if solver.name in ran]


def _look(name: str) -> dict[str, Any]:
    place = [solver.name for solver in SOLVERS].index(name)
    return {
        "color": COLORS[place % len(COLORS)],
        "linestyle": DASHES[place % len(DASHES)],
        "marker": MARKERS[place % len(MARKERS)],
    }
