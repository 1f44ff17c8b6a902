"""Walls, floor and ceiling: planes that have nearly all the rest of a scene in front of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.transport.rays import Array
from pbrfit.transport.relief import Mask, Relief, relief

MOST_POINTS = 10_000
"""Points of the grid that walls are searched in."""
FLAT, MOST_SPREAD = 0.7, 0.08
"""Share of a segment that has the normal of its plane, at least, and root mean square distance of
these from the plane in median depths, at most, for the segment to be flat."""
GROWN = np.cos(np.radians(12.0))
"""Least cosine between normals of neighbours that are grown to one region."""
MOST_BEHIND = 0.05
"""Share of all points that may lie behind a wall: windows, doors, errors of depth."""
BEHIND, BEHIND_BY_RESIDUALS = 0.015, 2.0
"""How far behind a plane a point is before it counts, in median depths, besides noise of depth; and
in root mean squares of what the plane leaves of its own points."""
MOST_BEHIND_OF_OWN = 0.2
"""And that number over that of the points on it: a small plane is no wall on weak grounds."""
LEAST_SHARE = 0.02
"""Least share of the picture that a wall covers, unless it is square to a larger one."""
SLIVER, FEWEST = 0.002, 8
"""Least share, and number of points, of one that is: side walls are seen from the side."""
SQUARE = np.sin(np.radians(8.0))
"""Greatest cosine between normals of planes that are square to each other."""
IN_PLANE = 0.02
"""How far off a plane its own points may be, in median depths, besides noise of depth."""
SAME_PLANE = 0.015
"""Distance up to which parallel planes are one, in median depths."""
RUG = 0.1
"""A plane in front of a parallel wall by less lies or hangs on it, in median depths (0.3 m)."""
PARALLEL = np.cos(np.radians(12.0))
"""Least cosine between normals of parallel planes."""
LIKE = np.cos(np.radians(30.0))
"""Least cosine between normals of planes of which one is a wrong view of the other."""
AGREES = np.cos(np.radians(25.0))
"""Least cosine between the normal of a wall and those of its points."""
MOST_WALLS = 12
"""Walls at most."""
TRIES = 600
"""Planes tried for each wall that no segment shows."""
UPRIGHT = np.sin(np.radians(25.0))
"""Greatest cosine between the normal of an upright wall and up."""
LEVEL = np.cos(np.radians(25.0))
"""Least cosine between the normal of a floor and up."""
PICTURE_UP = np.cos(np.radians(70.0))
"""Least Y of a floor's normal: the camera looks down at most this steeply."""


@dataclass(frozen=True, eq=False)
class Wall:
    """A plane that bounds a scene: a wall, the floor, the ceiling.

    Attributes
    ----------
    normal
        (3,) unit, camera space, into the room.
    offset
        normal·x of its points, in the unit of depth; negative, because the camera is in front.
    corners
        (4, 3): rectangle around what is seen of it, sides level and upright.
    segment
        Id of the segment that shows it; 0 where it was found without one.
    pixels
        (H, W): where it is seen.
    level
        1 = floor, −1 = ceiling, 0 = anything else.
    """

    normal: Array
    offset: float
    corners: Array
    segment: int
    pixels: Mask
    level: int

    def above(self, points: Array) -> Array:
        """Distance (...) of points (..., 3) from the plane, positive in front of it."""
        return np.asarray(points @ self.normal - self.offset)


@dataclass(frozen=True)
class _Plane:
    normal: Array
    offset: float
    segment: int
    share: float
    spread: float
    """Root mean square distance of its points from it, in the unit of depth."""


