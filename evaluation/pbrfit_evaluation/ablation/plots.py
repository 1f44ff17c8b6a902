"""The suite's plots, as PNG: what every configuration does to every error; varied weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.drawing import BLACK, BLUE, GREEN, ORANGE, PURPLE, as_png, new_figure
from pbrfit_evaluation.ablation.cases import TITLES, CaseName

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

SPAN = 4.0
"""Ratios beyond this and its inverse have the darkest colours."""

# Markers are for those who see no colours.
LOOKS: dict[CaseName, tuple[str, str]] = {
    "constant": (BLACK, "o"),
    "varying": (ORANGE, "s"),
    "shifted": (BLUE, "^"),
    "merged": (PURPLE, "D"),
    "none": (GREEN, "v"),
}
"""Of the cases in which weights are varied."""


def draw_ratios(
    ratios: Mapping[CaseName, Array], configurations: Sequence[str], metrics: Sequence[str]
) -> bytes:
    """Draw errors over those without priors, as colours and numbers.

    Parameters
    ----------
    ratios
        A table for each case: a row for each of `configurations`, a column for each of `metrics`.
    configurations, metrics
        What to call them.
    """
    figure = new_figure(1.9 + 0.42 * len(metrics) * len(ratios), 1.7 + 0.26 * len(configurations))
    panels = figure.subplots(1, len(ratios), sharey=True, squeeze=False)[0]
    for axes, (name, table) in zip(panels, ratios.items(), strict=True):
        # Blue and orange are told apart by all common colour vision.
        axes.imshow(
            np.log(table),
            cmap="PuOr_r",
            vmin=-np.log(SPAN),
            vmax=np.log(SPAN),
            aspect="auto",
        )
        for (row, column), ratio in np.ndenumerate(table):
            dark = abs(np.log(ratio)) > 0.6 * np.log(SPAN)
            axes.text(
                column,
                row,
                f"{ratio:.2f}" if ratio < 9.995 else f"{ratio:.0f}",
                ha="center",
                va="center",
                fontsize=6.5,
                color="white" if dark else "black",
            )
        axes.set_title(_folded(TITLES[name]), fontsize=9)
        axes.set_xticks(range(len(metrics)), metrics, rotation=60, ha="right", fontsize=8)
        axes.tick_params(length=0)
    panels[0].set_yticks(range(len(configurations)), configurations, fontsize=8)
    return as_png(figure, dpi=110)


def draw_curves(
    curves: Mapping[str, Mapping[CaseName, Mapping[str, tuple[Array, Array]]]],
) -> bytes:
    """Draw ratios over weights: a row of panels a prior, a panel an error, a line a case.

    Parameters
    ----------
    curves
        Prior, case, error: weights and ratios.
    """
    priors = list(curves)
    errors = list(next(iter(curves[priors[0]].values())))
    figure = new_figure(1.0 + 3.0 * len(errors), 1.0 + 2.6 * len(priors))
    panels = figure.subplots(len(priors), len(errors), sharey=True, squeeze=False)
    for row, prior in zip(panels, priors, strict=True):
        for axes, error in zip(row, errors, strict=True):
            for name, of in curves[prior].items():
                color, marker = LOOKS[name]
                weights, ratios = of[error]
                axes.plot(weights, ratios, color=color, marker=marker, markersize=4, lw=1.4)
            _finish(axes)
            axes.set_xlabel(f"weight of {prior}")
            axes.set_title(error, fontsize=10)
        row[0].set_ylabel("RMSE / without priors")
    handles = [
        panels[0, 0].plot([], [], color=LOOKS[name][0], marker=LOOKS[name][1], label=TITLES[name])[
            0
        ]
        for name in curves[priors[0]]
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return as_png(figure, dpi=100)


def _finish(axes: Axes) -> None:
    from matplotlib.ticker import FuncFormatter

    axes.set_xscale("log")
    axes.set_yscale("log", base=2)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.axhline(1.0, color="0.4", linewidth=1, linestyle=(0, (1, 3)))
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _folded(title: str) -> str:
    """On two lines, at the space nearest to the middle."""
    spaces = [i for i, letter in enumerate(title) if letter == " "]
    if not spaces:
        return title
    middle = min(spaces, key=lambda i: abs(i - len(title) / 2))
    return f"{title[:middle]}\n{title[middle + 1 :]}"
