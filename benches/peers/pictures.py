"""The outcome as pictures."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from peers.outcome import Outcome
from peers.roster import OURS
from peers.scaling import PICTURES, SIDE, Scaling

# Okabe and Ito's palette, told apart by all common kinds of colour vision.
OURS_COLOR = "#0072b2"
SECOND_COLOR = "#d55e00"
OURS_COLORS = (OURS_COLOR, "#99c7e0")
OTHERS_COLORS = ("#7f7f7f", "#cccccc")


def picture(outcome: Outcome) -> Figure:
    """Horizontal bars, the fastest on top; below each the one as installed, if it is another."""
    settings = outcome.settings
    rows = [row for row in outcome.rows if row.times]
    bars = 2 if outcome.tuned else 1
    height = 0.8 / bars
    figure = Figure(figsize=(8.5, 1.5 + 0.3 * bars * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    longest = 0.0
    for place, row in enumerate(rows):
        ours = row.name == OURS
        pairs = [
            (row.times, outcome.ratio(row)),
            (row.installed.times, outcome.ratio_installed(row)),
        ]
        for bar, (times, ratio) in enumerate(pairs[:bars]):
            if times is None:
                continue
            at = place + height * (bar - (bars - 1) / 2)
            lower, upper = times.quartiles_ms
            axes.barh(
                at,
                times.median_ms,
                height=height,
                xerr=[[times.median_ms - lower], [upper - times.median_ms]],
                color=(OURS_COLORS if ours else OTHERS_COLORS)[bar],
                error_kw={"lw": 1},
            )
            words = f"{times.median_ms:.1f} ms"
            if not ours and ratio is not None:
                words += f", {ratio:.1f} × ours"
            axes.annotate(
                words,
                (upper, at),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
                weight="bold" if ours else "normal",
            )
            longest = max(longest, upper)
    axes.set_yticks(range(len(rows)), [row.name for row in rows])
    axes.invert_yaxis()
    axes.set_xlim(0, 1.25 * longest)
    axes.set_xlabel(f"time of one evaluation, ms (median of {settings.rounds}, lines: quartiles)")
    axes.set_title(
        f"Loss and gradient: {settings.size}² pixels, {settings.pictures} pictures, "
        f"{settings.threads} threads",
        loc="left",
    )
    axes.spines[["top", "right"]].set_visible(False)
    if outcome.tuned:
        labels = ("freed memory kept", "memory allocation as installed")
        handles = [Patch(color=c, label=w) for c, w in zip(OTHERS_COLORS, labels, strict=True)]
        figure.legend(handles=handles, loc="outside lower right", ncols=2, frameon=False)
    return figure


def scaling_picture(scaling: Scaling) -> Figure:
    """Time over samples, logarithmic, with the fit."""
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.add_subplot()
    by_size = [point for point in scaling.points if point.pictures == PICTURES]
    by_count = [point for point in scaling.points if point.side == SIDE]
    for points, label, marker, color in (
        (by_size, f"{PICTURES} pictures, size varies", "o", OURS_COLOR),
        (by_count, f"{SIDE}² pixels, number of pictures varies", "s", SECOND_COLOR),
    ):
        points.sort(key=lambda point: point.pixels * point.pictures)
        first, last = points[0], points[-1]
        axes.plot(
            [point.pixels * point.pictures for point in points],
            [point.median_ms for point in points],
            marker,
            color=color,
            label=label,
            fillstyle="none",
            ms=8,
        )
        between = np.linspace(0, 1, 100)
        pixels = first.pixels * (last.pixels / first.pixels) ** between
        pictures = first.pictures * (last.pictures / first.pictures) ** between
        axes.plot(
            pixels * pictures,
            [scaling.fitted_ms(p, n) for p, n in zip(pixels, pictures, strict=True)],
            color=color,
            lw=1,
        )
        for point in points:
            above = points is by_count and point.pictures <= PICTURES  # of both lines
            axes.annotate(
                f"{point.side}²" if points is by_size else f"{point.pictures}",
                (point.pixels * point.pictures, point.median_ms),
                xytext=(-7, 8) if above else (9, -11),
                textcoords="offset points",
                ha="right" if above else "left",
                fontsize=9,
                color=color,
            )
    axes.plot([], [], color="black", lw=1, label="fit a · P + b · P · N")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="pixels P × pictures N",
        ylabel=f"time of one evaluation, ms (median of {scaling.rounds} rounds)",
    )
    axes.set_xlim(right=1.9 * axes.get_xlim()[1])  # room for the last label
    axes.set_title(
        f"a = {scaling.per_pixel_ns:.3g} ns, b = {scaling.per_sample_ns:.3g} ns, "
        f"{scaling.threads} threads; farthest point {scaling.deviation(scaling.worst):+.0%}",
        loc="left",
        fontsize=11,
    )
    axes.grid(which="major", color="#dddddd", lw=0.6)
    axes.legend(frameon=False)
    return figure
