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
        times.median_ms for row in rows for times in (row.times, row.installed.times) if times
    )
    for place, row in enumerate(rows):
        times, installed = row.times, row.installed.times
        assert times is not None
        color = OURS_COLOR if row.name == OURS else OTHERS_COLOR
        axes.barh(place, times.median_ms, color=color, height=0.66)
        end = times.median_ms
        if outcome.tuned and installed is not None:
            label = "with the system's memory allocation as installed" if place == 0 else None
            axes.plot(
                installed.median_ms, place, "D", color="black", fillstyle="none", ms=5, label=label
            )
            end = max(end, installed.median_ms)
        ratio = outcome.ratio(row)
        words = f"{times.median_ms:.1f} ms"
        if row.name != OURS and ratio is not None:
            words += f", {ratio:.1f} × ours"
        axes.text(
            end + 0.015 * longest,
            place,
            words,
            va="center",
            weight="bold" if row.name == OURS else "normal",
        )
    axes.set_yticks(range(len(rows)), [row.name for row in rows])
    axes.invert_yaxis()
    axes.set_xlim(0, 1.3 * longest)
    axes.set_xlabel(f"time of one evaluation, ms (median of {settings.rounds} rounds)")
    axes.set_title(
        f"Loss and gradient: {settings.size}² pixels, {settings.pictures} pictures, "
        f"{settings.threads} threads",
        loc="left",
    )
    axes.spines[["top", "right"]].set_visible(False)
    if outcome.tuned:
        axes.legend(loc="lower right", frameon=False)
    return figure


def scaling_picture(scaling: Scaling) -> Figure:
    """Time over samples, logarithmic, with the fit."""
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.add_subplot()
    series = (
        (
            [point for point in scaling.points if point.pictures == PICTURES],
            f"{PICTURES} pictures, size varies",
            "o",
            OURS_COLOR,
        ),
        (
            [point for point in scaling.points if point.side == SIDE],
            f"{SIDE}² pixels, number of pictures varies",
            "s",
            SECOND_COLOR,
        ),
    )
    for points, label, marker, color in series:
        points = sorted(points, key=lambda point: point.pixels * point.pictures)
        samples = np.array([point.pixels * point.pictures for point in points])
        axes.plot(
            samples,
            [point.median_ms for point in points],
            marker,
            color=color,
            label=f"measured: {label}",
            fillstyle="none",
            ms=8,
        )
        ends = points[0], points[-1]
        between = np.linspace(0, 1, 100)
        pixels = ends[0].pixels * (ends[1].pixels / ends[0].pixels) ** between
        pictures = ends[0].pictures * (ends[1].pictures / ends[0].pictures) ** between
        axes.plot(
            pixels * pictures,
            [scaling.fitted_ms(p, n) for p, n in zip(pixels, pictures, strict=True)],
            color=color,
            lw=1,
            label="fit" if label == series[0][1] else None,
        )
        for point in points:
            words = f"{point.side}²" if points[0].side != points[-1].side else f"{point.pictures}"
            axes.annotate(
                words,
                (point.pixels * point.pictures, point.median_ms),
                xytext=(8, -12),
                textcoords="offset points",
                fontsize=8,
                color=color,
            )
    worst = scaling.worst
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="pixels × pictures",
        ylabel=f"time of one evaluation, ms (median of {scaling.rounds})",
    )
    axes.set_title(
        f"t = {scaling.per_pixel_ns:.1f} ns · P + {scaling.per_sample_ns:.2f} ns · P · N,  "
        f"{scaling.threads} threads;  farthest point {scaling.deviation(worst):+.0%}",
        loc="left",
        fontsize=11,
    )
    axes.grid(which="major", color="#dddddd", lw=0.6)
    axes.legend(frameon=False)
    return figure
