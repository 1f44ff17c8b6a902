"""The suite's plots, as PNG."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pbrfit.result.drawing import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, as_png, new_figure
from pbrfit_evaluation.stability.accumulation import EQUAL_TERMS_BOUND, Accumulation
from pbrfit_evaluation.stability.bands import RULES, BandErrors
from pbrfit_evaluation.stability.branches import BranchPoints
from pbrfit_evaluation.stability.cancellation import Cancellation
from pbrfit_evaluation.stability.checks import (
    BAND_BOUND,
    BLOCK_BOUND,
    ENTRY_BOUND,
    LOSS_BOUND,
    SLOPE_BOUND,
    Array,
)
from pbrfit_evaluation.stability.kernel import QUANTITIES, KernelErrors
from pbrfit_evaluation.stability.tiny import BOUNDED, TinyNumbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 130
NOTHING = 1e-18
"""Where an error of 0 is drawn on a logarithmic axis."""


def _grid(axes: Axes) -> None:
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def draw_bands(bands: BandErrors) -> bytes:
    """Error of band weights and slopes over r, by rule."""
    figure = new_figure(11, 6.4)
    r = bands.r
    panels = (
        ("roughness r", r, (r >= 1e-90) & (r <= 0.1), "log"),
        ("roughness r", r, np.ones_like(r, dtype=bool), "linear"),
        ("1 − r", 1 - r, (r < 1) & (r > 0.9), "log"),
    )
    axes = figure.subplots(2, 3, sharey="row")
    styles = dict(zip(RULES, ((BLUE, "-"), (ORANGE, "-"), (PURPLE, "-")), strict=True))
    rows = (
        ("error of h", bands.value, BAND_BOUND, 1e9),
        ("error of dh/dr", bands.slope, SLOPE_BOUND, 1e13),
    )
    for row, (name, errors, bound, top) in zip(axes, rows, strict=True):
        for column, (label, x, used, scale) in enumerate(panels):
            ax = row[column]
            for i, rule in enumerate(reversed(RULES)):
                color, line = styles[rule]
                at, worst, failed = _envelope(x[used], errors[rule][used], scale == "log")
                ax.plot(at, np.maximum(worst, NOTHING), color=color, linestyle=line, linewidth=1.5)
                bar = np.where(failed, top * 10.0 ** (-2 * i), np.nan)
                ax.plot(at, bar, color=color, linewidth=4, solid_capstyle="butt")
            ax.axhline(bound, color=BLACK, linestyle="--", linewidth=1)
            ax.set(xscale=scale, yscale="log", ylim=(NOTHING, 30 * top), xlabel=label)
            if column == 2:
                ax.invert_xaxis()
            _grid(ax)
        row[0].set_ylabel(name)
    handles = [
        axes[0, 1].plot([], [], color=styles[rule][0], linewidth=2, label=rule)[0] for rule in RULES
    ]
    handles.append(axes[0, 1].plot([], [], color=BLACK, linestyle="--", label="bound")[0])
    handles.append(
        axes[0, 1].plot([], [], color=GREY, linewidth=4, label="bar at the top: no number")[0]
    )
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    return as_png(figure, DPI)


def _envelope(x: Array, errors: Array, log: bool) -> tuple[Array, Array, Array]:
    """Largest error in each of 120 bins of x, and whether a value there is no number."""
    position = np.log10(x) if log else x
    edges = np.linspace(position.min(), position.max(), 121)
    bins = np.clip(np.searchsorted(edges, position, side="right") - 1, 0, 119)
    worst, failed = np.full(120, np.nan), np.zeros(120, dtype=bool)
    for i in np.unique(bins):
        inside = errors[bins == i]
        failed[i] = not np.isfinite(inside).all()
        if np.isfinite(inside).any():
            worst[i] = np.max(inside[np.isfinite(inside)])
    middle = (edges[1:] + edges[:-1]) / 2
    return (10.0**middle if log else middle), worst, failed


def draw_kernel(kernel: KernelErrors) -> bytes:
    """Errors of loss and gradient by kind of pixel."""
    figure = new_figure(11, 5.2)
    left, right = figure.subplots(1, 2, sharey=True)
    y = np.arange(len(kernel.kinds))
    looks = zip(
        QUANTITIES, (BLACK, ORANGE, BLUE, GREEN, PURPLE), ("o", "s", "^", "D", "v"), strict=True
    )
    for i, (name, color, marker) in enumerate(looks):
        for ax, figures in ((left, kernel.of_sum), (right, kernel.of_entry)):
            ax.plot(
                np.maximum(figures[name], 1e-10),
                y + 0.12 * (i - 2),
                linestyle="none",
                color=color,
                marker=marker,
                markersize=5,
                label=name if ax is left else None,
            )
    left.axvline(BLOCK_BOUND, color=BLACK, linestyle="--", linewidth=1, label="bound")
    right.axvline(ENTRY_BOUND, color=BLACK, linestyle="--", linewidth=1)
    left.set_yticks(y, kernel.kinds)
    left.invert_yaxis()
    for ax, title in (
        (left, "error / loss, error / norm of block"),
        (right, "worst entry: error / natural scale"),
    ):
        ax.set(xscale="log", xlim=(1e-9, 5e-6), xlabel=title)
        _grid(ax)
    figure.legend(loc="outside upper center", ncols=6, frameon=False)
    return as_png(figure, DPI)


def draw_jumps(branches: BranchPoints) -> bytes:
    """Jumps at branch points against the width of the step."""
    figure = new_figure(8.5, 4.6)
    ax = figure.subplots()
    looks = zip(
        branches.jumps.items(),
        (BLUE, GREEN, BLACK, ORANGE, PURPLE, GREY),
        ("o", "s", "^", "D", "v", "x"),
        strict=True,
    )
    for (name, jumps), color, marker in looks:
        ax.plot(
            branches.steps,
            np.maximum(jumps, 1e-17),
            color=color,
            marker=marker,
            markersize=5,
            linewidth=1.2,
            label=name,
        )
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="half the width of the step (in r; in n·v)",
        ylabel="unexplained change",
        ylim=(5e-18, 1),
    )
    _grid(ax)
    ax.legend(frameon=False, loc="upper left")
    return as_png(figure, DPI)


def draw_noise(branches: BranchPoints) -> bytes:
    """Float32 noise while pixels cross branch points."""
    figure = new_figure(11, 3.4)
    axes = figure.subplots(1, 4, sharey=True)
    for ax, scan in zip(axes, branches.scans, strict=True):
        offset = 1e6 * scan.offset
        ax.axvline(0, color=GREY, linestyle=":", linewidth=1)
        ax.plot(offset, 1e8 * scan.loss, color=BLACK, linewidth=1.3)
        ax.plot(offset, 1e8 * scan.gradient, color=ORANGE, linewidth=1.3, linestyle="--")
        ax.set_title(scan.branch, fontsize=11)
        ax.set_xlabel("offset / 10⁻⁶")
        _grid(ax)
    sizes = np.abs([[scan.loss, scan.gradient] for scan in branches.scans])
    span = 1.2e8 * float(np.max(sizes, where=np.isfinite(sizes), initial=1e-9))
    axes[0].set_ylim(-span, span)
    axes[0].set_ylabel("float32 − float64\n(relative, in 10⁻⁸)")
    handles = [
        axes[0].plot([], [], color=BLACK, label="loss")[0],
        axes[0].plot([], [], color=ORANGE, linestyle="--", label="slope by roughness")[0],
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)
    return as_png(figure, DPI)


def draw_cancellation(cancellation: Cancellation) -> bytes:
    """Reported residual, and error of the gradient, against the true residual."""
    figure = new_figure(11, 4.4)
    left, right = figure.subplots(1, 2)
    span = np.array([1e-8, 1.0])
    left.plot(span, span, color=GREY, linewidth=1, linestyle="--", label="exact")
    forms = zip(cancellation.residual, (BLUE, ORANGE), ("o", "s"), strict=True)
    for form, color, marker in forms:
        true = cancellation.residual[form]
        left.plot(
            true,
            cancellation.reported[form],
            color=color,
            marker=marker,
            markersize=5,
            linewidth=1.2,
            label=f"residuals of {form}",
        )
    left.set(
        xscale="log",
        yscale="log",
        xlabel="true residual, RMS over the signal's RMS",
        ylabel="reported residual",
        xlim=(1e-8, 0.3),
        ylim=(1e-8, 0.3),
    )
    looks = zip(
        cancellation.gradient_error.items(),
        (BLUE, BLUE, ORANGE, ORANGE),
        ("o", "^", "s", "D"),
        ("-", "--", "-", "--"),
        strict=True,
    )
    for (name, errors), color, marker, line in looks:
        form = name.partition(", ")[2]
        right.plot(
            cancellation.residual[form],
            errors,
            color=color,
            marker=marker,
            markersize=5,
            linewidth=1.2,
            linestyle=line,
            label=name,
        )
    right.axhline(1.0, color=GREY, linewidth=1, linestyle=":")
    right.set(
        xscale="log",
        yscale="log",
        xlabel="true residual, RMS over the signal's RMS",
        ylabel="error of the gradient / its norm",
        xlim=(1e-8, 0.3),
        ylim=(1e-7, 1e3),
    )
    for ax in (left, right):
        _grid(ax)
        ax.legend(frameon=False)
    return as_png(figure, DPI)


def draw_accumulation(accumulation: Accumulation) -> bytes:
    """Errors of loss and light gradient against the number of samples."""
    figure = new_figure(11, 4.4)
    left, right = figure.subplots(1, 2, sharey=True)
    looks = dict(
        zip(
            accumulation.loss,
            ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^")),
            strict=True,
        )
    )
    for ax, figures, line, size in (
        (left, accumulation.loss, "-", 6),
        (left, accumulation.naive, ":", 0),
        (right, accumulation.lights, "-", 6),
    ):
        for form, errors in figures.items():
            color, marker = looks[form]
            ax.plot(
                accumulation.samples,
                np.maximum(errors, 1e-10),
                color=color,
                marker=marker if size else None,
                markersize=size,
                linestyle=line,
                linewidth=1.4,
                label=form if line == "-" else f"running float32 sum, {form}",
            )
    for ax, bounds in (
        (left, (LOSS_BOUND, ENTRY_BOUND, EQUAL_TERMS_BOUND)),
        (right, (None, ENTRY_BOUND, EQUAL_TERMS_BOUND)),
    ):
        for bound, (color, _) in zip(bounds, looks.values(), strict=True):
            if bound is not None:
                ax.axhline(bound, color=color, linestyle="--", linewidth=1)
        ax.plot([], [], color=BLACK, linestyle="--", linewidth=1, label="bounds, by colour")
    left.set(ylabel="relative error of the loss")
    right.set(ylabel="worst entry: error / sum of sizes")
    right.tick_params(labelleft=True)
    for ax in (left, right):
        ax.set(xscale="log", yscale="log", xlabel="samples", ylim=(1e-10, 3))
        ax.set_xlim(accumulation.samples[0] / 2, 2 * accumulation.samples[-1])
        _grid(ax)
        ax.legend(frameon=False, fontsize=8.5, loc="upper left")
    return as_png(figure, DPI)


def draw_exposures(tiny: TinyNumbers) -> bytes:
    """Error of the loss over exposure."""
    figure = new_figure(8.5, 3.8)
    ax = figure.subplots()
    bounded = tiny.exposure[BOUNDED]
    ax.axvspan(bounded[0], bounded[-1], color="0.93", linewidth=0)
    shown = np.isfinite(tiny.loss_error)
    ax.plot(
        tiny.exposure[shown],
        np.maximum(tiny.loss_error[shown], 1e-12),
        color=BLUE,
        marker="o",
        markersize=4,
        linewidth=1.2,
    )
    ax.axhline(LOSS_BOUND, color=BLACK, linestyle="--", linewidth=1, label="bound")
    if not shown.all():
        first = tiny.exposure[~shown][0]
        ax.axvspan(first, tiny.exposure[-1], color=ORANGE, alpha=0.25, linewidth=0, label="refused")
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="exposure: factor on lights and pictures",
        ylabel="relative error of the loss",
        xlim=(tiny.exposure[0], tiny.exposure[-1]),
        ylim=(1e-11, 10),
    )
    _grid(ax)
    ax.legend(frameon=False)
    return as_png(figure, DPI)
