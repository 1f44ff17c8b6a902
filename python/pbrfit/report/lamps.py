"""The lamps of a result: where they stand, as a map of directions and in numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import encode_srgb
from pbrfit.model.lamps import Lamps
from pbrfit.report import figures
from pbrfit.report.html import Cell, Table, heads, number, paragraph, table
from pbrfit.report.lights import LUMINANCE
from pbrfit.report.notation import percent, plain
from pbrfit.result.drawing import BLUE, ORANGE
from pbrfit.result.result import Result

Array = NDArray[np.float64]

SIZE = 420
"""Width and height of the map in pixels."""

RADIUS = 155
"""Pixels from the middle to the horizon."""

BEHIND = 1.07
"""Where lamps behind the horizon are drawn, in radii."""

STEP = 30
"""Degrees between lines of equal azimuth, and of equal elevation."""

MARK = 4.5
"""Radius of a lamp's mark in pixels."""

LETTER = 6.7
"""Width of a digit at the size of the lamps' numbers, in pixels."""

BESIDE = 24
"""Lamps up to which the table stands beside the map; a longer one is folded below it."""


Box = tuple[float, float, float, float]
"""Left, top, right and bottom in pixels."""


@dataclass(frozen=True)
class Seen:
    """A lamp as the middle of the surface sees it."""

    direction: tuple[float, float, float]
    """Unit vector to it."""
    strength: float
    """Luminance of a white matt surface there that faces it, in picture units."""
    color: tuple[float, float, float]
    """Linear, the largest channel 1."""
    distance: float | None
    """In the unit of the depth; None = far away."""

    @property
    def azimuth(self) -> float:
        """Degrees from the viewer towards the right."""
        return math.degrees(math.atan2(self.direction[0], self.direction[2]))

    @property
    def elevation(self) -> float:
        """Degrees upwards."""
        return math.degrees(math.asin(max(-1.0, min(1.0, self.direction[1]))))


def seen(result: Result) -> list[list[Seen]]:
    """The lamps of each picture."""
    found: list[list[Seen]] = [[] for _ in result.pictures]
    lamps, middle = result.lamps, result.middle
    if lamps is None:
        return found
    directions, colors = result.lamps_seen()
    for k, i in enumerate(lamps.pictures.tolist()):
        x, y, z = directions[k].tolist()
        red, green, blue = (colors[k] / (colors[k].max() or 1.0)).tolist()
        distance = None
        if lamps.near[k] and middle is not None:
            distance = float(np.linalg.norm(lamps.places[k] - middle))
        strength = float(colors[k] @ LUMINANCE)
        found[i].append(Seen((x, y, z), strength, (red, green, blue), distance))
    return found


def section(result: Result) -> str:
    """HTML about lamps; nothing where there are none."""
    if result.lamps is None:
        return ""
    of_pictures = seen(result)
    numbers = _table(result, of_pictures)
    drawn = f"<div>{direction_map(of_pictures, result.pictures)}{_key(result.lamps)}</div>"
    if len(numbers.rows) <= BESIDE:
        shown = f'<div class="plans">{drawn}<div class="beside">{table(numbers)}</div></div>'
    else:
        shown = (
            f'<div class="plans">{drawn}</div><details class="numbers-of-all"><summary>'
            f"All {len(result.lamps)} lamps in numbers</summary>{table(numbers)}</details>"
        )
    return paragraph(_sentences(result)) + shown


def _sentences(result: Result) -> str:
    assert result.lamps is not None
    text = (
        f"The pictures are lit by {result.lamps.in_words()}, and by ambient light. The map "
        "has the directions to the lamps as the surface sees them: the middle is the viewer, the "
        "circle the horizon, 90° from the viewer, and equal angles from the middle are equally "
        "long. Numbers are those of the table. "
    )
    if result.lamps.near.any():
        text += "Near lamps are seen from the middle of the surface. "
    return text