def find_walls(
    points: Array, normals: Array, mask: Mask, segments: NDArray[np.integer] | None
) -> tuple[Wall, ...]:
    """Find walls, floor and ceiling, the largest first.

    Parameters
    ----------
    points
        (H, W, 3) camera space, NaN where nothing is.
    normals
        (H, W, 3) unit normals; used in the mask.
    mask
        (H, W): where normals hold.
    segments
        (H, W) ids, 0 = unclassified; None = unknown, then planes are searched among the points.

    Raises
    ------
    InputError
        If there are too few points.
    """
    coarse = relief(points, normals, mask, segments, MOST_POINTS)
    here = coarse.here
    seen, facing, ids = coarse.points[here], coarse.normals[here], coarse.segments[here]
    scale = float(np.median(-seen[:, 2]))
    slack = coarse.noise * scale
    planes = list(_of_segments(seen, facing, ids, scale, slack))
    grown = _regions(coarse)[here]
    planes += (replace(p, segment=0) for p in _of_segments(seen, facing, grown, scale, slack))
    planes = _without_rugs(planes, scale)
    planes = _without_rugs([*planes, *_alone(coarse, planes, scale, slack)], scale)
    planes = _square(planes)[:MOST_WALLS]
    up, floor = upwards([plane.normal for plane in planes])
    found = []
    for i, plane in enumerate(planes):
        level = 1 if i == floor else -1 if plane.normal @ up < -LEVEL else 0
        pixels = _pixels(points, normals, mask, segments, plane, scale, slack)
        on = points[pixels]
        if not len(on):
            continue
        corners = rectangle(
            on - np.outer(on @ plane.normal - plane.offset, plane.normal), plane, up
        )
        found.append(Wall(plane.normal, plane.offset, corners, plane.segment, pixels, level))
    return tuple(found)


def upwards(normals: list[Array]) -> tuple[Array, int]:
    """(3,) unit vector up, and which normal is the floor's, −1 if none.

    Up is the floor's normal; without a floor it is level with the walls, as near to the camera's Y
    as that can be.
    """
    y = np.array([0.0, 1.0, 0.0])
    # The floor is the plane most upward among those that other walls stand on.
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


def axes(normal: Array, up: Array) -> tuple[Array, Array]:
    """Level and rising unit vectors in a plane: right and up as seen from in front of it."""
    level = np.cross(up, normal)
    if np.linalg.norm(level) < 0.3:  # floor or ceiling: the camera's right and ahead
        level = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    level /= np.linalg.norm(level)
    return level, np.cross(normal, level)


def rectangle(on: Array, plane: _Plane | Wall, up: Array) -> Array:
    """(4, 3) corners around points (P, 3) of a plane; one in a thousand may stick out."""
    level, rise = axes(plane.normal, up)
    (a, b), (c, d) = (np.quantile(on @ axis, [5e-4, 1 - 5e-4]) for axis in (level, rise))
    middle = plane.offset * plane.normal
    return np.array([middle + s * level + t * rise for s, t in ((a, c), (b, c), (b, d), (a, d))])


def _of_segments(
    seen: Array, facing: Array, ids: NDArray[np.integer], scale: float, slack: float
) -> Iterator[_Plane]:
    for one in np.unique(ids[ids != 0]):
        mine = ids == one
        if mine.mean() < SLIVER or mine.sum() < FEWEST:
            continue
        plane = _fitted(seen[mine], facing[mine], int(one), scale, slack)
        if plane is None:
            continue
        on = _on(plane, seen, facing, scale, slack)
        if _is_wall(plane, on, seen, scale, slack):
            yield replace(plane, share=float(on.mean()))


def _fitted(seen: Array, facing: Array, one: int, scale: float, slack: float) -> _Plane | None:
    """Plane of a segment, or None where it is not flat."""
    normal = _unit(np.median(facing, axis=0))
    agree = facing @ normal > AGREES
    if agree.mean() < FLAT:
        return None
    normal = _unit(facing[agree].mean(axis=0))
    offset = float(np.median(seen @ normal))
    for _ in range(3):
        agree = facing @ normal > AGREES
        off = np.abs(seen @ normal - offset)
        near = agree & (off < IN_PLANE * scale + 3 * slack + 2 * np.median(off))
        if near.sum() < FEWEST:
            return None
        normal, offset = _least_squares(seen[near], _unit(facing[near].mean(axis=0)))
    agree = facing @ normal > AGREES
    spread = float(np.sqrt(np.mean((seen[near] @ normal - offset) ** 2)))
    flat = agree.mean() >= FLAT and spread < MOST_SPREAD * scale + 3 * slack
    return _Plane(normal, offset, one, 0.0, spread) if flat and offset < 0 else None


