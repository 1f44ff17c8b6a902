"""The plot of the calibration, as PNG."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.drawing import AMBER, BLACK, BLUE, as_png, new_figure
from pbrfit_evaluation.uncertainty import WITHIN

Array = NDArray[np.float64]

DPI = 100
EDGES = np.linspace(0.5, 1.6, 111)
STYLES = ((BLUE, "-"), (AMBER, "--"), (BLACK, ":"))


def draw_ratios(groups: Sequence[tuple[str, Array]]) -> bytes:
    """Histograms of found / predicted (Q, 5), a panel a group, a line a parameter."""
    figure = new_figure(11, 3.4 * -(-len(groups) // 2))
    grid = figure.subplots(-(-len(groups) // 2), 2, squeeze=False, sharex=True)
    for axes in grid.flat[len(groups) :]:
        axes.set_axis_off()
    for axes, (title, ratios) in zip(grid.flat, groups, strict=False):
        axes.axvspan(1 - WITHIN, 1 + WITHIN, color="0.92", linewidth=0)
        axes.axvline(1, color="0.6", linewidth=0.8)
        for (name, values), (color, line) in zip(by_parameter(ratios), STYLES, strict=True):
            shares, _ = np.histogram(np.clip(values, EDGES[0], EDGES[-1]), EDGES)
            heights = 100 * shares / max(1, values.size)
            axes.stairs(heights, EDGES, color=color, linestyle=line, linewidth=1.5, label=name)
        axes.set(title=title, xlabel="found / predicted", ylabel="% of values", ylim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
    grid[0, 0].legend(frameon=False)
    return as_png(figure, DPI)


def by_parameter(values: Array) -> list[tuple[str, Array]]:
    """Those (Q, 5) of albedo (all channels together), roughness and metallic."""
    return [
        ("albedo", values[:, :3].ravel()),
        ("roughness", values[:, 3]),
        ("metallic", values[:, 4]),
    ]