def _table(result: Result, of_pictures: Sequence[Sequence[Seen]]) -> Table:
    near = result.lamps is not None and bool(result.lamps.near.any())
    names = ["azimuth", "elevation", *(["distance"] if near else []), "strength", "colour R, G, B"]
    rows = []
    for i, lamps in enumerate(of_pictures):
        ambient = float(result.lighting[i, 0] @ LUMINANCE) / (2 * math.sqrt(math.pi))
        for k, lamp in enumerate(lamps or [None]):
            first = [number(str(i + 1)), Cell(result.pictures[i])] if k == 0 else [Cell("")] * 2
            rows.append([*first, *_cells(lamp, near), *_ambient(lamps, ambient, first=k == 0)])
    unit = ", and distances in that of the depth" if near else ""
    caption = (
        "Azimuth 0 is the viewer, positive to the right; elevation is up. Strength: radiance of a "
        f"white matt surface that faces the lamp, in the pictures' unit{unit}. Ambient: share of "
        "the ambient light in what such a surface gets."
    )
    columns = [Cell("", "number"), *heads("picture", *names, "ambient")]
    return Table(columns, rows, caption)


def _cells(lamp: Seen | None, near: bool) -> Iterator[Cell]:
    if lamp is None:
        yield from [number("no lamp"), *[number("")] * (4 if near else 3)]
        return
    yield number(_degrees(lamp.azimuth), lamp.azimuth)
    yield number(_degrees(lamp.elevation), lamp.elevation)
    if near:
        far = lamp.distance is None
        yield number("far" if far else plain(lamp.distance or 0.0), lamp.distance)
    yield number(plain(lamp.strength), lamp.strength)
    color = figures.css(encode_srgb(np.array(lamp.color)))
    yield Cell(", ".join(f"{part:.2f}" for part in lamp.color), "number", color=color)


def _ambient(lamps: Sequence[Seen], ambient: float, *, first: bool) -> Iterator[Cell]:
    whole = ambient + sum(lamp.strength for lamp in lamps)
    share = ambient / whole if whole > 0 else 0.0
    yield number(percent(share).replace("-", "−"), share) if first else number("")


def _degrees(angle: float) -> str:
    return f"{round(angle)}°".replace("-", "−")


def direction_map(of_pictures: Sequence[Sequence[Seen]], names: Sequence[str]) -> str:
    """Draw directions to lamps as seen from the surface: SVG.

    An azimuthal equidistant map with its middle at the viewer. Marks have the number of their
    picture, from 1; where marks are crowded some go without.
    """
    marks = [(i, lamp) for i, lamps in enumerate(of_pictures) for lamp in lamps]
    places = [_at(np.array(lamp.direction)) for _, lamp in marks]
    label = f"Map of the directions to {len(marks)} lamps"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE} {SIZE}" width="{SIZE}" '
        f'height="{SIZE}" role="img" aria-label="{label}" font-family="system-ui, sans-serif" '
        'font-size="11" fill="#555">',
        *_graticule(),
    ]
    for (i, lamp), place in zip(marks, places, strict=True):
        parts.append(_mark(lamp, place, f"{i + 1}: {names[i]}"))
    parts += _labels([str(i + 1) for i, _ in marks], places)
    return "".join([*parts, "</svg>"])


def _at(direction: Array) -> tuple[float, float]:
    """Place on the map, in pixels."""
    across = math.hypot(direction[0], direction[1])
    angle = math.atan2(across, direction[2])
    radius = RADIUS * min(angle / (math.pi / 2), BEHIND)
    right, up = (direction[:2] / across).tolist() if across > 0 else (0.0, 0.0)
    return SIZE / 2 + radius * right, SIZE / 2 - radius * up


def _toward(azimuth: float, elevation: float) -> Array:
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])


