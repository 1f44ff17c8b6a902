"""Rectangles of walls, floor and ceiling, extended to where they meet or are said to end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pbrfit.transport.decision import Extents
from pbrfit.transport.walls import AGREES, UPRIGHT, Wall, upwards
from pbrfit.values.arrays import Array

EYE = 1.6
"""Metres above the floor of a camera that a person holds: what the metres below are told by."""
THICKNESS, HEIGHT, REACH = 0.5, 2.7, 1.2
"""Metres: of things, at most; of walls; beyond what is seen of a wall."""
DEPTH = 3.0
"""Metres of the median depth of a room whose floor is not seen."""
CORNER = 0.1
"""How far a wall may be seen beyond a corner before that is none, in median depths."""
SLOPE = 0.3
"""Least sine of the angle at which walls meet in a corner."""
NAMED = 0.8
"""Cosine between a wall's normal and an axis of the room from which it is called by that axis."""


def default_extents(unit: float, walls: Sequence[Wall]) -> Extents:
    """Extents to begin with; `unit` is the median depth.

    The unit of depth is not known. Where a floor is seen, the camera is EYE above it, else the
    median depth is DEPTH metres. Without an upright wall nothing is closed.
    """
    floor = [wall for wall in walls if wall.level == 1]
    metre = -floor[0].offset / unit / EYE if floor else 1 / DEPTH
    return Extents(
        thickness=THICKNESS * metre,
        height=HEIGHT * metre if any(wall.level == 0 for wall in walls) else None,
        behind=None,
        ceiling=False,
        blocks=(True,) * len(walls),
        reach=REACH * metre,
    )


@dataclass(frozen=True)
class _Bounds:
    """Right, up and ahead in a room (3, 3), and its bounds (3,) along these."""

    axes: Array
    low: Array
    high: Array


def rectangles(
    points: Array, walls: Sequence[Wall], extents: Extents, unit: float
) -> Iterator[tuple[Array, int]]:
    """(4, 3) corners of what blocks light, each with the number of its wall from 1 on, or 0.

    Walls end where they meet others, at `reach` beyond what is seen, or behind the camera; they
    stand on the floor. `points` (P, 3) are the scene's, and `unit` is their median depth, that of
    extents.
    """
    if not walls:
        return
    room = _bounds(points, walls, extents, unit)
    (west, base, behind), (east, top, front) = room.low, room.high
    ground = np.array([[west, behind], [east, behind], [east, front], [west, front]])
    for number, (wall, blocks) in enumerate(zip(walls, extents.blocks, strict=True), start=1):
        slope = float(wall.normal @ room.axes[1])
        if not blocks:
            continue
        if abs(slope) > AGREES:  # the room's whole ground, along up onto floor or ceiling
            corners = ground @ room.axes[[0, 2]]
            rise = (wall.offset - corners @ wall.normal) / slope
            yield corners + rise[:, None] * room.axes[1], number
        elif abs(slope) < UPRIGHT:
            yield _upright(wall, walls, room, extents, unit), number
        else:
            yield wall.corners, number
    levels = {wall.level for wall in walls}
    if extents.ceiling and 0 in levels and -1 not in levels:
        yield np.insert(ground, 1, top, axis=1) @ room.axes, 0
    if extents.behind is not None and 0 in levels:
        at = [(west, base, behind), (east, base, behind), (east, top, behind), (west, top, behind)]
        yield np.array(at) @ room.axes, 0


