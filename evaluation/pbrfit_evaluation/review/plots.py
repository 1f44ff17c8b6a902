"""Rates as a plot, and what the damages look like."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pbrfit.io.color import encode_srgb
from pbrfit.result.drawing import AMBER, BLUE, as_png, new_figure
from pbrfit.result.sheet import Panel, sheet
from pbrfit.result.sheet import as_png as sheet_png
from pbrfit_evaluation.review import LEAST_CAUGHT, MOST_REFUSED, Rate
from pbrfit_evaluation.review.damage import KINDS, damaged
from pbrfit_evaluation.review.pictures import relights

EXAMPLE_SIZE = 256


def draw_rates(rates: Mapping[str, Rate]) -> bytes:
    """PNG: refused shares, those of damage and those of honest pictures in two colours."""
    shown = {name: rate for name, rate in rates.items() if rate.pictures}
    figure = new_figure(8, 1.2 + 0.4 * len(shown))
    axes = figure.subplots()
    for place, (name, rate) in zip(range(len(shown))[::-1], shown.items(), strict=True):
        color = AMBER if name.startswith("honest") else BLUE
        low, high = rate.interval()
        axes.barh(place, 100 * rate.share, height=0.6, color=color)
        axes.plot([100 * low, 100 * high], [place, place], color="black", linewidth=1.2)
        axes.text(101.5, place, f"{rate.refused} of {rate.pictures}", va="center", fontsize=9)
    for bound in (LEAST_CAUGHT, MOST_REFUSED):
        axes.axvline(100 * bound, color="black", linestyle="--", linewidth=0.8)
    axes.set_yticks(range(len(shown))[::-1], list(shown))
    axes.set(xlabel="refused by the review, %", xlim=(0, 100))
    axes.spines[["top", "right"]].set_visible(False)
    return as_png(figure, dpi=130)


def draw_examples(kind: str, seed: int) -> bytes:
    """PNG: an honest picture and its damages."""
    view = relights(kind, "own", seed, size=EXAMPLE_SIZE, count=2)
    rng = np.random.default_rng(seed)
    panels: list[Panel | None] = [
        Panel("photograph", encode_srgb(view.pictures[0].clip(0, 1))),
        Panel("honest relight", encode_srgb(view.pictures[1].clip(0, 1))),
    ]
    for damage in KINDS:
        changed, _ = damaged(view.pictures[1], damage, view.segments, rng)
        panels.append(Panel(damage, encode_srgb(changed.clip(0, 1))))
    return sheet_png(sheet([panels[:5], panels[5:]]))
