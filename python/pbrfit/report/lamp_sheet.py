"""Drawings of lamps: the ball that showed them, and where they are."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pbrfit.display.tone import encoded
from pbrfit.result import metrics
from pbrfit.result.drawing import BLACK, BLUE, GREY, ORANGE, as_png, new_figure
from pbrfit.scene.ball import Ball
from pbrfit.values.arrays import Array, Floats, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELS_MAX = 40
"""Lamps that are labelled; of more every other, third ... one is."""

LABELS_ON_BALL_MAX = 16
"""Lamps that are labelled on their ball too."""

LONGEST_LABEL = 14
"""Letters of a picture's name beside its lamp."""


@dataclass(frozen=True, eq=False)
class ShownBalls:
    """Where lamps were found."""

    picture: Floats
    """(H, W, 3), linear Rec.709: the mean of all pictures."""
    balls: Sequence[Ball]
    highlights: Array
    """(K, B, 2): x and y of what each lamp makes on each ball, NaN where that is not seen."""
    what: str
    """What stands there: "highlights" or "where it faces the lamp"."""


def preview(names: Sequence[str], directions: Array, shown: ShownBalls | None) -> bytes:
    """PNG of lamps: on their balls, where there are some, and by direction.

    `names` are of the pictures that the lamps light, `directions` (K, 3) the unit vectors to them.
    Marks are told apart by their shape and their place, not by colour alone.
    """
    figure = new_figure(12 if shown is not None else 6.2, 6.2)
    shared = _shared(names)
    labels = [_short(name[len(shared) :]) for name in names]
    remark = f"labels: names of pictures without “{shared}”" if shared else ""
    if shown is None:
        axes = figure.subplots()
    else:
        whole, axes = figure.subplots(1, 2)
        _draw_balls(whole, labels, shown)
    draw_directions(axes, labels, directions)
    axes.set_xlabel(axes.get_xlabel() + f"\n{remark}" * bool(remark))
    return as_png(figure, 120)


def _shared(names: Sequence[str]) -> str:
    """What all names begin with, which says nothing; numbers are left whole."""
    if len(set(names)) < 2:
        return ""
    first, last = min(names), max(names)
    same = next((i for i, c in enumerate(first) if c != last[i]), len(first))
    return re.sub(r"[\d.+-]+$", "", first[:same])


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_LABEL else f"…{name[1 - LONGEST_LABEL :]}"


def _draw_balls(axes: Axes, labels: Sequence[str], shown: ShownBalls) -> None:
    """The picture around the balls, their circles and what the lamps make there."""
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    finite = np.nan_to_num(shown.picture, posinf=0.0, neginf=0.0)
    axes.imshow(encoded(finite / metrics.white_of(finite)), interpolation="nearest")
    for ball in shown.balls:
        place = (ball.x, ball.y)
        for color, width in ((BLACK, 3.0), (ORANGE, 1.5)):  # seen on light and on dark
            axes.add_patch(Circle(place, ball.radius, fill=False, color=color, linewidth=width))
        axes.plot(*place, "+", color=ORANGE, markersize=9)
    for b in range(len(shown.balls)):
        places = shown.highlights[:, b]
        axes.plot(*places.T, "o", mfc="none", mec=BLACK, mew=2.5, markersize=7)
        axes.plot(*places.T, "o", mfc="none", mec="white", mew=1.2, markersize=7)
    if len(shown.balls) == 1 and len(labels) <= LABELS_ON_BALL_MAX:
        for label, (x, y) in zip(labels, shown.highlights[:, 0], strict=True):
            if label and np.isfinite([x, y]).all():
                axes.annotate(
                    label,
                    (x, y),
                    (4, 4),
                    textcoords="offset points",
                    fontsize=7,
                    color="white",
                    path_effects=[withStroke(linewidth=1.8, foreground=BLACK)],
                    in_layout=False,
                )
    middle = np.array([[ball.x, ball.y] for ball in shown.balls])
    reach = 1.4 * max(ball.radius for ball in shown.balls)
    left, top = middle.min(axis=0) - reach
    right, bottom = middle.max(axis=0) + reach
    height, width = shown.picture.shape[:2]
    axes.set_xlim(max(left, -0.5), min(right, width - 0.5))
    axes.set_ylim(min(bottom, height - 0.5), max(top, -0.5))
    title = f"ball (+ and circle), {shown.what} (rings)"
    axes.set(title=title, xlabel="x [pixels]", ylabel="y [pixels]")


def draw_directions(
    axes: Axes, labels: Sequence[str], directions: Array, near: Mask | None = None
) -> None:
    """Draw unit vectors to lamps (K, 3) as the viewer sees them, an azimuthal equidistant map.

    The distance from the middle is the angle to the viewer. Far lamps are discs, those that are
    `near` (K,) squares; behind the horizon they are hollow.
    """
    from matplotlib.patches import Circle

    across = np.linalg.norm(directions[:, :2], axis=-1)
    angle = np.degrees(np.arctan2(across, directions[:, 2]))
    places = directions[:, :2] * (angle / np.maximum(across, 1e-12))[:, None]
    largest = 90 if (angle <= 92).all() else 180
    for ring in range(30, largest + 1, 30):
        axes.add_patch(
            Circle((0, 0), ring, fill=False, color=GREY, linewidth=1.4 if ring == 90 else 0.6)
        )
        axes.annotate(
            f"{ring}°",
            (ring * np.sqrt(0.5), -ring * np.sqrt(0.5)),
            fontsize=7,
            color=GREY,
            backgroundcolor="white",
            ha="center",
            va="center",
            in_layout=False,
        )
    axes.plot(0, 0, "+", color=GREY, markersize=10)
    squares = np.zeros(len(angle), bool) if near is None else near
    kinds = ((squares, "s", ORANGE, "near"), (~squares, "o", BLUE, "far"))
    for of, marker, color, kind in kinds:
        for place, fill, where in ((angle <= 90, color, ""), (angle > 90, "none", ", behind")):
            if (of & place).any():
                label = f"{kind}{where}"
                axes.plot(*places[of & place].T, marker, color=color, mfc=fill, label=label)
    every = max(1, -(-len(labels) // LABELS_MAX))
    for label, at in zip(labels[::every], places[::every], strict=True):
        axes.annotate(
            label, tuple(at), (5, 4), textcoords="offset points", fontsize=7, in_layout=False
        )
    if len(places):
        axes.legend(loc="upper right", fontsize=8)
    room = 1.12 * largest
    axes.set(xlim=(-room, room), ylim=(-room, room), aspect="equal", xticks=[], yticks=[])
    axes.set(xlabel="← left · right (X) →", ylabel="← down · up (Y) →")
    axes.set(title="lamps by angle to the viewer (+)")
