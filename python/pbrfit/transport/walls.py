"""Walls, floor and ceiling: planes that have nearly all the rest of a scene in front of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pbrfit.transport.relief import Relief, pairs, pieces
from pbrfit.values.arrays import Array, Mask

FLAT, MOST_SPREAD = 0.7, 0.08
"""Share of a region that has the normal of its plane, at least, and root mean square distance of
these from the plane in median depths, at most, for the region to be flat."""
PARALLEL = np.cos(np.radians(12.0))
"""Least cosine between normals of parallel planes, and of neighbours that are of one region."""
MOST_BEHIND = 0.05
"""Share of all points that may lie behind a wall: windows, doors, errors of depth."""
MOST_BEHIND_OF_OWN = 0.2
"""And that number over that of the points on it: a small plane is no wall on weak grounds."""
BEHIND, BEHIND_BY_RESIDUALS = 0.015, 2.0
"""How far behind a plane a point is before it counts, in median depths, besides noise of depth; and
in root mean squares of what the plane leaves of its own points."""
SLIVER, FEWEST = 0.002, 8
"""Least share of the picture, and number of points: side walls are seen from the side."""
IN_PLANE = 0.02
"""How far off a plane its own points may be, in median depths, besides noise of depth."""
SAME_PLANE = 0.015
"""Distance up to which parallel planes are one, in median depths."""
RUG = 0.1
"""A plane in front of a parallel wall by less lies or hangs on it, in median depths (0.3 m)."""
AGREES, UPRIGHT = np.cos(np.radians(25.0)), np.sin(np.radians(25.0))
"""Least cosine between the normal of a wall and those of its points, and of a floor's and up;
greatest cosine between an upright wall's and up."""
MOST_WALLS = 12
PICTURE_UP = np.cos(np.radians(70.0))
"""Least Y of a floor's normal: the camera looks down at most this steeply."""


@dataclass(frozen=True, eq=False)
class Wall:
    """A plane that bounds a scene: a wall, the floor, the ceiling."""

    normal: Array
    """(3,) unit, camera space, into the room."""
    offset: float
    """normal·x of its points, in the unit of depth; negative, because the camera is in front."""
    corners: Array
    """(4, 3): rectangle around what is seen of it, sides level and upright."""
    pixels: Mask
    """(H, W): where it is seen."""
    level: int
    """1 = floor, −1 = ceiling, 0 = anything else."""

    def above(self, points: Array) -> Array:
        """Distance (...) of points (..., 3) from the plane, positive in front of it."""
        return np.asarray(points @ self.normal - self.offset)


@dataclass(frozen=True)
class Plane:
    """A plane, and its share of the picture."""

    normal: Array
    offset: float
    share: float
    spread: float
    """Root mean square distance of its points from it, in the unit of depth."""


def find_walls(found: Relief, points: Array, normals: Array, mask: Mask) -> tuple[Wall, ...]:
    """Find walls, floor and ceiling, the largest first, in a surface and what it was made of."""
    here = found.here
    seen, facing = found.points[here], found.normals[here]
    scale = float(np.median(-seen[:, 2]))
    slack = found.noise * scale
    # Regions are grown over jumpless neighbours of about one normal.
    alike = (np.einsum("hwi,hwi->hw", a, b) > PARALLEL for a, b in pairs(found.normals))
    links = (link & one for link, one in zip((found.right, found.down), alike, strict=True))
    regions = pieces(here, *links)[here]
    sizes = np.bincount(regions)
    large = np.flatnonzero(sizes >= max(SLIVER * len(seen), FEWEST))
    fitted = (_fitted(seen, facing, regions == one, scale, slack) for one in large)
    planes = without_rugs([one for one in fitted if one is not None], scale)[:MOST_WALLS]
    up, floor = upwards([plane.normal for plane in planes])
    walls = []
    for i, plane in enumerate(planes):
        level = 1 if i == floor else -1 if plane.normal @ up < -AGREES else 0
        near = np.abs(points @ plane.normal - plane.offset) < _within(plane.spread, scale, slack)
        pixels = near & (~mask | ~(normals @ plane.normal <= AGREES))
        if pixels.any():
            corners = _rectangle(points[pixels], plane, up)
            walls.append(Wall(plane.normal, plane.offset, corners, pixels, level))
    return tuple(walls)


