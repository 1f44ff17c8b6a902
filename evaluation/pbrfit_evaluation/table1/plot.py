"""Table 1 as a plot: a panel a column, a line a setup, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from pbrfit.result.drawing import AMBER, BLACK, BLUE, GREEN, GREY, ORANGE, SKY, as_png, new_figure
from pbrfit_evaluation.recipes import IN_WORDS, Recipe
from pbrfit_evaluation.table1.rows import COLUMNS
from pbrfit_evaluation.tables import Mean

if TYPE_CHECKING:
    from pbrfit_evaluation.table1.report import Outcome

# Shapes are for those who see no colours.
_LOOKS: dict[Recipe, tuple[str, str]] = {
    "plain": (BLUE, "o"),
    "default": (GREEN, "D"),
    "paper": (ORANGE, "s"),
    "paper-priors": (AMBER, "P"),
    "constant": (GREY, "^"),
    "start": (SKY, "v"),
}
_PAPER = (BLACK, "x")


def draw(found: Sequence[Outcome], mean: Callable[[Outcome, Recipe, str], Mean]) -> bytes:
    """Draw the paper's columns as a PNG."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    shown = [outcome for outcome in found if outcome.finished]
    figure = new_figure(13, 1.6 + 0.7 * len(shown))
    panels = figure.subplots(1, len(COLUMNS), sharey=True)
    for axes, metric in zip(panels, COLUMNS, strict=True):
        for place, outcome in enumerate(shown):
            for step, recipe in enumerate(outcome.row.recipes):
                m = mean(outcome, recipe, metric)
                if not m.count:
                    continue
                color, marker = _LOOKS[recipe]
                y = place + 0.16 * (step - (len(outcome.row.recipes) - 1) / 2)
                if m.count > 1:
                    axes.plot([m.low, m.high], [y, y], color=color, linewidth=1.5)
                axes.plot(m.mean, y, marker, color=color, markersize=5)
            if metric in outcome.row.paper:
                axes.plot(outcome.row.paper[metric], place, _PAPER[1], color=_PAPER[0])
        for border in range(1, len(shown)):
            axes.axhline(border - 0.5, color="#dddddd", linewidth=0.8)
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        steps = (1,) if high > 50 * low else (1, 2, 5)
        axes.xaxis.set_major_locator(LogLocator(subs=steps))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlabel(f"{metric} RMSE")
        axes.grid(visible=True, axis="x", which="major", alpha=0.3)
    panels[0].set_yticks(range(len(shown)), [outcome.name for outcome in shown])
    panels[0].set_ylim(len(shown) - 0.5, -0.5)
    handles = [
        panels[0].plot([], [], marker, color=color, label=IN_WORDS[recipe])[0]
        for recipe, (color, marker) in _LOOKS.items()
    ]
    handles += panels[0].plot(
        [], [], _PAPER[1], color=_PAPER[0], label="the paper's number (other scenes)"
    )
    figure.legend(
        handles=handles, loc="outside lower center", ncols=-(-len(handles) // 2), frameon=False
    )
    return as_png(figure, dpi=110)
