"""What surroundings were supposed, from above and from the side, and what they do to light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pbrfit.display.tone import encoded
from pbrfit.io.resampling import reduced_size
from pbrfit.report import figures, raster
from pbrfit.report.html import paragraph
from pbrfit.result import metrics
from pbrfit.result.drawing import AMBER, BLACK, BLUE, GREY, ORANGE, new_figure
from pbrfit.result.relighting import DirectionalLight, LampLight, relight
from pbrfit.result.result import Result
from pbrfit.transport.room import room_axes
from pbrfit.transport.scenery import BACK, SIDE, WALL, Scenery
from pbrfit.values.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RELIT_SIDE = 384
"""Longer side of the relit pictures."""

LAMPS = tuple(DirectionalLight(azimuth, up) for up in (35, 50, 65) for azimuth in (-45, -20, 30))
"""Lamps that may show shadows, from the upper left first."""

LEAST_OPEN = 0.35
"""Share of the pixels that a lamp should reach; else the one that reaches most is taken."""

NO_LIGHT = 0.02
"""Share of the pixels below which no lamp is shown: walls keep all of them out."""

MOST_POINTS = 1200
"""Points of a kind that are drawn, at most."""
INSIDE = 0.995
"""Share of points on either side that the drawing has room for, at least."""


def section(result: Result) -> str:
    """HTML about surroundings; nothing where the fit knew none."""
    transport, scenery = result.transport, result.scenery
    if scenery is None:
        if not transport.figures:
            return ""
        nothing = "Surroundings do nothing: all light reaches every surface."
        return paragraph(f"{nothing} The fit left them out: {transport.why}.")
    text = paragraph(
        f"Things, walls and floor that the depth shows {scenery.in_words(transport)}. "
        "What no picture shows is supposed: how deep things are, how high walls, where the room "
        "ends behind the camera."
    )
    if transport.kind == "bounce":
        text += paragraph(
            "The fit took what surfaces reflect from the pictures themselves; reconstructions and "
            "relit pictures compute it from the maps."
        )
    plans = figures.plot(plan_view(scenery), "Surroundings from above and from the side")
    return text + plans + _relit(result, scenery)


def _relit(result: Result, scenery: Scenery) -> str:
    """The same light with and without surroundings."""
    first = f"light of {result.pictures[0]}"
    cards = _pair(result, result.lights[0], first)
    lamp = _lamp(scenery)
    if lamp is not None:
        cards += _pair(result, lamp, "a hard lamp")
    text = "Each pair has the same light and the same exposure."
    if lamp is not None:
        text += (
            f" The lamp is far away, at azimuth {lamp.azimuth:g}° and elevation "
            f"{lamp.elevation:g}°; what surfaces reflect of it is left out."
        ).replace("-", "−")
    heading = "<h3>With and without surroundings</h3>"
    return heading + paragraph(text, "note") + figures.grid(cards, "relit maps")


def _pair(result: Result, light: Array | DirectionalLight | LampLight, name: str) -> list[str]:
    among, without = (relight(result, light, shadows=one) for one in (True, False))
    white = metrics.white_of(without)
    size = reduced_size(result.mask.shape, RELIT_SIDE)
    found = []
    for picture, how in ((among, "with surroundings"), (without, "without")):
        png = raster.picture_png(encoded(raster.reduced(picture, RELIT_SIDE) / white))
        shown = figures.picture(png, size, f"Relit by {name}, {how}")
        found.append(figures.figure(shown, how, name))
    return found


def _lamp(scenery: Scenery) -> DirectionalLight | None:
    """A lamp that reaches some surfaces and not all."""
    shares = [float(scenery.open_to(lamp.direction).mean()) for lamp in LAMPS]
    good = [i for i, share in enumerate(shares) if share >= LEAST_OPEN]
    best = good[0] if good else int(np.argmax(shares))
    return LAMPS[best] if shares[best] >= NO_LIGHT else None


def plan_view(scenery: Scenery) -> Figure:
    """Draw what blocks light from above and from the side, to one scale.

    From above the way ahead in the room is up, from the side it is to the right.
    """
    right, up, ahead = room_axes(scenery.walls)
    parts = _Parts(scenery)
    views = (
        (np.array([right, ahead]), "From above", "to the right, units of depth", "ahead"),
        (np.array([ahead, up]), "From the side", "ahead, units of depth", "up"),
    )
    bounds = [parts.bounds(axes) for axes, *_ in views]
    # One scale for both: as wide as their contents, and equally high.
    wide = [high[0] - low[0] for low, high in bounds]
    tall = max(high[1] - low[1] for low, high in bounds)
    figure = new_figure(9, 9 * tall / sum(wide) + 1.2)
    drawings = figure.subplots(1, 2, width_ratios=wide)
    for drawing, (axes, *titles), (low, high) in zip(drawings, views, bounds, strict=True):
        parts.draw(drawing, axes, 2 * float(sum(wide)))
        middle = (low[1] + high[1]) / 2
        drawing.set(xlim=(low[0], high[0]), ylim=(middle - tall / 2, middle + tall / 2))
        drawing.set(aspect="equal", **dict(zip(("title", "xlabel", "ylabel"), titles, strict=True)))
        drawing.grid(alpha=0.3)
    marks = dict(zip(*reversed(drawings[0].get_legend_handles_labels()), strict=True))
    figure.legend(marks.values(), marks.keys(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


class _Parts:
    """What is drawn, in camera space."""

    def __init__(self, scenery: Scenery) -> None:
        points = scenery.points
        here = np.isfinite(points).all(axis=-1)
        on_walls = np.zeros(here.shape, bool)
        for wall in scenery.walls:
            on_walls |= wall.pixels
        hidden = np.isin(scenery.kind, (BACK, SIDE))
        self.clouds = {
            ("seen on walls and floor", GREY): _some(points[here & on_walls]),
            ("backs and sides, supposed", AMBER): _some(
                scenery.triangles[hidden].mean(axis=1).astype(float)
            ),
            ("things, as seen", BLUE): _some(points[here & ~on_walls]),
        }
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
        for cloud in (one for one in self.clouds.values() if len(one)):
            flat = cloud @ axes.T
            low = np.minimum(low, np.quantile(flat, 1 - INSIDE, axis=0))
            high = np.maximum(high, np.quantile(flat, INSIDE, axis=0))
        room = 0.04 * float((high - low).max())
        return low - room, high + room

    def draw(self, drawing: Axes, axes: Array, far: float) -> None:
        """Draw it along two axes (2, 3); nothing that is drawn is farther away than `far`."""
        # The part of the plane that the camera looks into.
        flat = self.seen @ axes.T
        forward = np.array([0.0, 0.0, -1.0]) @ axes.T
        middle = np.arctan2(forward[1], forward[0])
        turn = (np.arctan2(flat[:, 1], flat[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
        angles = middle + np.quantile(turn, [0.002, 0.998])
        ends = far * np.stack([np.cos(angles), np.sin(angles)])
        drawing.fill([0, *ends[0]], [0, *ends[1]], color=ORANGE, alpha=0.07)
        for what, style, walls in (
            ("closes the room", "-", self.solid),
            ("lets light through", "--", self.open),
        ):
            for corners in walls:
                outline = np.concatenate([corners, corners[:1]]) @ axes.T
                drawing.plot(*outline.T, style, color=BLACK, linewidth=1.2, label=what)
        for (what, color), cloud in self.clouds.items():
            drawing.plot(*(cloud @ axes.T).T, ".", color=color, markersize=2, label=what)
        drawing.plot(0, 0, "o", color=ORANGE, label="camera, and what it sees")


def _some(points: Array) -> Array:
    """A few of the points, evenly; always the same."""
    count = len(points)
    chosen = np.random.default_rng(0).permutation(count)[:MOST_POINTS]
    return points[np.sort(chosen)]
