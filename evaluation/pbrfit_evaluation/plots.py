"""The one look of all plots of suites: panels, lines, marks, legends, ticks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from pbrfit_evaluation.suite import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

DPI = 110

PALETTE = (
    *((BLUE, "o", "-"), (ORANGE, "s", "--"), (GREEN, "D", "-."), (PURPLE, "^", "-")),
    *((BLACK, "v", "--"), (SKY, "P", "-"), (AMBER, "X", "-."), (GREY, "x", ":")),
)
"""Colours that all common colour vision tells apart; markers and dashes for those who see none."""

RATIO_SPAN = 4.0
"""Ratios from 1/4 to 4 have colours of their own."""

DARK = 0.6
"""Share of a colour scale, from its light middle, beyond which print on it is white."""

WIDTH, HEIGHT, CELL = 4.4, 3.1, 0.5
"""Inches: a panel, a cell of a heat map."""


def panels(
    count: int, columns: int, size: tuple[float, float] = (WIDTH, HEIGHT), **shared: Any
) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels in a grid, each of a size in inches.

    `shared`: `sharex`, `sharey` as of `Figure.subplots`.
    """
    rows = -(-count // columns)
    figure = new_figure(columns * size[0] + 0.6, rows * size[1] + 0.6)
    axes = figure.subplots(rows, columns, squeeze=False, **shared).ravel()
    for one in axes[count:]:
        one.set_axis_off()
    return figure, list(axes[:count])


def draw(
    axes: Axes,
    x: Any,
    y: Any,
    place: int,
    label: str = "",
    *,
    joined: bool = True,
    low: Sequence[float] = (),
    high: Sequence[float] = (),
) -> None:
    """Points in the look of a place of the palette, joined or not, with intervals of y."""
    color, marker, dash = PALETTE[place % len(PALETTE)]
    look: Any = {"color": color, "marker": marker, "markersize": 5, "linewidth": 1.5}
    axes.plot(x, y, linestyle=dash if joined else "none", label=label, **look)
    if len(low) > 1:
        axes.fill_between(x, low, high, color=color, alpha=0.12, linewidth=0)
    elif len(low):
        axes.vlines(x, low, high, color=color, linewidth=1.3)


def dress(axes: Axes, x: str, y: str, title: str = "", log: str = "") -> None:
    """Title, labels with units at the outer panels alone, scales and a grid."""
    axes.set_title(title, loc="left", fontsize=10)
    place = axes.get_subplotspec()
    assert place is not None
    alike_x, alike_y = axes.get_shared_x_axes(), axes.get_shared_y_axes()
    axes.set_xlabel(x if place.is_last_row() or len(alike_x.get_siblings(axes)) == 1 else "")
    axes.set_ylabel(y if place.is_first_col() or len(alike_y.get_siblings(axes)) == 1 else "")
    axes.set(**{f"{letter}scale": "log" for letter in log})
    for letter, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        if letter in log:
            _plain_ticks(axis)
    axes.grid(visible=True, color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def mark(axes: Axes, value: float, text: str = "", axis: str = "y") -> None:
    """A line across a panel at a value of an axis."""
    along_x = axis == "y"
    line = axes.axhline if along_x else axes.axvline
    line(value, color="0.4", linewidth=1, linestyle=(0, (1, 3)))
    axes.text(
        *((0.995, value) if along_x else (value, 0.995)),
        text,
        transform=axes.get_yaxis_transform() if along_x else axes.get_xaxis_transform(),
        ha="right",
        va="bottom" if along_x else "top",
        rotation=0 if along_x else 90,
        fontsize=8,
        color="0.35",
    )


def png(figure: Figure) -> bytes:
    """The figure, with a legend of all labels below it where there are several."""
    handles: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if len(handles) > 1:
        each = max(2.2, 0.7 + 0.08 * max(map(len, handles)))  # inches of the longest label
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside lower center",
            ncols=min(len(handles), max(2, int((figure.get_figwidth() - 0.6) / each))),
            frameon=False,
        )
    return as_png(figure, DPI)


def dots(
    rows: Sequence[Row], labels: Mapping[str, str], metrics: Sequence[str], least: float = 0.0
) -> bytes:
    """Rows with their intervals: a panel a metric, a line a name, a colour a solver, by labels.

    The paper's figures are shown beside them; what is below `least` stands at it.
    """
    shown = [row for row in rows if row.scenes]
    names = list(dict.fromkeys(row.name for row in shown))
    size = (2.8, 0.8 + 0.15 * len(labels) * len(names))
    figure, grid = panels(len(metrics), len(metrics), size, sharey="all")
    for axes, metric in zip(grid, metrics, strict=True):
        for look, (solver, label) in enumerate(labels.items()):
            of = [row for row in shown if row.solver == solver]
            mean, low, high = (
                [max(row.metrics[f"{metric}{end}"] or np.nan, least) for row in of]
                for end in ("", "_low", "_high")
            )
            shift = 0.7 * ((look + 0.5) / (len(labels) + 1) - 0.5)
            y = [names.index(row.name) + shift for row in of]
            draw(axes, mean, y, look, label, joined=False)
            axes.hlines(y, low, high, color=PALETTE[look][0], linewidth=1.3)
        papers = {row.name: row.paper[metric] for row in shown if row.paper and metric in row.paper}
        y = [names.index(name) + 0.35 - 0.35 / (len(labels) + 1) for name in papers]
        draw(axes, list(papers.values()), y, 7, "the paper's number (other scenes)", joined=False)
        dress(axes, f"{metric} RMSE", "", log="x")
        axes.grid(visible=False, axis="y")
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        for border in range(1, len(names)):
            axes.axhline(border - 0.5, color="#dddddd", linewidth=0.8)
    return png(figure)


def heat_map(axes: Axes, ratios: Any, columns: Sequence[str], rows: Sequence[str]) -> None:
    """Ratios (rows, columns) as colours from 1/4 to 4 with the number in each cell."""
    values = np.asarray(ratios, dtype=np.float64)
    with np.errstate(divide="ignore"):  # a ratio of 0 is darkest
        colors = np.log2(values)
    most = np.log2(RATIO_SPAN)
    image = axes.imshow(colors, "PuOr_r", vmin=-most, vmax=most, aspect="auto")
    axes.set_xticks(range(len(columns)), columns)
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0)
    for (row, column), value in np.ndenumerate(values):
        dark = abs(colors[row, column]) > DARK * most
        axes.text(
            column,
            row,
            f"{value:.2f}" if value < 9.995 else f"{value:.0f}",
            ha="center",
            va="center",
            fontsize=7.5,
            color="white" if dark else "black",
        )
    assert axes.figure is not None
    bar = axes.figure.colorbar(image, ax=axes, extend="both")
    bar.set_label("ratio")
    bar.set_ticks([-2.0, -1.0, 0.0, 1.0, 2.0], labels=["¼", "½", "1", "2", "4"])


def _plain_ticks(axis: Axis) -> None:
    """Where a logarithmic axis spans little: ticks at 1, 2 and 5, as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = sorted(axis.get_view_interval())
    if not low > 0 or high > 1e4 * low:
        return
    axis.set_major_locator(
        LogLocator(subs=(1,) if high > 50 * low else (1, 2, 5) if high > 5 * low else (1, 2, 3, 5))
    )
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
