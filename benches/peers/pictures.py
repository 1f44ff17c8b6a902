"""The outcome as a picture."""

from __future__ import annotations

from matplotlib.figure import Figure

from peers.outcome import Outcome, names
from peers.roster import OURS

# Okabe and Ito's palette, told apart by all common kinds of colour vision.
OURS_COLOR = "#0072b2"
OTHERS_COLOR = "#7f7f7f"


def picture(outcome: Outcome) -> Figure:
    """Horizontal bars, a panel for each number of threads."""
    settings = outcome.settings
    shown = names([standing for standing in outcome.standings if standing.times])
    figure = Figure(figsize=(11, 1.4 + 0.34 * len(shown)), layout="constrained")
    panels = figure.subplots(1, len(settings.threads), sharey=True, squeeze=False)[0]
    for axes, threads in zip(panels, settings.threads, strict=True):
        longest = 0.0
        for place, name in enumerate(shown):
            standing = outcome.of(name, threads)
            if standing.times is None:
                continue
            ours = name == OURS
            median, (lower, upper) = standing.times.median_ms, standing.times.quartiles_ms
            axes.barh(
                place,
                median,
                height=0.7,
                xerr=[[median - lower], [upper - median]],
                color=OURS_COLOR if ours else OTHERS_COLOR,
                error_kw={"lw": 1},
            )
            ratio = outcome.ratio(standing)
            words = f"{median:.1f} ms"
            if not ours and ratio is not None:
                words += f", {ratio:.1f} × ours"
            axes.annotate(
                words,
                (upper, place),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
                weight="bold" if ours else "normal",
            )
            longest = max(longest, upper)
        axes.set_yticks(range(len(shown)), shown)
        axes.set_xlim(0, 1.45 * longest)
        axes.set_title(f"{threads} thread{'s' if threads > 1 else ''}", loc="left")
        axes.set_xlabel("time of one evaluation, ms")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].invert_yaxis()
    figure.suptitle(
        f"Loss and gradient: {settings.size}² pixels, {settings.pictures} pictures, medians and "
        f"quartiles of {settings.rounds} rounds",
        x=0.01,
        ha="left",
    )
    return figure
