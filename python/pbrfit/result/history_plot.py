"""Plot of a history: error against run time and iteration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pbrfit.result.drawing import BLACK, BLUE, GREEN, ORANGE, new_figure
from pbrfit.result.history import History

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Marker shapes are for those who see no colours.
SERIES = {
    "recon_rmse": ("reconstruction", BLACK, "o"),
    "albedo_rmse": ("albedo", ORANGE, "s"),
    "roughness_rmse": ("roughness", BLUE, "^"),
    "metallic_rmse": ("metallic", GREEN, "D"),
}
"""Name in the legend, colour and marker of each error, by column."""


def draw_history(history: History, title: str = "") -> Figure:
    """Draw errors against run time and against iterations, all axes logarithmic."""
    figure = new_figure(8, 4.5 if title else 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, column, label in (
        (left, "elapsed_s", "run time [s]"),
        (right, "iteration", "iteration"),
    ):
        for name, (legend, color, marker) in SERIES.items():
            if name in history.columns:
                axes.loglog(
                    np.maximum(history[column], 1e-3 if column == "elapsed_s" else 0.5),
                    history[name],
                    color=color,
                    marker=marker,
                    markevery=0.1,
                    markersize=4,
                    label=legend,
                )
        axes.set_xlabel(label)
        axes.grid(visible=True, which="major", alpha=0.3)
    left.set_ylabel("RMSE")
    left.legend()
    if title:
        figure.suptitle(title)
    return figure
