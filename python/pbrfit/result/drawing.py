"""Plots: what all of them share, and that of a history."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from pbrfit.result.history import History

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by all common colour vision; and a grey.
BLACK, BLUE, SKY, GREEN = "#000000", "#0072B2", "#56B4E9", "#009E73"
ORANGE, AMBER, PURPLE = "#D55E00", "#E69F00", "#CC79A7"
GREY = "#777777"


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure; width and height in inches."""
    # Imported here: matplotlib is slow to start and needed for plots alone.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def as_png(figure: Figure, dpi: int) -> bytes:
    """Draw it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def as_svg(figure: Figure) -> str:
    """Draw it, with letters as outlines, so that it looks the same everywhere."""
    import matplotlib as mpl

    buffer = io.StringIO()
    # Without a date and with names that do not vary, the same figure is the same text.
    with mpl.rc_context({"svg.hashsalt": "pbrfit", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


# Marker shapes are for those who see no colours.
SERIES = {
    "recon_rmse": ("residual", BLACK, "o"),
    "albedo_rmse": ("albedo", ORANGE, "s"),
    "roughness_rmse": ("roughness", BLUE, "^"),
    "metallic_rmse": ("metallic", GREEN, "D"),
}
"""Name in the legend, colour and marker of each error, by column."""


def draw_history(history: History) -> Figure:
    """Draw errors against run time and against iterations, all axes from 0."""
    figure = new_figure(8, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, column, label in (
        (left, "elapsed_s", "run time [s]"),
        (right, "iteration", "iteration"),
    ):
        for name, (legend, color, marker) in SERIES.items():
            if name in history.columns:
                axes.plot(
                    history[column],
                    history[name],
                    color=color,
                    marker=marker,
                    markevery=0.1,
                    markersize=4,
                    label=legend,
                )
        axes.set_xlabel(label)
        axes.set_xlim(left=0)
        axes.grid(visible=True, which="major", alpha=0.3)
    right.xaxis.get_major_locator().set_params(integer=True)
    left.set_ylim(bottom=0)
    left.set_ylabel("RMSE")
    left.legend()
    return figure
