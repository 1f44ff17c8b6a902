"""Heat maps and curves of the gap, as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from pbrfit.result.drawing import BLACK, BLUE, GREEN, GREY, ORANGE, as_png, new_figure
from pbrfit_evaluation.gap import Array, Gap
from pbrfit_evaluation.gap.spheres import ALBEDOS, NOISE, SINGLE, Spheres

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

DPI = 100
COLORS = (BLUE, BLACK, ORANGE, GREEN)
MARKERS = ("o", "D", "v", "^")
LINES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")

RATIO_SPAN = 4.0
"""Ratios from 1/4 to 4 have colours of their own."""

CYCLES_COLORS = {"paper": BLUE, "principled": ORANGE, SINGLE: GREEN, NOISE: GREY}

DARK = 0.62
"""Share of the colour scale beyond which print on it is white."""


def title(gap: Gap, model: str, between: str = " / ") -> str:
    """Say what is compared with what."""
    return f"{model} model{between}{gap.reference.name} integral"


def draw_ratios(gap: Gap, model: str, material: int) -> bytes:
    """R_l of a model over the true one, by band."""
    ratio = gap.ratio(model)[material]
    figure = new_figure(13, 10.4)
    grid = figure.subplots(2, 2)
    for band, axes in enumerate(grid.flat):
        image = _ratio_map(axes, gap, ratio[..., band])
        axes.set_title(f"l = {band}" + (", directional albedo" if band == 0 else ""))
    _ratio_scale(figure, image, grid)
    figure.suptitle(f"{gap.materials[material].name}: response, {title(gap, model)}")
    return as_png(figure, DPI)


def draw_distances(gap: Gap, model: str, material: int) -> bytes:
    """Response of the difference, by band."""
    distance = gap.distance(model)[material]
    figure = new_figure(13, 10.4)
    grid = figure.subplots(2, 2)
    for band, axes in enumerate(grid.flat):
        image = _map(axes, gap, distance[..., band], "cividis_r", 0.0, 1.0, cut=DARK)
        axes.set_title(f"l = {band}")
    bar = figure.colorbar(image, ax=grid, shrink=0.6, extend="max")
    bar.set_label("size of the difference; a mirror's response is 1")
    figure.suptitle(f"{gap.materials[material].name}: {title(gap, model, ' less ')}")
    return as_png(figure, DPI)


def draw_albedos(gap: Gap, model: str) -> bytes:
    """R_0 of a model over the true one, by material."""
    figure = new_figure(13, 5.4 * -(-len(gap.materials) // 2))
    grid = figure.subplots(-(-len(gap.materials) // 2), 2, squeeze=False)
    ratio = gap.ratio(model)
    for i, axes in enumerate(grid.flat):
        if i >= len(gap.materials):
            axes.set_axis_off()
            continue
        image = _ratio_map(axes, gap, ratio[i, ..., 0])
        axes.set_title(gap.materials[i].name)
    _ratio_scale(figure, image, grid)
    figure.suptitle(f"Light that comes back under even light, {title(gap, model)}")
    return as_png(figure, DPI)


def draw_spheres(gap: Gap) -> bytes:
    """Relative error of spheres under random lights over roughness, a panel for each material."""
    figure = new_figure(11, 3.4)
    panels = figure.subplots(1, len(gap.materials), sharey=True)
    for m, (axes, material) in enumerate(zip(panels, gap.materials, strict=True)):
        for i, model in enumerate(gap.models):
            axes.plot(
                gap.effort.r,
                gap.relative_rmse(model)[m],
                color=COLORS[i % len(COLORS)],
                marker=MARKERS[i % len(MARKERS)],
                linestyle=LINES[i % len(LINES)],
                markersize=4,
                linewidth=1.6,
                label=model,
            )
        axes.set(xlabel="roughness r", title=material.name, xlim=(0, 1.03), yscale="log")
        _tidy(axes)
    panels[0].set_ylabel("RMSE / RMS radiance")
    panels[0].legend(frameon=False)
    figure.suptitle(f"Spheres under random lights, against the {gap.reference.name} integral")
    return as_png(figure, DPI)


def draw_cycles(spheres: Spheres) -> bytes:
    """Errors on Cycles' spheres over roughness: a row a distribution, a column a substance."""
    from matplotlib.lines import Line2D

    figure = new_figure(10, 6.4)
    grid = figure.subplots(
        len(spheres.effort.distributions), len(spheres.effort.substances), sharex=True, sharey=True
    )
    for row, distribution in zip(grid, spheres.effort.distributions, strict=True):
        for axes, substance in zip(row, spheres.effort.substances, strict=True):
            for model, color in CYCLES_COLORS.items():
                errors = spheres.errors.get((distribution, substance.key, model))
                if errors is None:
                    continue
                for c in range(len(ALBEDOS)):
                    axes.plot(
                        spheres.effort.r,
                        errors[:, c],
                        color=color,
                        marker=MARKERS[c],
                        linestyle=LINES[c],
                        markersize=5,
                        linewidth=1.4,
                    )
            axes.set(title=f"{substance.name}, {distribution}", yscale="log")
            _tidy(axes)
    for axes in grid[-1]:
        axes.set_xlabel("roughness r")
    for axes in grid[:, 0]:
        axes.set_ylabel("RMSE / mean radiance")
    colors = [Line2D([], [], color=of) for of in CYCLES_COLORS.values()]
    figure.legend(colors, CYCLES_COLORS, loc="outside lower center", ncols=4, frameon=False)
    marked = [
        Line2D([], [], color=BLACK, marker=MARKERS[c], linestyle=LINES[c], markersize=5)
        for c in range(len(ALBEDOS))
    ]
    names = [f"albedo {albedo:g}" for albedo in ALBEDOS]
    grid[-1, 0].legend(marked, names, loc="center", frameon=False)
    figure.suptitle("Spheres by Cycles, no bounces, known lights and materials")
    return as_png(figure, DPI)


