"""Triangles of what is seen of things, of their backs, and of their sides.

A cell has the centres of four pixels that meet as its corners. Where they belong to one surface
it is two triangles. Else each pixel has its quarter of the cell, on its own tangent plane, so that
things reach as far as their pixels do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.transport.rays import Array
from pbrfit.transport.relief import Mask, Relief, extended

_CORNERS = ((0, 0), (0, 1), (1, 1), (1, 0))


def sheets(found: Relief, things: Mask, thickness: Array) -> tuple[Array, Array, Array]:
    """Triangles (F, 3, 3), (B, 3, 3) and (S, 3, 3) of fronts, backs and sides.

    Parameters
    ----------
    found
        Points and which belong together.
    things
        (h, w): which of them are things; others, such as walls, are left out.
    thickness
        (h, w): how far along the ray the back is, in the unit of depth.
    """
    grid = _padded(found, things, thickness)
    whole = grid.whole
    fronts, backs, sides = [], [], []
    # Whole cells.
    p = [grid.points[k][whole] for k in range(4)]
    back = [p[k] + (grid.thickness[k][whole])[:, None] * grid.directions[k][whole] for k in range(4)]
    # Cut along the shorter diagonal.
    other = np.linalg.norm(p[0] - p[2], axis=-1) > np.linalg.norm(p[1] - p[3], axis=-1)
    for corners, into in ((p, fronts), (back, backs)):
        a, b, c, d = (np.where(other[:, None], corners[(k + 1) % 4], corners[k]) for k in range(4))
        into += [np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]
    # Quarters of the others.
    cut = ~whole
    centre = grid.centres(cut)
    for k in range(4):
        here = grid.there[k][cut]
        if not here.any():
            continue
        after, before = grid.middle(k, (k + 1) % 4, cut), grid.middle(k, (k - 1) % 4, cut)
        quad = [grid.points[k][cut], after, centre[k], before]
        rays = [grid.directions[k][cut]] + [
            grid.between(cut, places)[1] for places in ((k, (k + 1) % 4), range(4), (k, (k - 1) % 4))
        ]
        deep = grid.thickness[k][cut][:, None]
        pushed = [q + deep * w for q, w in zip(quad, rays, strict=True)]
        for corners, into in ((quad, fronts), (pushed, backs)):
            a, b, c, d = (one[here] for one in corners)
            into += [np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]
        for neighbour, place in (((k + 1) % 4, 1), ((k - 1) % 4, 3)):
            # A side belongs to the nearer of two, or to who has no neighbour.
            nearer = grid.distance[neighbour][cut] < grid.distance[k][cut]
            mine = here & ~grid.linked(k, neighbour)[cut] & ~nearer
            a, b = quad[place][mine], quad[2][mine]
            c, d = pushed[2][mine], pushed[place][mine]
            sides += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    none = np.empty((0, 3, 3))
    return (
        np.concatenate([none, *fronts]),
        np.concatenate([none, *backs]),
        np.concatenate([none, *sides]),
    )


def widths(found: Relief, things: Mask, most: float) -> Array:
    """(h, w): how thick things are, in the unit of depth: as they are wide, at most `most`.

    A thing is a connected piece of one segment; its width is that of a rectangle which spreads as
    much across the rays, the shorter of both sides.
    """
    piece = _pieces_of_segments(found, things)
    width = np.zeros(things.shape)
    count = int(piece.max()) + 1
    if count == 0:
        return width
    of = piece[things]
    area = np.bincount(of, minlength=count)
    flat = found.points[things][:, :2]
    mean = np.stack([np.bincount(of, flat[:, i], count) / area for i in range(2)], axis=1)
    off = flat - mean[of]
    xx, yy, xy = (np.bincount(of, a * b, count) / area for a, b in (off.T[[0, 0]], off.T[[1, 1]], off.T))
    # The smaller eigenvalue; a rectangle's variance is width²/12, and each pixel has its own width.
    least = (xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    footprint = np.bincount(of, found.footprint[things], count) / area
    wide = np.sqrt(12 * np.maximum(least, 0.0) + footprint**2)
    width[things] = np.minimum(wide, most)[of]
    return width


def _pieces_of_segments(found: Relief, things: Mask) -> NDArray[np.int32]:
    """(h, w): numbers of connected pieces of one segment each, from 0; −1 elsewhere."""
    if not found.segments.any():
        return found.pieces(things)
    same = Relief(
        found.rows, found.columns, found.rays, found.origins, found.directions, found.distance,
        found.normals, found.segments,
        found.right & (found.segments[:, 1:] == found.segments[:, :-1]),
        found.down & (found.segments[1:] == found.segments[:-1]),
        found.noise,
    )  # fmt: skip
    return same.pieces(things)


class _padded:
    """Corners of all cells, clockwise from the upper left, each (h + 1, w + 1, ...).

    A ring of nothing surrounds the grid, so that things end at the picture's edge.
    """

    def __init__(self, found: Relief, things: Mask, thickness: Array) -> None:
        height, width = things.shape
        step = found.step
        rows = found.rows[0] + step * np.arange(-1, height + 1)
        columns = found.columns[0] + step * np.arange(-1, width + 1)
        origins, directions = found.rays.at(rows[:, None], columns)

        def corners(values: NDArray[np.generic], fill: float) -> list[Array]:
            around = ((1, 1), (1, 1), *((0, 0),) * (values.ndim - 2))
            padded = np.pad(values, around, constant_values=fill)
            return _four(padded)

        self.origins, self.directions = _four(origins), _four(directions)
        self.there = corners(things, 0)
        self.distance = corners(np.where(found.here, found.distance, np.inf), np.inf)
        self.points = corners(found.points, np.nan)
        self.normals = corners(found.normals, np.nan)
        self.thickness = corners(thickness, 0.0)
        right = found.right & things[:, 1:] & things[:, :-1]
        down = found.down & things[1:] & things[:-1]
        right, down = np.pad(right, 1), np.pad(down, 1)  # (h + 2, w + 1), (h + 1, w + 2)
        self.links = (right[:-1], down[:, 1:], right[1:], down[:, :-1])
        # One jump within a surface is where the jump begins: four pixels that hang together.
        count = np.sum(self.links, axis=0)
        self.whole = np.asarray(count >= 3)

    def linked(self, k: int, neighbour: int) -> Mask:
        """Whether two corners that are neighbours belong together."""
        return np.asarray(self.links[k if neighbour == (k + 1) % 4 else neighbour])

    def between(self, cut: Mask, places: tuple[int, int] | range) -> tuple[Array, Array]:
        """Rays through the middle of some corners, of some cells."""
        origin = np.mean([self.origins[k][cut] for k in places], axis=0)
        direction = np.mean([self.directions[k][cut] for k in places], axis=0)
        return origin, direction / np.linalg.norm(direction, axis=-1, keepdims=True)

    def _on_plane(self, k: int, cut: Mask, places: tuple[int, int] | range) -> Array:
        origin, direction = self.between(cut, places)
        distance = self.distance[k][cut]
        with np.errstate(invalid="ignore"):
            at = extended(self.normals[k][cut], self.points[k][cut], distance, origin, direction)
        return np.asarray(origin + at[:, None] * direction)

    def middle(self, k: int, neighbour: int, cut: Mask) -> Array:
        """Where the cell's edge changes from corner k to its neighbour, on the surface of k."""
        alone = self._on_plane(k, cut, (k, neighbour))
        both = (self.points[k][cut] + self.points[neighbour][cut]) / 2
        return np.where(self.linked(k, neighbour)[cut][:, None], both, alone)

    def centres(self, cut: Mask) -> list[Array]:
        """Middle of the cell on the surface of each corner; one for those that belong together."""
        alone = [self._on_plane(k, cut, range(4)) for k in range(4)]
        together = np.zeros((4, 4, int(cut.sum())), bool)
        for k in range(4):
            together[k, k] = True
            together[k, (k + 1) % 4] = together[(k + 1) % 4, k] = self.links[k][cut]
        for k in range(4):
            together |= together[:, [k]] & together[[k], :]
        found = []
        for k in range(4):
            total, count = np.zeros_like(alone[0]), np.zeros((len(alone[0]), 1))
            for other in range(4):
                joined = together[k, other][:, None]
                total += np.where(joined, alone[other], 0.0)
                count += joined
            found.append(total / count)
        return found


def _four(padded: NDArray[np.generic]) -> list[Array]:
    height, width = padded.shape[:2]
    return [padded[i : height - 1 + i, j : width - 1 + j] for i, j in _CORNERS]  # type: ignore[misc]
