"""Rectangles of walls, floor and ceiling, extended to where they meet or are said to end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbrfit.transport.extents import Extents
from pbrfit.transport.rays import Array
from pbrfit.transport.walls import LEVEL, UPRIGHT, Wall, upwards

AHEAD = np.cos(np.radians(50.0))
"""Least cosine between the view and the way to the wall that a room is taken to face."""
CORNER = 0.1
"""How far a wall may be seen beyond a corner before that is none, in median depths."""


@dataclass(frozen=True)
class _Frame:
    """Right, up and ahead in a room, and what is known of its bounds along them."""

    right: Array
    up: Array
    ahead: Array
    low: Array
    high: Array


def rectangles(points: Array, walls: tuple[Wall, ...], extents: Extents, unit: float) -> Array:
    """(R, 4, 3) corners of what blocks light.

    Walls end where they meet others, at `reach` beyond what is seen, or behind the camera; they
    stand on the floor.

    Parameters
    ----------
    points
        (P, 3) of the scene.
    walls, extents
        What was found, and what is assumed of it.
    unit
        Median depth: the unit of extents.
    """
    if not walls:
        return np.empty((0, 4, 3))
    frame = _frame(points, walls, extents, unit)
    found = []
    for wall, blocks in zip(walls, extents.blocks, strict=True):
        if not blocks:
            continue
        slope = abs(float(wall.normal @ frame.up))
        if slope < UPRIGHT:
            found.append(_upright(wall, walls, frame, extents, unit))
        elif slope > LEVEL:
            found.append(_level(wall, frame))
        else:
            found.append(wall.corners)
    (west, base, behind), (east, top, front) = frame.low, frame.high
    corners = np.array([frame.right, frame.up, frame.ahead])
    closed = any(wall.level == 0 for wall in walls)
    if extents.ceiling and closed and not any(wall.level == -1 for wall in walls):
        at = [(west, top, behind), (east, top, behind), (east, top, front), (west, top, front)]
        found.append(np.array(at) @ corners)
    if extents.behind is not None and closed:
        at = [(west, base, behind), (east, base, behind), (east, top, behind), (west, top, behind)]
        found.append(np.array(at) @ corners)
    return np.stack(found) if found else np.empty((0, 4, 3))


def _frame(points: Array, walls: tuple[Wall, ...], extents: Extents, unit: float) -> _Frame:
    up, _ = upwards([wall.normal for wall in walls])
    view = _level_part(np.array([0.0, 0.0, -1.0]), up)
    if not np.isfinite(view).all():  # straight down
        view = _level_part(np.array([0.0, 1.0, 0.0]), up)
    # The room faces along one of its upright walls' normals, or at right angles to one.
    ahead, best = view, AHEAD
    for wall in (w for w in walls if abs(w.normal @ up) < UPRIGHT):
        level = _level_part(wall.normal, up)
        for way in (-level, np.cross(up, level), np.cross(level, up)):
            if way @ view > best:
                ahead, best = way, float(way @ view)
    right = np.cross(ahead, up)
    seen = points @ np.array([right, up, ahead]).T
    reach = extents.reach * unit
    low, high = np.quantile(seen, 1e-3, axis=0), np.quantile(seen, 1 - 1e-3, axis=0)
    # Sideways, what is seen of walls and floor counts, and the camera itself.
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    low[[0]] -= reach
    high[[0, 2]] += reach
    low[2] = -unit * (extents.reach if extents.behind is None else extents.behind)
    for wall in walls:
        for axis, direction in ((0, right), (2, ahead)):
            along = float(wall.normal @ direction)
            if along > LEVEL:
                low[axis] = wall.offset / along
            elif along < -LEVEL:
                high[axis] = wall.offset / along
    # Heights: floor, else the lowest point; the walls' height above it, at least what is seen.
    floor = [wall.offset for wall in walls if wall.level == 1]
    low[1] = floor[0] if floor else low[1]
    ceiling = [-wall.offset for wall in walls if wall.level == -1]
    tops = [float((wall.corners @ up).max()) for wall in walls if wall.level == 0]
    height = -np.inf if extents.height is None else low[1] + extents.height * unit
    high[1] = ceiling[0] if ceiling else max([height, *tops, 0.0])
    return _Frame(right, up, ahead, low, high)


def _level_part(vector: Array, up: Array) -> Array:
    level = vector - (vector @ up) * up
    length = float(np.linalg.norm(level))
    return level / length if length > 0.1 else np.full(3, np.nan)


def _upright(
    wall: Wall, walls: tuple[Wall, ...], frame: _Frame, extents: Extents, unit: float
) -> Array:
    along = np.cross(frame.up, wall.normal)
    along /= np.linalg.norm(along)
    rise = np.cross(wall.normal, along)
    foot = wall.offset * wall.normal
    seen = wall.corners @ along
    ends = [float(seen.min()), float(seen.max())]
    meets: tuple[list[float], list[float]] = ([], [])
    for other in walls:
        slope = float(other.normal @ along)
        if other is wall or other.level != 0 or abs(slope) < 0.3:
            continue
        at = (other.offset - foot @ other.normal) / slope
        if slope > 0 and at < ends[0] + CORNER * unit:
            meets[0].append(at)
        elif slope < 0 and at > ends[1] - CORNER * unit:
            meets[1].append(at)
    reach = extents.reach * unit
    low = max(meets[0]) if meets[0] else ends[0] - reach
    high = min(meets[1]) if meets[1] else ends[1] + reach
    step = float(along @ frame.ahead)
    if abs(step) > 0.3:  # it passes the camera, and ends where the room does
        behind = (frame.low[2] - foot @ frame.ahead) / step
        if step > 0:
            low = max(behind, max(meets[0], default=behind))
        else:
            high = min(behind, min(meets[1], default=behind))
    low, high = min(low, ends[0]), max(high, ends[1])
    # Height along the wall, which may lean a little.
    lean = float(rise @ frame.up)
    base = (frame.low[1] - foot @ frame.up) / lean
    top = (frame.high[1] - foot @ frame.up) / lean
    if extents.height is None:
        top = float((wall.corners @ rise).max())
    corners = ((low, base), (high, base), (high, top), (low, top))
    return np.array([foot + s * along + t * rise for s, t in corners])


def _level(wall: Wall, frame: _Frame) -> Array:
    """The room's whole bounds, projected onto floor or ceiling along up."""
    (west, _, behind), (east, _, front) = frame.low, frame.high
    at = ((west, behind), (east, behind), (east, front), (west, front))
    corners = np.array([s * frame.right + t * frame.ahead for s, t in at])
    drop = (wall.offset - corners @ wall.normal) / (wall.normal @ frame.up)
    return np.asarray(corners + drop[:, None] * frame.up)