def _bounds(points: Array, walls: Sequence[Wall], extents: Extents, unit: float) -> _Bounds:
    right, up, ahead = axes = np.array(room_axes(walls))
    reach = extents.reach * unit
    low, high = np.quantile(points @ axes.T, [1e-3, 1 - 1e-3], axis=0)
    # What is seen of walls and floor counts, and the camera itself.
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    low[0] -= reach
    high[[0, 2]] += reach
    low[2] = -reach if extents.behind is None else -unit * extents.behind
    for wall in walls:
        for axis, direction in ((0, right), (2, ahead)):
            along = float(wall.normal @ direction)
            if abs(along) > AGREES:
                (low if along > 0 else high)[axis] = wall.offset / along
    # Heights: floor, else the lowest point; the walls' height above it, at least what is seen.
    low[1] = next((wall.offset for wall in walls if wall.level == 1), low[1])
    tops = [float((wall.corners @ up).max()) for wall in walls if wall.level == 0]
    height = -np.inf if extents.height is None else low[1] + extents.height * unit
    ceiling = [-wall.offset for wall in walls if wall.level == -1]
    high[1] = ceiling[0] if ceiling else max([height, *tops, 0.0])
    return _Bounds(axes, low, high)


def room_axes(walls: Sequence[Wall]) -> tuple[Array, Array, Array]:
    """Right, up and ahead in a room: unit vectors (3,) in camera space.

    Up is the floor's normal, ahead the way nearest to the view that is square to a wall.
    """
    up, _ = upwards([wall.normal for wall in walls])
    view = _level_part(np.array([0.0, 0.0, -1.0]), up)
    if not np.isfinite(view).all():  # straight down
        view = _level_part(np.array([0.0, 1.0, 0.0]), up)
    ways = []
    for wall in walls:
        if abs(wall.normal @ up) < UPRIGHT:
            level = _level_part(wall.normal, up)
            ways += [-level, np.cross(up, level), np.cross(level, up)]
    ahead = max(ways, key=lambda way: float(way @ view), default=view)
    return np.cross(ahead, up), up, ahead


def _level_part(vector: Array, up: Array) -> Array:
    level = vector - (vector @ up) * up
    length = float(np.linalg.norm(level))
    return level / length if length > 0.1 else np.full(3, np.nan)


def _upright(
    wall: Wall, walls: Sequence[Wall], room: _Bounds, extents: Extents, unit: float
) -> Array:
    _, up, ahead = room.axes
    along = np.cross(up, wall.normal)
    along /= np.linalg.norm(along)
    rise = np.cross(wall.normal, along)
    foot = wall.offset * wall.normal
    seen = wall.corners @ along
    first, last = float(seen.min()), float(seen.max())
    # Planes that face it end it, that behind the camera as well.
    ends = [(ahead, float(room.low[2]))]
    ends += [(o.normal, o.offset) for o in walls if o is not wall and o.level == 0]
    before, after = [], []
    for normal, offset in ends:
        slope = float(normal @ along)
        at = (offset - foot @ normal) / slope if abs(slope) >= SLOPE else np.nan
        if slope > 0 and at < first + CORNER * unit:
            before.append(at)
        elif slope < 0 and at > last - CORNER * unit:
            after.append(at)
    reach = extents.reach * unit
    low = min(max(before, default=first - reach), first)
    high = max(min(after, default=last + reach), last)
    # Height along the wall, which may lean a little.
    lean = float(rise @ up)
    base = (room.low[1] - foot @ up) / lean
    top = (room.high[1] - foot @ up) / lean
    if extents.height is None:
        top = float((wall.corners @ rise).max())
    corners = (low, base), (high, base), (high, top), (low, top)
    return np.array([foot + s * along + t * rise for s, t in corners])


def name_of(wall: Wall, walls: Sequence[Wall]) -> str:
    """What a wall is called by where it is in the room."""
    if wall.level:
        return "floor" if wall.level == 1 else "ceiling"
    right, up, ahead = room_axes(walls)
    along = {
        "left wall": right,
        "right wall": -right,
        "wall ahead": -ahead,
        "wall behind": ahead,
        "level surface": up,
    }
    name = max(along, key=lambda one: float(wall.normal @ along[one]))
    return name if wall.normal @ along[name] > NAMED else "slanted wall"


def counted(names: Sequence[str]) -> str:
    """Names, each once with how many there are of it: "floor, 2 left walls"."""
    parts = []
    for name in dict.fromkeys(names):
        count = names.count(name)
        several = f"{count} {name.replace('wall', 'walls').replace('surface', 'surfaces')}"
        parts.append(several if count > 1 else name)
    return ", ".join(parts)