def _fitted(seen: Array, facing: Array, mine: Mask, scale: float, slack: float) -> Plane | None:
    """The plane of a region of points; None where that is not flat, or no wall."""
    points, normals = seen[mine], facing[mine]
    normal = _unit(np.median(normals, axis=0))
    offset = float(np.median(points @ normal))
    for _ in range(4):
        agree = normals @ normal > AGREES
        off = np.abs(points @ normal - offset)
        near = agree & (off < IN_PLANE * scale + 3 * slack + 2 * np.median(off))
        if near.sum() < FEWEST or agree.mean() < FLAT:
            return None
        normal, offset = _least_squares(points[near], _unit(normals[near].mean(axis=0)))
    spread = float(np.sqrt(np.mean((points[near] @ normal - offset) ** 2)))
    if spread >= MOST_SPREAD * scale + 3 * slack or offset >= 0:
        return None
    off = seen @ normal - offset
    share = float(
        ((np.abs(off) < _within(spread, scale, slack)) & (facing @ normal > AGREES)).mean()
    )
    behind = off < -(BEHIND * scale + 3 * slack + BEHIND_BY_RESIDUALS * spread)
    if behind.mean() > min(MOST_BEHIND, MOST_BEHIND_OF_OWN * share):
        return None
    return Plane(normal, offset, share, spread)


def _within(spread: float, scale: float, slack: float) -> float:
    """How far off a plane its points may be, in the unit of depth."""
    return IN_PLANE * scale + 2 * slack + spread


def without_rugs(planes: Sequence[Plane], scale: float) -> list[Plane]:
    """Planes that lie on no other, the largest first; and of those that are one the largest."""
    kept: list[Plane] = []
    for plane in sorted(planes, key=lambda one: -one.share):
        apart = {
            i: _apart(plane, other)  # positive: in front of the other
            for i, other in enumerate(kept)
            if other.normal @ plane.normal > PARALLEL
        }
        if any(-SAME_PLANE * scale <= d < RUG * scale for d in apart.values()):
            continue
        rugs = {i for i, d in apart.items() if -RUG * scale < d < 0}
        kept = [other for i, other in enumerate(kept) if i not in rugs] + [plane]
    return kept


def upwards(normals: Sequence[Array]) -> tuple[Array, int]:
    """(3,) unit vector up, and which normal is the floor's, −1 if none.

    Up is the floor's normal; without a floor it is level with the walls, as near to the camera's Y
    as that can be.
    """
    y = np.array([0.0, 1.0, 0.0])
    rising = [float(normal[1]) for normal in normals]
    if rising and max(rising) > PICTURE_UP:
        floor = int(np.argmax(rising))
        return normals[floor], floor
    upright = [normal for normal in normals if abs(normal[1]) < 0.6]
    if upright:
        # The direction that is most nearly at right angles to them all, held to Y a little.
        matrix = sum((np.outer(n, n) for n in upright), np.zeros((3, 3))) - 0.1 * np.outer(y, y)
        up = np.linalg.eigh(matrix)[1][:, 0]
        return up * np.sign(up[1]), -1
    return y, -1


def _rectangle(points: Array, plane: Plane, up: Array) -> Array:
    """(4, 3) corners around points (P, 3) of a plane; one in a thousand may stick out."""
    level = np.cross(up, plane.normal)
    if np.linalg.norm(level) < 0.3:  # floor or ceiling: the camera's right and ahead
        level = np.array([1.0, 0.0, 0.0]) - plane.normal[0] * plane.normal
    level = _unit(level)
    rise = np.cross(plane.normal, level)
    (a, b), (c, d) = (np.quantile(points @ axis, [5e-4, 1 - 5e-4]) for axis in (level, rise))
    middle = plane.offset * plane.normal
    return np.array([middle + s * level + t * rise for s, t in ((a, c), (b, c), (b, d), (a, d))])


def _least_squares(points: Array, mean_normal: Array) -> tuple[Array, float]:
    """Plane through points whose normal is theirs, unless that is far from the mean normal."""
    off = points - points.mean(axis=0)
    normal = np.linalg.eigh(off.T @ off)[1][:, 0]
    normal = normal * np.sign(normal @ mean_normal)
    if normal @ mean_normal < np.cos(np.radians(6.0)):
        normal = mean_normal
    return normal, float(np.median(points @ normal))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _apart(plane: Plane, other: Plane) -> float:
    # Where the view meets them: planes that are not quite parallel are compared before the camera.
    normal = _unit(plane.normal + other.normal)
    return float(plane.offset / (plane.normal @ normal) - other.offset / (other.normal @ normal))