def _graticule() -> Iterator[str]:
    """Horizon, lines of equal azimuth and elevation with their degrees, and the viewer."""
    middle = SIZE / 2
    yield f'<circle cx="{middle}" cy="{middle}" r="{RADIUS}" fill="#fafafa" stroke="#555"/>'
    along = np.linspace(-90, 90, 61).tolist()
    for angle in range(-90 + STEP, 90, STEP):
        for line in (
            [_at(_toward(angle, elevation)) for elevation in along],
            [_at(_toward(azimuth, angle)) for azimuth in along],
        ):
            path = "L".join(f"{x:.1f} {y:.1f}" for x, y in line)
            color = "#bbb" if angle == 0 else "#ddd"
            yield f'<path d="M{path}" fill="none" stroke="{color}"/>'
    for text, (left, _, right, bottom) in _degree_boxes():
        yield _text((left + right) / 2, bottom - 1, text, "middle")
    yield _text(middle, middle - RADIUS - 9, "elevation 90°", "middle")
    yield _text(middle, middle + RADIUS + 18, "−90°", "middle")
    yield _text(middle + RADIUS + 8, middle + 4, "90°", "start")
    yield _text(middle - RADIUS - 6, middle + 10, "−90°", "end")
    yield _text(middle - RADIUS - 6, middle - 3, "azimuth", "end")
    yield f'<path d="M{middle - 4} {middle}h8M{middle} {middle - 4}v8" stroke="#555"/>'
    yield _text(middle + 0.73 * RADIUS, middle + 0.78 * RADIUS, "horizon", "start")


def _degree_boxes() -> Iterator[tuple[str, Box]]:
    """Degrees on the map: azimuths below the level line, elevations beside the upright one."""
    middle = SIZE / 2
    yield "viewer", (middle - 6 - 5.5 * 6, middle - 14, middle - 6, middle - 4)
    for angle in range(-90 + STEP, 90, STEP):
        if angle:
            text = _degrees(angle)
            width = LETTER * len(text)
            (x, _), (_, y) = _at(_toward(angle, 0)), _at(_toward(0, angle))
            yield text, (x - width / 2, middle + 4, x + width / 2, middle + 14)
            yield text, (middle + 4, y - 5, middle + 4 + width, y + 5)


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _mark(lamp: Seen, place: tuple[float, float], name: str) -> str:
    """A disc for a far lamp, a square for a near one; hollow behind the horizon."""
    x, y = place
    color = BLUE if lamp.distance is None else ORANGE
    inside = color if lamp.direction[2] >= 0 else "#fff"
    look = f'fill="{inside}" stroke="{color if inside == "#fff" else "#fff"}" stroke-width="1.5"'
    said = f"{name}: azimuth {_degrees(lamp.azimuth)}, elevation {_degrees(lamp.elevation)}"
    title = f"<title>{escape(said)}</title>"
    if lamp.distance is None:
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{MARK}" {look}>{title}</circle>'
    side = 1.8 * MARK
    return (
        f'<rect x="{x - side / 2:.1f}" y="{y - side / 2:.1f}" width="{side:.1f}" '
        f'height="{side:.1f}" {look}>{title}</rect>'
    )


def _labels(texts: Sequence[str], places: Sequence[tuple[float, float]]) -> Iterator[str]:
    """Numbers beside their marks, each where it covers no mark and no other number."""
    taken: list[Box] = [(x - MARK, y - MARK, x + MARK, y + MARK) for x, y in places]
    taken += [box for _, box in _degree_boxes()]
    for text, (x, y) in zip(texts, places, strict=True):
        width, tall = LETTER * len(text), 10.0
        for right, down in _AROUND:
            left = x + right * (MARK + 2) - (width / 2) * (1 - right)
            top = y + down * (MARK + 2) - (tall / 2) * (1 - down)
            box = (left, top, left + width, top + tall)
            if not any(_overlap(box, other) for other in taken):
                taken.append(box)
                yield (
                    f'<text x="{left:.1f}" y="{top + tall - 1:.1f}" font-size="12" fill="#1e1e1e" '
                    'stroke="#fff" stroke-width="3" paint-order="stroke" '
                    f'stroke-linejoin="round">{text}</text>'
                )
                break


_AROUND = ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (1, 1), (-1, -1), (-1, 1))
"""Directions to the right and down in which a number may stand from its mark, best first."""


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _key(lamps: Lamps) -> str:
    """HTML that says what the marks mean; nothing where all lamps are far."""
    if not lamps.near.any():
        return ""
    marks = [(ORANGE, "near: a square"), *([] if lamps.near.all() else [(BLUE, "far: a disc")])]
    patches = "".join(
        f'<span class="mark"><span class="patch" style="background:{color}"></span> {name}</span>'
        for color, name in marks
    )
    return f'<div class="key">{patches}</div>'
