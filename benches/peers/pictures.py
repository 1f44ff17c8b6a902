"""The outcome as pictures."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from peers.outcome import Outcome
from peers.roster import OURS
from peers.scaling import PICTURES, SIDE, Scaling

# Okabe and Ito's palette, told apart by all common kinds of colour vision.
OURS_COLOR = "#0072b2"
SECOND_COLOR = "#d55e00"
OTHERS_COLOR = "#b5b5b5"


def picture(outcome: Outcome) -> Figure:
    """Horizontal bars, the fastest on top."""
    settings = outcome.settings
    rows = [row for row in outcome.rows if row.times]
    figure = Figure(figsize=(8.5, 1.6 + 0.42 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    longest = max(
        max(times.median_ms, times.quartiles_ms[1])
        for row in rows
        for times in (row.times, row.installed.times)
        if times
    )
    for place, row in enumerate(rows):
        times, installed = row.times, row.installed.times
        assert times is not None
        color = OURS_COLOR if row.name == OURS else OTHERS_COLOR
        lower, upper = times.quartiles_ms
        spread = [[times.median_ms - lower], [upper - times.median_ms]]
        axes.barh(place, times.median_ms, xerr=spread, color=color, height=0.66, ecolor="black")
        end = upper
        if outcome.tuned and installed is not None:
            label = "as installed: glibc's memory allocation not tuned" if place == 0 else None
            axes.plot(
                installed.median_ms, place, "D", color="black", fillstyle="none", ms=5, label=label
            )
            end = max(end, installed.median_ms)
        ratio = outcome.ratio(row)
        words = f"{times.median_ms:.1f} ms"
        if row.name != OURS and ratio is not None:
            words += f", {ratio:.1f} × ours"
        axes.text(
            end + 0.025 * longest,
            place,
            words,
            va="center",
            weight="bold" if row.name == OURS else "normal",
        )
    axes.set_yticks(range(len(rows)), [row.name for row in rows])
    axes.invert_yaxis()
    axes.set_xlim(0, 1.3 * longest)
    axes.set_xlabel(
        f"time of one evaluation, ms (median of {settings.rounds} rounds, lines: quartiles)"
    )
    axes.set_title(
        f"Loss and gradient: {settings.size}² pixels, {settings.pictures} pictures, "
        f"{settings.threads} threads",
        loc="left",
    )
    axes.spines[["top", "right"]].set_visible(False)
    if outcome.tuned:
        figure.legend(loc="outside lower right", frameon=False)
    return figure


def scaling_picture(scaling: Scaling) -> Figure:
    """Time over samples, logarithmic, with the fit."""
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.add_subplot()
    by_size = [point for point in scaling.points if point.pictures == PICTURES]
    by_count = [point for point in scaling.points if point.side == SIDE]
    for points, label, marker, color, place in (
        (by_size, f"{PICTURES} pictures, size varies", "o", OURS_COLOR, (9, -11)),
        (by_count, f"{SIDE}² pixels, number of pictures varies", "s", SECOND_COLOR, (-7, 8)),
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
            axes.annotate(
                f"{point.side}²" if points is by_size else f"{point.pictures}",
                (point.pixels * point.pictures, point.median_ms),
                xytext=place,
                textcoords="offset points",
                ha="left" if place[0] > 0 else "right",
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
