"""The suite's plots, as PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

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
from pbrfit_evaluation.solvers import exact, gap, race
from pbrfit_evaluation.table1.rows import COLUMNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = Mapping[str, Any]

OF_FIT = {
    "gauss-newton": (BLUE, "o"),
    "auto": (ORANGE, "D"),
    "lbfgsb": (BLACK, "s"),
    "gauss-newton, float64": (GREEN, "^"),
}
OF_RUNNER = {
    "paper": (GREY, "s", "--"),
    "gauss-newton": (BLUE, "o", "-"),
    "auto": (ORANGE, "D", "-"),
    "lbfgsb": (BLACK, "s", "-"),
    "torch": (PURPLE, "^", "-"),
}
OF_COLUMN = dict(
    zip(
        COLUMNS,
        ((BLACK, "o"), (BLUE, "s"), (GREEN, "D"), (ORANGE, "^"), (SKY, "v")),
        strict=True,
    )
)

LEAST = 1e-17
"""Errors of 0 are drawn here."""

FIRST_S = 1e-2
"""Where the time axis begins: the start itself is drawn there."""


def draw_exact(found: Sequence[tuple[Any, Values]]) -> bytes:
    """Residual, and the worst map's RMSE, of every room."""
    figure = new_figure(12, 6.5)
    above, below = figure.subplots(2, 1, sharex=True)
    for name, (color, marker) in OF_FIT.items():
        seeds = [task.seed for task, _ in found]
        recon = [max(values[name]["recon"], LEAST) for _, values in found]
        maps = [max(LEAST, *(values[name][m] for m in exact.MAPS)) for _, values in found]
        for axes, errors in ((above, recon), (below, maps)):
            # Those that end alike lie on each other: a ring around a dot shows both.
            look = {"markersize": 8, "fillstyle": "none"} if name == "gauss-newton" else {}
            axes.plot(seeds, errors, marker, color=color, label=name, **{"markersize": 4.5, **look})
    _bar(above, exact.RECON_FLOAT32, "bar, float32 pictures")
    _bar(above, exact.RECON_FLOAT64, "bar, float64 pictures")
    _bar(below, exact.MATERIAL, "bar")
    above.set_ylabel("residual RMS / picture RMS")
    below.set_ylabel("worst map's RMSE")
    below.set_xlabel("seed of the room")
    below.xaxis.get_major_locator().set_params(integer=True)
    for axes in (above, below):
        axes.set_yscale("log")
        _tidy(axes)
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return as_png(figure, dpi=100)


def draw_race(found: Sequence[tuple[Any, Values]]) -> bytes:
    """Residual against wall time, a panel a scene."""
    seeds = list(dict.fromkeys(task.seed for task, _ in found))
    figure = new_figure(12, 1.0 + 3.4 * len(seeds))
    panels = figure.subplots(len(seeds), 1, sharex=True, squeeze=False)[:, 0]
    for axes, seed in zip(panels, seeds, strict=True):
        runs = {task.runner: values for task, values in found if task.seed == seed}
        mark = runs["paper"]["residual"] / runs["paper"]["pictures_rms"]
        for runner in race.RUNNERS:
            if runner.key not in runs:
                continue
            values = runs[runner.key]
            color, marker, dash = OF_RUNNER[runner.key]
            seconds = [max(point[0], FIRST_S) for point in values["points"]]
            residuals = [point[2] / values["pictures_rms"] for point in values["points"]]
            axes.plot(seconds, residuals, dash, color=color, lw=1.6)
            if values["reached"] is not None and not values["is_mark"]:
                axes.plot(max(values["reached"], FIRST_S), mark, marker, color=color, markersize=9)
            axes.plot(seconds[-1], residuals[-1], marker, color=color, markersize=4)
        axes.axhline(mark, color="0.4", linewidth=1, linestyle=(0, (1, 3)))
        size = next(task.size for task, _ in found)
        axes.set_title(f"{size}², seed {seed}", loc="left", fontsize=10.5, fontweight="bold")
        axes.set(xscale="log", yscale="log", ylabel="residual RMS / picture RMS")
        _tidy(axes)
    panels[-1].set_xlabel("wall time / s")
    handles = [
        panels[0].plot([], [], dash, marker=marker, color=color, label=race.BY_KEY[key].name)[0]
        for key, (color, marker, dash) in OF_RUNNER.items()
        if any(task.runner == key for task, _ in found)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    return as_png(figure, dpi=100)


def draw_gap(ratios: Mapping[str, Mapping[str, float]]) -> bytes:
    """Ratios of errors, a line a row of table1."""
    from matplotlib.ticker import FuncFormatter, NullLocator

    figure = new_figure(9, 1.4 + 0.5 * len(ratios))
    axes = figure.subplots()
    for place, of_row in enumerate(ratios.values()):
        for step, (column, ratio) in enumerate(of_row.items()):
            color, marker = OF_COLUMN[column]
            axes.plot(ratio, place + 0.13 * (step - 2), marker, color=color, markersize=6)
    for border in range(1, len(ratios)):
        axes.axhline(border - 0.5, color="#dddddd", linewidth=0.8)
    axes.axvline(1.0, color="0.3", linewidth=1)
    axes.axvline(gap.WORST_COLUMN, color=AMBER, linewidth=1, linestyle="--")
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    low, high = min(low, 0.7), max(high, 1.4)
    axes.set_xlim(low, high)
    ticks = [t for t in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.25, 2.0, 3.0, 5.0) if low <= t <= high]
    axes.set_xticks(ticks)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_yticks(range(len(ratios)), list(ratios))
    axes.set_ylim(len(ratios) - 0.5, -0.5)
    axes.set_xlabel("error of auto / error of the paper's recipe (dashed: the bar of a column)")
    handles = [
        axes.plot([], [], marker, color=color, label=column)[0]
        for column, (color, marker) in OF_COLUMN.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    return as_png(figure, dpi=100)


def _bar(axes: Axes, value: float, text: str) -> None:
    axes.axhline(value, color="0.4", linewidth=1, linestyle=(0, (1, 3)))
    axes.text(
        0.995,
        value,
        text,
        transform=axes.get_yaxis_transform(),
        ha="right",
        va="bottom",
        fontsize=8,
        color="0.35",
    )


def _tidy(axes: Axes) -> None:
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
