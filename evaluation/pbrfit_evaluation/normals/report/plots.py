"""The suite's plots, as PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pbrfit.result.drawing import AMBER, BLUE, GREEN, GREY, as_png, new_figure
from pbrfit.result.refinement import RefineNormals
from pbrfit_evaluation.normals import cost
from pbrfit_evaluation.normals.fits import REFINE
from pbrfit_evaluation.normals.report.verdicts import at, errors, refined_seconds
from pbrfit_evaluation.normals.rooms import MAPS_AND_RELIGHT, TRUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = Mapping[str, Any]
Found = Sequence[tuple[Any, Values]]

BAND = (10, 90)
"""Percentiles of scenes."""

DPI = 100

# Markers and dashes are for those who see no colours.
LOOKS: dict[RefineNormals, tuple[str, str, str]] = {
    "off": (AMBER, "s", "-"),
    "auto": (BLUE, "o", "-"),
    "on": (GREEN, "^", "--"),
}
LABELS: dict[RefineNormals, str] = {
    "off": "not refined",
    "auto": "refined where it is decided to (auto)",
    "on": "refined (on)",
}
"""Of the fits."""


def draw_errors(found: Found) -> bytes:
    """Error against θ: a row of panels a disturbance, a panel an error, a line a fit."""
    kinds = list(dict.fromkeys(task.disturbance for task, _ in found if task.disturbance != TRUE))
    columns = (*MAPS_AND_RELIGHT, "angle")
    figure = new_figure(2.9 * len(columns) + 0.6, 2.7 * len(kinds) + 0.6)
    grid = figure.subplots(len(kinds), len(columns), squeeze=False, sharex=True, sharey="col")
    of_true = at(found, TRUE)
    for row, kind in zip(grid, kinds, strict=True):
        angles = sorted({task.degrees for task, _ in found if task.disturbance == kind})
        # Turns of 0 degrees are the same whatever they are called.
        cases = ([(0.0, of_true)] if of_true else []) + [(d, at(found, kind, d)) for d in angles]
        for axes, column in zip(row, columns, strict=True):
            for refine, (color, marker, dash) in LOOKS.items():
                thetas = [theta for theta, _ in cases]
                values = [_values(of_case, refine, column) for _, of_case in cases]
                low, high = ([float(np.percentile(of_case, p)) for of_case in values] for p in BAND)
                axes.fill_between(thetas, low, high, color=color, alpha=0.15, linewidth=0)
                means = [float(np.mean(of_case)) for of_case in values]
                axes.plot(thetas, means, dash, color=color, marker=marker, markersize=4.5, lw=1.5)
            if of_true and column != "angle":
                floor = float(np.mean(_values(of_true, "off", column)))
                axes.axhline(floor, color=GREY, linewidth=1.2, linestyle=(0, (1, 2)))
            _tidy(axes)
        row[0].set_ylabel(f"{kind}", fontweight="bold")
    for axes, column in zip(grid[0], columns, strict=True):
        axes.set_ylim(0, None)  # of the whole column, and only now that all of it is drawn
        title = "mean angle of normals, degrees" if column == "angle" else f"{column}, RMSE"
        axes.set_title(title, fontsize=10.5)
    for axes in grid[-1]:
        axes.set_xlabel("θ of the disturbance, degrees")
    handles = [
        grid[0, 0].plot([], [], dash, color=color, marker=marker, label=LABELS[refine])[0]
        for refine, (color, marker, dash) in LOOKS.items()
    ]
    handles += grid[0, 0].plot(
        [], [], color=GREY, linestyle=(0, (1, 2)), label="true normals, not refined"
    )
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)
    return as_png(figure, DPI)


def _values(found: Found, refine: RefineNormals, column: str) -> list[float]:
    if column == "angle":
        return [float(values[refine]["angle"]["mean"]) for _, values in found]
    return list(errors(found, refine, column).values())


def draw_real(found: Found) -> bytes:
    """Mean angle before and after for every start: a panel a set."""
    names = list(dict.fromkeys(task.source.name for task, _ in found))
    starts = list(dict.fromkeys(task.in_words for task, _ in found))
    figure = new_figure(1.2 + 3.8 * len(names), 1.3 + 0.36 * len(starts))
    [panels] = figure.subplots(1, len(names), squeeze=False, sharey=True)
    for axes, name in zip(panels, names, strict=True):
        for task, values in found:
            if task.source.name != name:
                continue
            place = starts.index(task.in_words)
            for refine in REFINE:
                color, marker, _ = LOOKS[refine]
                mean = values[refine]["angle"]["mean"]
                shift = 0.12 * (REFINE.index(refine) - 1)
                axes.plot(mean, place + shift, marker, color=color, markersize=6)
        axes.set_title(name, fontsize=10.5)
        axes.set_xlabel("mean angle, degrees")
        axes.set_xlim(0, None)
        _tidy(axes)
    panels[0].set_yticks(range(len(starts)), starts)
    panels[0].set_ylim(len(starts) - 0.5, -0.5)
    handles = [
        panels[0].plot([], [], marker, color=color, label=LABELS[refine])[0]
        for refine, (color, marker, _) in LOOKS.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False)
    return as_png(figure, DPI)


def draw_cost(found: Found) -> bytes:
    """Seconds against pixels, both on logarithmic scales; bars of a factor of `cost.TIMES`."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    figure = new_figure(7.5, 4.6)
    axes = figure.subplots()
    looks = {"refined": (GREEN, "^", "--"), "declined": (BLUE, "o", "-")}
    labels = {
        "refined": ("wrong normals, refined (on)", "wrong normals, not refined"),
        "declined": ("true normals, auto", "true normals, not refined"),
    }
    for case, (color, marker, dash) in looks.items():
        of_case = sorted(
            (float(values["pixels"]), *cost.medians(values))
            for task, values in found
            if task.case == case
        )
        if not of_case:
            continue
        pixels, off, refined = (list(column) for column in zip(*of_case, strict=True))
        filled, empty = labels[case]
        axes.plot(pixels, refined, dash, color=color, marker=marker, label=filled)
        axes.plot(pixels, off, dash, color=color, marker=marker, mfc="white", label=empty)
        for at_pixels, before, after in of_case:
            axes.annotate(
                f"{after / before:.1f} ×",
                (at_pixels, max(before, after)),
                xytext=(0, 7),
                textcoords="offset points",
                ha="center",
                fontsize=8.5,
                color=color,
            )
    exponent = cost.exponent(*refined_seconds(found))
    if np.isfinite(exponent):
        axes.set_title(f"seconds of what is refined grow as pixels^{exponent:.2f}", fontsize=10)
    axes.set(xscale="log", yscale="log", xlabel="pixels", ylabel="seconds of a fit")
    axes.margins(0.08, 0.12)
    sides = {task.size: float(values["pixels"]) for task, values in found}
    axes.set_xticks(list(sides.values()), [f"{side}²" for side in sides])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _tidy(axes)
    axes.legend(frameon=False)
    return as_png(figure, DPI)


def _tidy(axes: Axes) -> None:
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
