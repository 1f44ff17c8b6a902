"""Every plot of every suite, from `suite.Plot`: PNGs with one look."""

from __future__ import annotations

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
from pbrfit_evaluation.suite import HeatMap, Mark, Panel, Plot, Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

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

ROW, WIDTH, HEIGHT, CELL = 0.42, 4.4, 3.1, 0.5
"""Inches: a name on an axis, a panel, a cell of a heat map."""


def draw(plot: Plot) -> bytes:
    """Draw it as a PNG."""
    count = len(plot.panels)
    columns = max(1, min(plot.columns, count))
    rows = -(-count // columns)
    width, height = plot.size or _size(plot)
    figure = new_figure(columns * width + 0.6, rows * height + 0.6)
    grid = figure.subplots(
        rows, columns, squeeze=False, sharex=plot.share_x, sharey=plot.share_y
    ).ravel()
    for axes in grid[count:]:
        axes.set_axis_off()
    looks = _looks(plot)
    handles: dict[str, Any] = {}
    for axes, panel in zip(grid, plot.panels, strict=False):
        axes.set_title(panel.title, loc="left", fontsize=10)
        if isinstance(panel, HeatMap):
            _heat_map(axes, panel)
        else:
            _panel(axes, panel, looks, handles)
        if plot.share_x in ("none", "row") or axes in grid[max(0, count - columns) :]:
            axes.set_xlabel(panel.x)
        if plot.share_y in ("none", "col") or axes in grid[::columns]:
            axes.set_ylabel(panel.y)
    if len(handles) > 1:
        each = max(2.2, 0.7 + 0.08 * max(map(len, handles)))  # inches of the longest label
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside lower center",
            ncols=min(len(handles), max(2, int(columns * width / each))),
            frameon=False,
        )
    return as_png(figure, DPI)


def _size(plot: Plot) -> tuple[float, float]:
    first = plot.panels[0]
    if isinstance(first, HeatMap):
        return 1.6 + CELL * len(first.columns), 1.0 + 0.7 * CELL * len(first.rows)
    if first.kind == "dots":
        alike = max(1, len({one.label for one in first.series}))
        each = max(ROW, 0.14 * alike)
        return WIDTH, 0.8 + each * max(len(_names(p)) for p in plot.panels if isinstance(p, Panel))
    return WIDTH, HEIGHT


def _looks(plot: Plot) -> dict[str, tuple[str, str, Any]]:
    """Colour, marker and dash of each label."""
    looks: dict[str, tuple[str, str, Any]] = {}
    for panel in plot.panels:
        for series in panel.series if isinstance(panel, Panel) else ():
            place = len(looks) if series.look is None else series.look
            looks.setdefault(series.label, PALETTE[place % len(PALETTE)])
    return looks


def _names(panel: Panel) -> list[str]:
    """Of what dots stand for, in order."""
    return list(dict.fromkeys(str(name) for series in panel.series for name in series.y))


def _panel(
    axes: Axes,
    panel: Panel,
    looks: dict[str, tuple[str, str, Any]],
    handles: dict[str, Any],
) -> None:
    named = panel.kind == "dots"
    names = _names(panel)
    for mark in panel.marks:
        _mark(axes, mark)
    labels = list(dict.fromkeys(series.label for series in panel.series))
    for series in panel.series:
        color, marker, dash = looks[series.label]
        x = np.asarray(series.x, dtype=np.float64)
        if named:
            shift = 0.7 * ((labels.index(series.label) + 0.5) / len(labels) - 0.5)
            y = np.array([names.index(str(name)) + shift for name in series.y])
        else:
            y = np.asarray(series.y, dtype=np.float64)
        [handle] = axes.plot(
            x,
            y,
            color=color,
            marker=marker,
            markersize=5,
            linewidth=1.5,
            linestyle=dash if panel.kind == "lines" else "none",
        )
        _interval(axes, series, x, y, panel.kind, color)
        if series.label:
            handles.setdefault(series.label, handle)
    axes.set(**{f"{letter}scale": "log" for letter in panel.log})
    axes.set_xlim(*panel.x_range)
    if named:
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        for border in range(1, len(names)):
            axes.axhline(border - 0.5, color="#dddddd", linewidth=0.8)
    else:
        axes.set_ylim(*panel.y_range)
    for letter, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        if letter in panel.log:
            _plain_ticks(axis)
    axes.grid(visible=True, axis="x" if named else "both", color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _interval(axes: Axes, series: Series, x: Any, y: Any, kind: str, color: str) -> None:
    if not len(series.low):
        return
    if kind == "dots":
        axes.hlines(y, series.low, series.high, color=color, linewidth=1.3)
    elif len(x) > 1:
        axes.fill_between(x, series.low, series.high, color=color, alpha=0.12, linewidth=0)
    else:
        axes.vlines(x, series.low, series.high, color=color, linewidth=1.3)


def _mark(axes: Axes, mark: Mark) -> None:
    along_x = mark.axis == "y"
    line = axes.axhline if along_x else axes.axvline
    line(mark.value, color="0.4", linewidth=1, linestyle=(0, (1, 3)))
    if mark.text:
        place = (0.995, mark.value) if along_x else (mark.value, 0.995)
        axes.text(
            *place,
            mark.text,
            transform=axes.get_yaxis_transform() if along_x else axes.get_xaxis_transform(),
            ha="right",
            va="bottom" if along_x else "top",
            rotation=0 if along_x else 90,
            fontsize=8,
            color="0.35",
        )


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


def _heat_map(axes: Axes, panel: HeatMap) -> None:
    values = np.asarray(panel.values, dtype=np.float64)
    with np.errstate(divide="ignore"):  # a ratio of 0 is darkest
        colors = np.log2(values)
    most = np.log2(RATIO_SPAN)
    image = axes.imshow(colors, "PuOr_r", vmin=-most, vmax=most, aspect="auto")
    axes.set_xticks(range(len(panel.columns)), panel.columns)
    axes.set_yticks(range(len(panel.rows)), panel.rows)
    axes.tick_params(length=0)
    if max(map(len, panel.columns)) > 5:
        axes.tick_params(axis="x", labelrotation=60)
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
    if panel.scale and axes.figure is not None:
        bar = axes.figure.colorbar(image, ax=axes, extend="both")
        bar.set_label(panel.scale)
        bar.set_ticks([-2.0, -1.0, 0.0, 1.0, 2.0], labels=["¼", "½", "1", "2", "4"])