def _tidy(axes: Axes) -> None:
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _ratio_map(axes: Axes, gap: Gap, ratio: Array) -> AxesImage:
    span = np.log2(RATIO_SPAN)
    with np.errstate(divide="ignore"):  # a response of 0 has a ratio of 0: darkest
        colors = np.log2(ratio)
    return _map(axes, gap, colors, "PuOr_r", -span, span, cut=None, values=ratio)


def _ratio_scale(figure: Figure, image: AxesImage, grid: Sequence[Axes] | np.ndarray) -> None:
    ticks = (0.25, 0.5, 1.0, 2.0, 4.0)
    bar = figure.colorbar(image, ax=np.asarray(grid), shrink=0.6, extend="both")
    bar.set_ticks([float(np.log2(tick)) for tick in ticks], labels=["¼", "½", "1", "2", "4"])
    bar.set_label("ratio; orange: too bright, purple: too dark")


def _map(
    axes: Axes,
    gap: Gap,
    colors: Array,
    colormap: str,
    low: float,
    high: float,
    *,
    cut: float | None,
    values: Array | None = None,
) -> AxesImage:
    """One cell for each (r, n·v) with its value; n·v to the right, r upwards."""
    values = colors if values is None else values
    image = axes.imshow(colors, colormap, vmin=low, vmax=high, origin="lower", aspect="auto")
    axes.set_xticks(range(len(gap.effort.n_dot_v)), [f"{x:g}" for x in gap.effort.n_dot_v])
    axes.set_yticks(range(len(gap.effort.r)), [f"{x:g}" for x in gap.effort.r])
    axes.set(xlabel="n·v", ylabel="roughness r")
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            share = float(np.clip((colors[i, j] - low) / (high - low), 0, 1))
            dark = abs(2 * share - 1) > DARK if cut is None else share > cut
            axes.text(
                j,
                i,
                _short(value),
                ha="center",
                va="center",
                fontsize=8,
                color="white" if dark else "black",
            )
    return image


def _short(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"