def _least_squares(seen: Array, mean_normal: Array) -> tuple[Array, float]:
    """Plane through points whose normal is theirs, unless that is far from the mean normal."""
    middle = seen.mean(axis=0)
    normal = np.linalg.eigh((seen - middle).T @ (seen - middle))[1][:, 0]
    normal = normal * np.sign(normal @ mean_normal)
    if normal @ mean_normal < np.cos(np.radians(6.0)):
        normal = mean_normal
    return normal, float(np.median(seen @ normal))


def _unit(vector: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return np.asarray(vector / np.linalg.norm(vector))


def _is_wall(plane: _Plane, on: Mask, seen: Array, scale: float, slack: float) -> bool:
    off = seen @ plane.normal - plane.offset
    tolerance = _behind(scale, slack) + BEHIND_BY_RESIDUALS * plane.spread
    behind = float((off < -tolerance).mean())
    most = min(MOST_BEHIND, MOST_BEHIND_OF_OWN * float(on.mean()))
    return bool(plane.offset < 0 and behind <= most)


def _behind(scale: float, slack: float) -> float:
    return BEHIND * scale + 3 * slack


def _on(plane: _Plane, seen: Array, facing: Array, scale: float, slack: float) -> Mask:
    near = np.abs(seen @ plane.normal - plane.offset) < _within(plane, scale, slack)
    return np.asarray(near & (facing @ plane.normal > AGREES))


def _within(plane: _Plane, scale: float, slack: float) -> float:
    """How far off a plane its points may be, in the unit of depth."""
    return IN_PLANE * scale + 2 * slack + plane.spread


def _without_rugs(planes: list[_Plane], scale: float) -> list[_Plane]:
    """Drop planes that lie on another, and all but the largest of those that are one."""
    kept: list[_Plane] = []
    for plane in sorted(planes, key=lambda one: -one.share):
        beside = [o for o in kept if o.normal @ plane.normal > PARALLEL]
        apart = [_apart(plane, other) for other in beside]  # positive: in front of the other
        if any(-SAME_PLANE * scale <= d < RUG * scale for d in apart):
            continue
        lie_on_it = [o for o, d in zip(beside, apart, strict=True) if -RUG * scale < d < 0]
        kept = [o for o in kept if not any(o is x for x in lie_on_it)] + [plane]
    return kept


def _apart(plane: _Plane, other: _Plane) -> float:
    normal = _unit(plane.normal + other.normal)
    # Where the view meets them: planes that are not quite parallel are compared before the camera.
    return float(plane.offset / (plane.normal @ normal) - other.offset / (other.normal @ normal))


def _square(planes: list[_Plane]) -> list[_Plane]:
    """Drop planes that face nearly as a larger one does, and small ones that are square to none.

    The largest come first.
    """
    sorted_planes = sorted(planes, key=lambda plane: -plane.share)
    planes = []
    for plane in sorted_planes:
        if all(not PARALLEL > plane.normal @ other.normal > LIKE for other in planes):
            planes.append(plane)
    large = [plane for plane in planes if plane.share >= LEAST_SHARE]
    return large + [
        plane
        for plane in planes
        if plane.share < LEAST_SHARE
        and any(abs(plane.normal @ other.normal) < SQUARE for other in large)
    ]


def _alone(coarse: Relief, known: list[_Plane], scale: float, slack: float) -> list[_Plane]:
    """Walls that no segment shows: planes through points, with the normals of many others."""
    here = coarse.here
    seen, facing = coarse.points[here], coarse.normals[here]
    free = np.ones(len(seen), bool)
    for plane in known:
        free &= ~_on(plane, seen, facing, scale, slack)
    rng = np.random.default_rng(0)
    some = np.arange(0, len(seen), max(1, len(seen) // 4000))
    found: list[_Plane] = []
    while len(found) < MOST_WALLS and free.sum() >= FEWEST:
        tried = rng.permutation(np.flatnonzero(free))[:TRIES]
        normals = facing[tried]
        offsets = np.einsum("pi,pi->p", seen[tried], normals)
        off = seen[some] @ normals.T - offsets
        on = (np.abs(off) < IN_PLANE * scale + 2 * slack) & (facing[some] @ normals.T > AGREES)
        count = (on & free[some][:, None]).sum(axis=0)
        # One point's normal is rough: twice as many may be behind as of the plane of them all.
        behind = (off < -2 * _behind(scale, slack)).sum(axis=0)
        allowed = np.minimum(MOST_BEHIND * len(some), MOST_BEHIND_OF_OWN * count)
        count[(behind > 2 * allowed) | (offsets >= 0)] = 0
        best = int(count.argmax())
        if count[best] == 0:
            break
        plane = _Plane(normals[best], float(offsets[best]), 0, 0.0, 0.0)
        for _ in range(3):
            mine = _on(plane, seen, facing, scale, slack) & free
            if mine.sum() < FEWEST:
                break
            normal, offset = _least_squares(seen[mine], _unit(facing[mine].mean(axis=0)))
            spread = float(np.sqrt(np.mean((seen[mine] @ normal - offset) ** 2)))
            plane = _Plane(normal, offset, 0, 0.0, spread)
        mine = _on(plane, seen, facing, scale, slack) & free
        share = _largest_piece(coarse, np.flatnonzero(mine))
        enough = share >= SLIVER and mine.sum() >= FEWEST
        if enough and _is_wall(plane, mine, seen, scale, slack):
            found.append(replace(plane, share=float(mine.mean())))
        free &= ~mine
        free[tried[best]] = False
    return found


def _regions(coarse: Relief) -> NDArray[np.int32]:
    """(h, w): numbers from 1 of regions grown over jumpless neighbours of about one normal."""
    n = coarse.normals
    with np.errstate(invalid="ignore"):
        right = coarse.right & (np.einsum("hwi,hwi->hw", n[:, 1:], n[:, :-1]) > GROWN)
        down = coarse.down & (np.einsum("hwi,hwi->hw", n[1:], n[:-1]) > GROWN)
    return replace(coarse, right=right, down=down).pieces(coarse.here) + 1


def _largest_piece(coarse: Relief, taken: NDArray[np.intp]) -> float:
    """Share of the picture of the largest connected piece of some of its points."""
    from scipy import ndimage

    there = np.zeros(coarse.here.shape, bool)
    there.flat[np.flatnonzero(coarse.here)[taken]] = True
    labels, count = ndimage.label(there, structure=np.ones((3, 3)))
    return float(np.bincount(labels.ravel())[1:].max() / coarse.here.sum()) if count else 0.0


def _pixels(
    points: Array,
    normals: Array,
    mask: Mask,
    segments: NDArray[np.integer] | None,
    plane: _Plane,
    scale: float,
    slack: float,
) -> Mask:
    """(H, W): pixels that show a plane; its own segment may be further off."""
    with np.errstate(invalid="ignore"):
        off = np.abs(points @ plane.normal - plane.offset)
        agrees = ~mask | ~(normals @ plane.normal <= AGREES)
        near = off < _within(plane, scale, slack)
        if segments is not None and plane.segment:
            near |= (segments == plane.segment) & (off < 2 * RUG * scale)
    return np.asarray(near & agrees)
