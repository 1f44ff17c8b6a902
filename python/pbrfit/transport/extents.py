"""What no picture shows: how thick things are, how high walls, where a room ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pbrfit.transport.rays import Array

if TYPE_CHECKING:  # a result reads extents, and has no need of what finds walls
    from pbrfit.transport.walls import Wall

EYE = 1.6
"""Metres above the floor of a camera that a person holds: what the metres below are told by."""
THICKNESS, HEIGHT, REACH = 0.5, 2.7, 1.2
"""Metres: of things, at most; of walls; beyond what is seen of a wall."""
DEPTH = 3.0
"""Metres of the median depth of a room whose floor is not seen."""


@dataclass(frozen=True)
class Extents:
    """What no picture shows, in units of the median depth.

    Attributes
    ----------
    thickness
        Of things seen from the front, at most.
    height
        Of walls above the floor, or above the lowest point where no floor is seen; a wall that is
        seen higher up is higher. None = as far as they are seen.
    behind
        Distance of the wall behind the camera; None = open.
    ceiling
        Whether it is closed above.
    blocks
        For each wall that was found, whether it blocks light.
    reach
        How far a wall goes on beyond what is seen of it where no other wall ends it, and floor and
        walls behind the camera where no wall is there.
    """

    thickness: float
    height: float | None
    behind: float | None
    ceiling: bool
    blocks: tuple[bool, ...]
    reach: float


def default_extents(points: Array, walls: tuple[Wall, ...]) -> Extents:
    """Extents to begin with.

    The unit of depth is not known. Where a floor is seen, the camera is EYE above it, else the
    median depth is DEPTH metres. Without an upright wall nothing is closed.

    Parameters
    ----------
    points
        (H, W, 3) camera space, NaN where nothing is.
    walls
        As `find_walls` gives them.
    """
    unit = scale_of(points)
    floor = [wall for wall in walls if wall.level == 1]
    upright = any(wall.level == 0 for wall in walls)
    metre = -floor[0].offset / unit / EYE if floor else 1 / DEPTH
    return Extents(
        thickness=THICKNESS * metre,
        height=HEIGHT * metre if upright else None,
        behind=None,
        ceiling=False,
        blocks=(True,) * len(walls),
        reach=REACH * metre,
    )


def scale_of(points: Array) -> float:
    """Median depth of points (..., 3): the unit of `Extents`."""
    return float(np.nanmedian(-points[..., 2]))


def candidates(extents: Extents) -> Iterator[Extents]:
    """Neighbours of extents that a search may try: one thing changed in each."""
    for factor in (0.5, 2.0):
        yield replace(extents, thickness=factor * extents.thickness)
    if extents.height is not None:
        for factor in (0.8, 1.25):
            yield replace(extents, height=factor * extents.height)
        yield replace(extents, ceiling=not extents.ceiling)
    if extents.behind is not None:
        for factor in (0.6, 1.6):
            yield replace(extents, behind=factor * extents.behind)
        yield replace(extents, behind=None, reach=extents.behind)
    elif extents.height is not None:
        yield replace(extents, behind=extents.reach)
    if extents.behind is None and extents.blocks:
        for factor in (0.6, 1.6):
            yield replace(extents, reach=factor * extents.reach)
    for i, blocks in enumerate(extents.blocks):
        changed = (*extents.blocks[:i], not blocks, *extents.blocks[i + 1 :])
        yield replace(extents, blocks=changed)
