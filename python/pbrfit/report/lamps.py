"""The lamps of a result: where they stand, as a map of directions and in numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pbrfit.report import figures, lamp_sheet
from pbrfit.report.html import Cell, Table, heads, number, paragraph, table
from pbrfit.report.lights import LUMINANCE
from pbrfit.report.notation import angle, percent, plain
from pbrfit.result.drawing import new_figure
from pbrfit.result.result import Result
from pbrfit.scene import known_lamps
from pbrfit.values.arrays import Array

BESIDE = 24
"""Lamps up to which the table stands beside the map; a longer one is folded below it."""


@dataclass(frozen=True)
class Seen:
    """A lamp as the middle of the surface sees it."""

    direction: Array
    """(3,) unit vector to it."""
    azimuth: float
    elevation: float
    """Degrees from the viewer towards the right, and upwards."""
    strength: float
    """Luminance of a white matt surface there that faces it, in picture units."""
    color: Array
    """(3,) linear, the largest channel 1."""
    distance: float | None
    """In the unit of the depth; None = far away."""


def seen(result: Result) -> list[list[Seen]]:
    """The lamps of each picture."""
    found: list[list[Seen]] = [[] for _ in result.pictures]
    lamps, middle = result.lamps, result.middle
    if lamps is None:
        return found
    directions, colors = result.lamps_seen()
    angles = known_lamps.angles(directions).tolist()
    for k, i in enumerate(lamps.pictures.tolist()):
        distance = None
        if lamps.near[k] and middle is not None:
            distance = float(np.linalg.norm(lamps.places[k] - middle))
        strength, color = float(colors[k] @ LUMINANCE), colors[k] / (colors[k].max() or 1.0)
        azimuth, elevation = angles[k]
        found[i].append(Seen(directions[k], azimuth, elevation, strength, color, distance))
    return found


def section(result: Result) -> str:
    """HTML about lamps; nothing where there are none."""
    if result.lamps is None:
        return ""
    of_pictures = seen(result)
    numbers = _table(result, of_pictures)
    drawn = _map(of_pictures)
    if len(numbers.rows) <= BESIDE:
        shown = f'<div class="plans">{drawn}<div class="beside">{table(numbers)}</div></div>'
    else:
        shown = (
            f'<div class="plans">{drawn}</div><details class="numbers-of-all"><summary>'
            f"All {len(result.lamps)} lamps in numbers</summary>{table(numbers)}</details>"
        )
    text = (
        f"The pictures are lit by {result.lamps.in_words()}, and by ambient light. The map "
        "has the directions to the lamps as the surface sees them: the middle is the viewer, and "
        "equal angles from there are equally long. Numbers are those of the table. "
    )
    if result.lamps.near.any():
        text += "Near lamps are seen from the middle of the surface. "
    return paragraph(text) + shown


def _table(result: Result, of_pictures: Sequence[Sequence[Seen]]) -> Table:
    near = result.lamps is not None and bool(result.lamps.near.any())
    names = ["azimuth", "elevation", *(["distance"] if near else []), "strength", "colour R, G, B"]
    rows = []
    for i, lamps in enumerate(of_pictures):
        ambient = float(result.lighting[i, 0] @ LUMINANCE) / (2 * math.sqrt(math.pi))
        whole = ambient + sum(lamp.strength for lamp in lamps)
        share = ambient / whole if whole > 0 else 0.0
        first = lamps[0] if lamps else None
        last = number(percent(share).replace("-", "−"), share)
        rows.append([number(str(i + 1)), Cell(result.pictures[i]), *_cells(first, near), last])
        rows += [[Cell(""), Cell(""), *_cells(lamp, near), number("")] for lamp in lamps[1:]]
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
    yield number(angle(lamp.azimuth), lamp.azimuth)
    yield number(angle(lamp.elevation), lamp.elevation)
    if near:
        far = lamp.distance is None
        yield number("far" if far else plain(lamp.distance or 0.0), lamp.distance)
    yield number(plain(lamp.strength), lamp.strength)
    color = figures.css_of_light(lamp.color)
    yield Cell(", ".join(f"{part:.2f}" for part in lamp.color), "number", color=color)


def _map(of_pictures: Sequence[Sequence[Seen]]) -> str:
    """HTML of the directions to lamps as the surface sees them, with numbers of their pictures."""
    marks = [(str(i + 1), lamp) for i, lamps in enumerate(of_pictures) for lamp in lamps]
    drawing = new_figure(5, 5)
    lamp_sheet.draw_directions(
        drawing.subplots(),
        [number for number, _ in marks],
        np.array([lamp.direction for _, lamp in marks]).reshape(-1, 3),
        np.array([lamp.distance is not None for _, lamp in marks], dtype=bool),
    )
    return figures.plot(drawing, f"Map of the directions to {len(marks)} lamps")
