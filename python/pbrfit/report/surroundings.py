"""The geometry that a fit supposed, drawn from above and from the side."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from html import escape

import numpy as np
from numpy.typing import NDArray

from pbrfit.transport.room import room_axes
from pbrfit.transport.scenery import BACK, SIDE, WALL, Scenery

Array = NDArray[np.float64]

# Okabe and Ito's colours, which people with any colour vision can tell apart.
SEEN, UNSEEN, ON_WALL, LINE, CAMERA = "#0072b2", "#e69f00", "#8fa3ad", "#333333", "#d55e00"
"""Colours: points of things, of their backs and sides, of walls; walls; the camera."""
MOST_POINTS = 1200
"""Points of a kind that are drawn, at most."""
LEFT, BELOW, AROUND = 44, 36, 10
"""Pixels beside the drawing for numbers and titles."""
INSIDE = 0.995
"""Share of points on either side that the drawing has room for, at least."""


def plan_view(scenery: Scenery, size: int = 420, unit: str = "units of depth") -> tuple[str, str]:
    """Draw surroundings from above and from the side, to one scale.

    Parameters
    ----------
    scenery
        What blocks light.
    size
        Width in pixels of each drawing.
    unit
        What the numbers at the axes count.

    Returns
    -------
    Two SVG elements. From above the way ahead in the room is up, from the side it is to the right.
    """
    right, up, ahead = room_axes(scenery.walls)
    drawn = _Parts(scenery)
    views = []
    for across, along in ((right, ahead), (ahead, up)):
        views.append((np.array([across, along]), drawn.bounds(np.array([across, along]))))
    # One scale for both: the wider one fills its drawing.
    widest = max(float(high[0] - low[0]) for _, (low, high) in views)
    scale = (size - LEFT - AROUND) / widest
    titles = (
        ("From above", f"to the right, {unit}", "ahead"),
        ("From the side", f"ahead, {unit}", "up"),
    )
    above, side = (
        _drawing(drawn, axes, bounds, scale, size, title)
        for (axes, bounds), title in zip(views, titles, strict=True)
    )
    return above, side


def plan_key() -> str:
    """HTML that says what the colours of `plan_view` mean."""
    marks = (
        (SEEN, "things, as seen"),
        (UNSEEN, "their backs and sides, supposed"),
        (ON_WALL, "seen on walls and floor"),
        (LINE, "what closes the room; dashed where it lets light through"),
        (CAMERA, "camera and what it sees"),
    )
    patches = "".join(
        f'<span class="mark"><span class="patch" style="background:{color}"></span> '
        f"{escape(text)}</span>"
        for color, text in marks
    )
    return f'<div class="key">{patches}</div>'


class _Parts:
    """What is drawn, in camera space."""

    def __init__(self, scenery: Scenery) -> None:
        points = scenery.points
        here = np.isfinite(points).all(axis=-1)
        on_walls = np.zeros(here.shape, bool)
        for wall in scenery.walls:
            on_walls |= wall.pixels
        hidden = np.isin(scenery.kind, (BACK, SIDE))
        self.on_walls = _some(points[here & on_walls])
        self.unseen = _some(scenery.triangles[hidden].mean(axis=1).astype(float))
        self.things = _some(points[here & ~on_walls])
        pairs = scenery.triangles[scenery.kind == WALL].reshape(-1, 2, 3, 3)
        self.solid = np.concatenate([pairs[:, 0], pairs[:, 1, 2:]], axis=1).astype(float)
        self.open = [
            wall.corners
            for wall, blocks in zip(scenery.walls, scenery.extents.blocks, strict=True)
            if not blocks
        ]
        self.seen = points[here]

    def bounds(self, axes: Array) -> tuple[Array, Array]:
        """Lower and upper ends (2,) of what a view has room for: walls, most points, the camera."""
        corners = np.concatenate([self.solid.reshape(-1, 3), *self.open, np.zeros((1, 3))]) @ axes.T
        low, high = corners.min(axis=0), corners.max(axis=0)
        for cloud in (self.on_walls, self.unseen, self.things):
            if len(cloud):
                flat = cloud @ axes.T
                low = np.minimum(low, np.quantile(flat, 1 - INSIDE, axis=0))
                high = np.maximum(high, np.quantile(flat, INSIDE, axis=0))
        room = 0.04 * float((high - low).max())
        return low - room, high + room


def _some(points: Array) -> Array:
    """A few of the points, evenly; always the same."""
    count = len(points)
    chosen = np.random.default_rng(0).permutation(count)[:MOST_POINTS]
    return points[np.sort(chosen)]


def _drawing(
    drawn: _Parts,
    axes: Array,
    bounds: tuple[Array, Array],
    scale: float,
    size: int,
    title: tuple[str, str, str],
) -> str:
    low, high = bounds
    tall = float(high[1] - low[1]) * scale
    wide = float(high[0] - low[0]) * scale
    height = tall + BELOW + 2 * AROUND + 8

    def at(points: Array) -> Array:
        flat = np.atleast_2d(points) @ axes.T
        return _place(flat, low, high, scale)

    heading, below, beside = title
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size} {height:.0f}" '
        f'width="{size}" height="{height:.0f}" role="img" aria-label="{escape(heading)}" '
        'font-family="system-ui, sans-serif" font-size="11" fill="#555">',
        f'<clipPath id="{_id(heading)}"><rect x="{LEFT}" y="{AROUND + 8}" '
        f'width="{wide:.1f}" height="{tall:.1f}"/></clipPath>',
        *_grid(low, high, scale, wide, tall),
        f'<g clip-path="url(#{_id(heading)})">',
        _cone(drawn.seen, axes, at, max(wide, tall) / scale),
    ]
    flat = [at(corners) for corners in drawn.solid]
    for corners in (one for one in flat if not _is_line(one)):
        parts.append(
            f'<polygon points="{_path(corners)}" fill="{LINE}" fill-opacity=".05" '
            f'stroke="{LINE}" stroke-opacity=".12"/>'
        )
    parts += _dots(drawn.on_walls, at, ON_WALL, 0.55)
    for corners in (one for one in flat if _is_line(one)):
        parts.append(
            f'<polygon points="{_path(corners)}" fill="{LINE}" '
            f'stroke="{LINE}" stroke-width="2.5" stroke-linejoin="round"/>'
        )
    for corners in drawn.open:
        parts.append(
            f'<polygon points="{_path(at(corners))}" fill="none" '
            f'stroke="{LINE}" stroke-width="1.5" stroke-dasharray="5 4"/>'
        )
    for color, cloud in ((UNSEEN, drawn.unseen), (SEEN, drawn.things)):
        parts += _dots(cloud, at, color, 0.85)
    (x, y) = at(np.zeros(3))[0]
    parts += [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{CAMERA}" '
        'stroke="#fff" stroke-width="1.5"/>',
        "</g>",
        f'<text x="{LEFT}" y="{AROUND + 1}" font-size="12" font-weight="600" fill="#1e1e1e">'
        f"{escape(heading)}</text>",
        f'<text x="{LEFT + wide / 2:.1f}" y="{tall + AROUND + 8 + 31:.1f}" text-anchor="middle">'
        f"{escape(below)}</text>",
        f'<text transform="translate(11 {AROUND + 8 + tall / 2:.1f}) rotate(-90)" '
        f'text-anchor="middle">{escape(beside)}</text>',
        "</svg>",
    ]
    return "".join(parts)


def _dots(cloud: Array, at: Callable[[Array], Array], color: str, opacity: float) -> Iterable[str]:
    if not len(cloud):
        return
    # Round dots as one path of lines without length.
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in at(cloud))
    yield (
        f'<path d="{dots}" stroke="{color}" stroke-width="2.4" stroke-linecap="round" '
        f'stroke-opacity="{opacity}" fill="none"/>'
    )


def _is_line(corners: Array) -> bool:
    """Whether a rectangle is seen from its edge: thinner than two pixels."""
    x, y = corners.T
    area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    return bool(area < 2 * max(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)))


def _place(flat: Array, low: Array, high: Array, scale: float) -> Array:
    x = LEFT + (flat[:, 0] - low[0]) * scale
    y = AROUND + 8 + (high[1] - flat[:, 1]) * scale
    return np.stack([x, y], axis=-1)


def _grid(low: Array, high: Array, scale: float, wide: float, tall: float) -> Iterable[str]:
    """Frame, lines at round numbers, and these numbers."""
    top, bottom = AROUND + 8, AROUND + 8 + tall
    yield (
        f'<rect x="{LEFT}" y="{top}" width="{wide:.1f}" height="{tall:.1f}" fill="#fff" '
        'stroke="#ccc"/>'
    )
    step = round_step(45.0 / scale)
    for i in range(int(np.ceil(low[0] / step)), int(np.floor(high[0] / step)) + 1):
        x = LEFT + (i * step - low[0]) * scale
        yield f'<path d="M{x:.1f} {top}V{bottom:.1f}" stroke="#eee"/>'
        yield f'<text x="{x:.1f}" y="{bottom + 14:.1f}" text-anchor="middle">'
        yield f"{_number(i * step)}</text>"
    for i in range(int(np.ceil(low[1] / step)), int(np.floor(high[1] / step)) + 1):
        y = top + (high[1] - i * step) * scale
        yield f'<path d="M{LEFT} {y:.1f}H{LEFT + wide:.1f}" stroke="#eee"/>'
        yield f'<text x="{LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{_number(i * step)}</text>'


def round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, ... times a power of ten that is not below `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(power * m for m in (1, 2, 5, 10) if power * m >= least * (1 - 1e-9)))


def _number(value: float) -> str:
    return f"{value:.6g}".replace("-", "−")


def _cone(seen: Array, axes: Array, at: Callable[[Array], Array], far: float) -> str:
    """The part of the plane that the camera looks into."""
    flat = seen @ axes.T
    forward = np.array([0.0, 0.0, -1.0]) @ axes.T
    middle = np.arctan2(forward[1], forward[0])
    turn = np.arctan2(flat[:, 1], flat[:, 0]) - middle
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    angles = middle + np.quantile(turn, [0.002, 0.998])
    ends = [2 * far * (np.cos(a) * axes[0] + np.sin(a) * axes[1]) for a in angles]
    corners = at(np.array([np.zeros(3), *ends]))
    return (
        f'<polygon points="{_path(corners)}" fill="{CAMERA}" fill-opacity=".07" '
        f'stroke="{CAMERA}" stroke-opacity=".45" stroke-dasharray="2 3"/>'
    )


def _path(corners: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)


def _id(heading: str) -> str:
    return "plan-" + heading.lower().replace(" ", "-")
