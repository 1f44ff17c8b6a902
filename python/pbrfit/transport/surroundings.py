"""What light meets: triangles of a scene, from depth, normals and segments.

Things are what is seen of them, pushed back along the view by their own width, and closed at their
sides. Walls, floor and ceiling are rectangles. A ray that meets none of these leaves the scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.transport.extents import Extents, candidates, default_extents, scale_of
from pbrfit.transport.rays import Array
from pbrfit.transport.relief import Mask, Relief, extended, relief
from pbrfit.transport.room import rectangles
from pbrfit.transport.sheet import sheets, widths
from pbrfit.transport.walls import Wall, find_walls

__all__ = [
    "BACK",
    "FRONT",
    "SIDE",
    "WALL",
    "Extents",
    "Surroundings",
    "Wall",
    "candidates",
    "default_extents",
    "find_walls",
    "surroundings",
]

FRONT, BACK, SIDE, WALL = range(4)
"""Kinds of triangle: seen; unseen behind that; between both; wall, floor, ceiling, behind."""
MAX_VERTICES = 66_000
"""Points of the front, at most, unless said otherwise: all pixels of a picture of 256 x 256."""
LIFT = 0.02
"""How far above the surface rays start, in the width of a pixel there: beyond rounding."""
LIFT_OF_NOISE = 1.0
"""And in standard deviations of the depth's noise that is left."""
SAFE = 0.99
"""Share of pixels whose point, moved by `Surroundings.offset` along the normal, is above all."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Triangles that block light.

    Attributes
    ----------
    triangles
        (T, 3, 3) float32, camera space (X right, Y up, Z towards the viewer, camera at the origin),
        in the unit of depth.
    kind
        (T,) uint8: FRONT, BACK, SIDE or WALL. Each two of WALL are a rectangle: the first three of
        its corners, in a circle, and the first, third and fourth.
    walls, extents
        What was found of walls, those that do not block light too, and what was assumed.
    starts
        (H, W, 3) float32: where rays of each pixel may start: its point, without the noise of its
        depth, lifted until no triangle of its own surface is above it; NaN where there is none.
    offset
        Distance along the normal after which a ray that starts at the pixel's own point is above
        its own surface too, for 99 % of the pixels.
    """

    triangles: NDArray[np.float32]
    kind: NDArray[np.uint8]
    walls: tuple[Wall, ...]
    extents: Extents
    starts: NDArray[np.float32]
    offset: float


def surroundings(
    points: Array,
    normals: Array,
    mask: Mask,
    segments: NDArray[np.integer] | None,
    extents: Extents,
    walls: tuple[Wall, ...],
    max_vertices: int = MAX_VERTICES,
) -> Surroundings:
    """Build what blocks light.

    Parameters
    ----------
    points
        (H, W, 3) as `pbrfit.model.geometry.positions` gives them: camera space, NaN where nothing
        is. Points outside the mask block light, too.
    normals
        (H, W, 3) unit normals, camera space; used in the mask.
    mask
        (H, W): where normals hold.
    segments
        (H, W) ids, 0 = unclassified; None = unknown.
    extents
        What no picture shows.
    walls
        As `find_walls` gives them for these points.
    max_vertices
        Points of the grid at most.

    Raises
    ------
    InputError
        If there are too few points, or `extents` were made for another number of walls.
    """
    if len(extents.blocks) != len(walls):
        raise InputError(
            f"extents: expected one entry of blocks for each of {len(walls)} walls, "
            f"found {len(extents.blocks)}"
        )
    points = np.asarray(points, np.float64)
    found = relief(points, normals, mask, segments, max_vertices)
    unit = scale_of(points)
    on_walls = np.zeros(mask.shape, bool)
    for wall in walls:
        on_walls |= wall.pixels
    things = found.here & ~on_walls[np.ix_(found.rows, found.columns)]
    thickness = widths(found, things, extents.thickness * unit)
    for wall in walls:  # nothing reaches through a wall
        towards = -(found.directions @ wall.normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(towards > 0, wall.above(found.points) / towards, np.inf)
        thickness = np.where(things, np.minimum(thickness, np.maximum(room, 0.0)), thickness)
    front, back, side = sheets(found, things, thickness)
    seen = points[np.isfinite(points).all(axis=-1)]
    rectangle = rectangles(seen, walls, extents, unit)
    flat = rectangle[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    parts = (front, back, side, flat)
    kind = np.repeat(np.arange(4, dtype=np.uint8), [len(part) for part in parts])
    triangles = np.concatenate(parts).astype(np.float32)
    solid = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=-1
    )
    kept = (solid > 0) | (kind == WALL)
    starts, offset = _starts(points, found, walls)
    return Surroundings(triangles[kept], kind[kept], walls, extents, starts, offset)


def _starts(
    points: Array, found: Relief, walls: tuple[Wall, ...]
) -> tuple[NDArray[np.float32], float]:
    """Where rays start, and the offset along the normals that does as well."""
    height, width = points.shape[:2]
    step = found.step
    # The point of the grid that stands for each pixel: the nearest.
    i = np.clip((np.arange(height) - found.rows[0] + step // 2) // step, 0, len(found.rows) - 1)
    j = np.clip(
        (np.arange(width) - found.columns[0] + step // 2) // step, 0, len(found.columns) - 1
    )
    near = np.ix_(i, j)
    normal, footprint = found.normals[near], found.footprint[near]
    own = np.isfinite(points).all(axis=-1)
    if step == 1:
        at = found.points.copy()
    else:
        origins, directions = found.rays.at(np.arange(height)[:, None], np.arange(width))
        distance = np.einsum("hwi,hwi->hw", points - origins, directions)
        on = extended(normal, found.points[near], found.distance[near], origins, directions)
        on = np.where(np.abs(on - distance) < 3 * footprint, np.fmin(on, distance), distance)
        at = origins + on[..., None] * directions
    lift = LIFT * footprint / max(step, 1) + LIFT_OF_NOISE * found.noise * found.distance[near]
    lift = np.where(np.isfinite(lift), lift, 0.0)
    start = at + np.where(np.isfinite(normal), lift[..., None] * normal, 0.0)
    # Nothing starts behind a wall; what shows the wall starts on it.
    for wall in walls:
        above = wall.above(start)
        least = LIFT * np.where(np.isfinite(footprint), footprint, 0.0) / max(step, 1)
        with np.errstate(invalid="ignore"):
            moved = np.where(wall.pixels | (above < least), least - above, 0.0)
        start = start + moved[..., None] * wall.normal
    start[~own] = np.nan
    raised = np.einsum("hwi,hwi->hw", start - points, normal)
    raised = raised[np.isfinite(raised)]
    offset = float(np.quantile(raised, SAFE)) if len(raised) else 0.0
    return start.astype(np.float32), max(offset, 0.0)
