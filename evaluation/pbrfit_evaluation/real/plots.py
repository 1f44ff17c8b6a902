"""Errors of all sources as a plot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pbrfit.result.drawing import AMBER, BLACK, BLUE, GREEN, GREY, PURPLE, SKY, as_png, new_figure
from pbrfit_evaluation.real.held_out import IN_WORDS, Explanation

# Markers are for those who see no colours.
LOOKS: dict[Explanation, tuple[str, str]] = {
    "default": (BLACK, "o"),
    "plain": (GREY, "P"),
    "paper": (BLUE, "s"),
    "lambertian": (GREEN, "^"),
    "start": (AMBER, "D"),
    "constant": (PURPLE, "v"),
    "combination": (SKY, "x"),
}


def draw_errors(errors: Mapping[str, Mapping[Explanation, float]]) -> bytes:
    """PNG: relative error of held-out pictures by source and explanation."""
    figure = new_figure(9, 1.9 + 0.45 * len(errors))
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
    return as_png(figure, dpi=130)
