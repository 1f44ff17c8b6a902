"""Triangles of what is seen of things, of their backs, and of their sides.

Each pixel of a thing is a quadrilateral, whose corners are where four pixels meet: on its tangent
plane, so that things reach as far as their pixels do, and where the four belong together no nearer
than they are in the mean.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.transport.relief import Relief, pairs, pieces, rays
from pbrfit.values.arrays import Array, Mask

_CORNERS = ((0, 0), (0, 1), (1, 1), (1, 0))
"""Rows and columns of a pixel's corners, clockwise from the upper left."""


def sheets(found: Relief, things: Mask, thickness: Array) -> tuple[Array, Array, Array]:
    """Triangles (F, 3, 3), (B, 3, 3) and (S, 3, 3) of fronts, backs and sides.

    `things` (h, w) says which points are of things; others, such as walls, are left out. Their
    `thickness` (h, w) is how far along the ray the back is, in the unit of depth.
    """
    height, width = things.shape
    rows = found.rows[0] + found.step * (np.arange(height + 1) - 0.5)
    columns = found.columns[0] + found.step * (np.arange(width + 1) - 0.5)
    origins, directions = rays(found.shape, found.fov, rows, columns)
    right = np.pad(found.right & things[:, 1:] & things[:, :-1], ((0, 0), (1, 1)))
    down = np.pad(found.down & things[1:] & things[:-1], ((1, 1), (0, 0)))
    far = np.pad(np.where(found.here, found.distance, np.inf), 1, constant_values=np.inf)
    # Four pixels belong together from three links on.
    count = np.pad(right, ((1, 0), (0, 0))) + np.pad(right, ((0, 1), (0, 0))).astype(int)
    count += np.pad(down, ((0, 0), (1, 0))) + np.pad(down, ((0, 0), (0, 1))).astype(int)
    at = [(slice(i, height + i), slice(j, width + j)) for i, j in _CORNERS]
    around = (far[i : height + 1 + i, j : width + 1 + j] for i, j in _CORNERS)
    middle = np.where(count >= 3, sum(around) / 4, -np.inf)
    starts, ways, least = (
        np.stack([of[one][things] for one in at], axis=1) for of in (origins, directions, middle)
    )
    normals = found.tangents[things][:, None]
    ahead = np.sum(normals * (found.points[things][:, None] - starts), axis=-1)
    distance = np.maximum(ahead / np.sum(normals * ways, axis=-1), least)
    front = starts + distance[..., None] * ways
    back = front + thickness[things][:, None, None] * ways
    # A side belongs to the nearer of two neighbours, or to who has none.
    sides = []
    links = down[:-1], right[:, 1:], down[1:], right[:, :-1]
    beside = far[:-2, 1:-1], far[1:-1, 2:], far[2:, 1:-1], far[1:-1, :-2]
    for k, (linked, distance) in enumerate(zip(links, beside, strict=True)):
        mine = (~linked & (distance >= far[1:-1, 1:-1]))[things]
        edge = [k, (k + 1) % 4]
        sides.append(np.concatenate([front[mine][:, edge], back[mine][:, edge[::-1]]], axis=1))
    middle = found.points[things]
    behind = middle + thickness[things][:, None] * found.directions[things]
    return _fans(middle, front), _fans(behind, back), triangles(np.concatenate(sides))


def triangles(quadrilaterals: Array) -> Array:
    """(2Q, 3, 3) halves of (Q, 4, 3)."""
    return quadrilaterals[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)


def _fans(middle: Array, corners: Array) -> Array:
    """(4P, 3, 3): from the middle of pixels (P, 3) to each two of their corners (P, 4, 3)."""
    middle = np.broadcast_to(middle[:, None], corners.shape)
    return np.stack([middle, corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 3, 3)


def widths(found: Relief, things: Mask, segments: NDArray[np.integer] | None, most: float) -> Array:
    """(h, w): how thick things are, in the unit of depth: as they are wide, at most `most`.

    A thing is a connected piece of one segment; its width is that of a rectangle which spreads as
    much across the rays, the shorter of both sides.
    """
    right, down = found.right, found.down
    if segments is not None:
        (a, b), (c, d) = pairs(segments[np.ix_(found.rows, found.columns)])
        right, down = right & (a == b), down & (c == d)
    of = pieces(things, right, down)[things]
    count = np.bincount(of)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(of, values) / count)

    off = found.points[things][:, :2].T
    off = np.stack([axis - mean(axis)[of] for axis in off])
    xx, yy, xy = mean(off[0] ** 2), mean(off[1] ** 2), mean(off[0] * off[1])
    # The smaller eigenvalue; a rectangle's variance is width²/12, and each pixel has its own width.
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    wide = np.sqrt(12 * np.maximum(least, 0.0) + mean(found.footprint[things]) ** 2)
    thickness = np.zeros(things.shape)
    thickness[things] = np.minimum(wide, most)[of]
    return thickness
