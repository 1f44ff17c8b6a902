"""Errors of all sources as a plot."""

from __future__ import annotations

import io
from collections.abc import Mapping

import numpy as np

from pbrfit.evaluation.real.held_out import IN_WORDS, Explanation

# Okabe and Ito's colours, with markers for those who see none.
LOOKS: dict[Explanation, tuple[str, str]] = {
    "default": ("#000000", "o"),
    "paper": ("#0072B2", "s"),
    "lambertian": ("#009E73", "^"),
    "start": ("#E69F00", "D"),
    "constant": ("#CC79A7", "v"),
    "combination": ("#56B4E9", "x"),
}


def draw_errors(errors: Mapping[str, Mapping[Explanation, float]]) -> bytes:
    """PNG: relative error of held-out pictures by source and explanation."""
    # Imported here: matplotlib is slow to start and needed by nobody else.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 1.9 + 0.45 * len(errors)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    places = np.arange(len(errors))[::-1]
    for name, (color, marker) in LOOKS.items():
        axes.plot(
            [of[name] for of in errors.values()],
            places,
            color=color,
            marker=marker,
            linestyle="none",
            markersize=8,
            markerfacecolor="none" if marker != "x" else color,
            markeredgewidth=1.8,
            label=IN_WORDS[name],
        )
    axes.set_yticks(places, list(errors))
    axes.set_ylim(-0.6, len(errors) - 0.4)
    axes.set(xscale="log", xlabel="held-out pictures: RMSE / RMS radiance")
    axes.grid(color="0.9", linewidth=0.8, which="both")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    return buffer.getvalue()
