"""The surface that pixels show: which neighbours belong together, and points without their noise.

Two neighbours p and q have tangent planes. The plane of p says where the ray of q would meet it,
and so the step t_q − t_p of the distances from one to the other; the plane of q says it, too. On a
smooth surface both are right. Where two planes meet in an edge between the pixels, the step is
between what both say. A jump is where it is neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError, poisson_heights
from pbrfit.model.geometry import unit
from pbrfit.values.arrays import Array, Mask

Sides = tuple[NDArray[Any], NDArray[Any]]

LEAST_FACING = 0.2
"""Least −n·ray of a tangent plane: seen from the side, normals tell little of distances."""
TOLERANCE = 0.75
"""Least gap between tangent planes that is a jump, in the neighbours' distance across."""
SIGMAS = 3.0
"""Standard deviations of the noise of depth that a gap may have besides."""
NORMAL_ERROR = 0.1
"""Standard deviation of a slope that normals tell, in radians."""
LEAST_NOISE = 1e-3
"""Relative noise of depth that is assumed at least."""
SOLVED = 1e-3
"""Standard deviations that a point without its noise is off by rounding of the solution."""


@dataclass(frozen=True)
class Relief:
    """The points of a picture's pixels, in a grid of every `step`-th of its rows and columns."""

    shape: tuple[int, int]
    fov: float
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    step: int
    origins: Array
    directions: Array
    """(h, w, 3) of the pixels' rays."""
    distance: Array
    """(h, w) along the rays; NaN where there is no point."""
    normals: Array
    """(h, w, 3) unit normals; NaN where there is no point."""
    right: Mask
    down: Mask
    """(h, w − 1) and (h − 1, w): neighbours that belong to one surface."""
    noise: float
    """Relative standard deviation of the distances."""

    @property
    def points(self) -> Array:
        """(h, w, 3); NaN where there is none."""
        return self.origins + self.distance[..., None] * self.directions

    @property
    def here(self) -> Mask:
        """(h, w): where there is a point."""
        return np.isfinite(self.distance)

    @property
    def tangents(self) -> Array:
        """(h, w, 3) unit normals of tangent planes: tilted so that none is seen from the side."""
        away = np.maximum(_dot(self.normals, self.directions) + LEAST_FACING, 0.0)
        tilted = self.normals - away[..., None] * self.directions
        return unit(tilted)

    @property
    def footprint(self) -> Array:
        """(h, w): distance across the rays from one point to the next."""
        apart = 2 * self.step / self.shape[1]
        if self.fov == 0:
            return np.where(self.here, apart, np.nan)
        apart *= math.tan(math.radians(self.fov) / 2)
        return self.distance * apart * np.abs(self.directions[..., 2])


def rays(
    shape: tuple[int, int], fov: float, rows: NDArray[Any], columns: NDArray[Any]
) -> tuple[Array, Array]:
    """Origins and unit directions (h, w, 3) of rays through rows (h,) and columns (w,).

    These count pixels' centres, and may lie between them.
    """
    height, width = shape
    x, y = np.meshgrid((2 * columns + 1 - width) / width, (height - 1 - 2 * rows) / width)
    flat = np.stack([x, y, np.zeros_like(x)], axis=-1)
    ahead = np.broadcast_to([0.0, 0.0, -1.0], flat.shape)
    if fov == 0:
        return flat, ahead
    directions = math.tan(math.radians(fov) / 2) * flat + ahead
    return np.zeros_like(flat), unit(directions)


def relief(points: Array, normals: Array, mask: Mask, fov: float, most: int) -> Relief:
    """Find surface and jumps; InputError if there is no point.

    `points` (H, W, 3) are as of `pbrfit.model.geometry.positions`, NaN where nothing is known to
    be. Unit `normals` (H, W, 3) hold in the mask (H, W); others are those of differences of points.
    The field of view is horizontal, in degrees. At most `most` points are kept: of larger pictures
    every second, third, ... pixel.
    """
    height, width = mask.shape
    step = max(1, math.ceil(math.sqrt(mask.size / most)))
    rows, columns = (np.arange(min(step // 2, n - 1), n, step) for n in (height, width))
    grid = np.ix_(rows, columns)
    origins, directions = rays((height, width), fov, rows, columns)
    distance = _dot(points[grid] - origins, directions)
    if not np.isfinite(distance).any():
        raise InputError("depth: expected some pixels that are known, found none")
    facing = _normals(points[grid], normals[grid], mask[grid], directions)
    none = np.zeros(distance.shape, bool)
    found = Relief(
        *((height, width), fov, rows, columns, step, origins, directions, distance, facing),
        *(none[:, 1:], none[1:], 0.0),
    )
    found = _linked(found, distance)
    return _linked(found, _smoothed(found))


def pieces(of: Mask, right: Mask, down: Mask) -> NDArray[np.int32]:
    """(h, w): numbers of pieces connected by links to the right and below, from 0; −1 outside."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    number = np.arange(of.size).reshape(of.shape)
    right, down = right & of[:, 1:] & of[:, :-1], down & of[1:] & of[:-1]
    ends = np.concatenate([number[:, :-1][right], number[:-1][down]])
    others = np.concatenate([number[:, 1:][right], number[1:][down]])
    graph = coo_array((np.ones(len(ends), bool), (ends, others)), shape=(of.size, of.size))
    labels = connected_components(graph, directed=False)[1].reshape(of.shape)
    found = np.full(of.shape, -1, np.int32)
    found[of] = np.unique(labels[of], return_inverse=True)[1]
    return found


def pairs(a: NDArray[Any]) -> tuple[Sides, Sides]:
    """Left and right, upper and lower neighbours of an array (h, w, ...)."""
    return (a[:, :-1], a[:, 1:]), (a[:-1], a[1:])


def _gaps(found: Relief) -> list[tuple[Array, Array, Array, Array]]:
    """For neighbours to the right and below: what p's and q's plane say of the step, less the step.

    Also the distance across the rays, and the steeper slope.
    """
    gaps = []
    fields = (pairs(a) for a in (found.points, found.directions, found.tangents))
    for (p, q), (at_p, at_q), (of_p, of_q) in zip(*fields, strict=True):
        d = q - p
        by_p, by_q = -_dot(of_p, d) / _dot(of_p, at_q), -_dot(of_q, d) / _dot(of_q, at_p)
        middle = (at_p + at_q) / 2
        across = np.linalg.norm(d - _dot(d, middle)[..., None] * middle, axis=-1)
        slope = 1 / -np.maximum(_dot(of_p, at_p), _dot(of_q, at_q))
        gaps.append((by_p, by_q, across, slope))
    return gaps


def _linked(found: Relief, distance: Array) -> Relief:
    """The same at other distances, with their noise, and the links that they have."""
    found = replace(found, distance=distance)
    gaps, sides = _gaps(found), pairs(distance)
    # Residuals of steps, of which each has the noise of two distances.
    left = [
        ((a + b) / 2 / np.minimum(*t)).ravel() for (a, b, _, _), t in zip(gaps, sides, strict=True)
    ]
    told = np.abs(np.concatenate(left))
    told = told[np.isfinite(told)]
    noise = float(np.median(told) / 0.6745 / np.sqrt(2)) if len(told) else 0.0
    links = []
    for (a, b, across, _), (near, far) in zip(gaps, sides, strict=True):
        gap = np.where(a * b <= 0, 0.0, np.minimum(np.abs(a), np.abs(b)))
        allowed = TOLERANCE * across + SIGMAS * noise * np.minimum(near, far)
        links.append(np.isfinite(a) & (gap <= allowed))
    return replace(found, right=links[0], down=links[1], noise=noise)


def _smoothed(found: Relief) -> Array:
    """Distances near to the measured ones whose steps are those that the normals tell.

    Least squares: Σ (t − measured)² / (noise · measured)² + Σ (t_q − t_p − step)² / σ² over linked
    neighbours. With s the slope 1/|n·ray|, an error of the normal moves the step by s² times the
    way across.
    """
    here, unit = found.here, float(np.nanmedian(found.distance))
    measured = np.where(here, found.distance / unit, 0.0)
    held = np.ones(here.shape)
    held[here] = 1 / np.square(max(found.noise, LEAST_NOISE) * measured[here])
    right, weights = held * measured, np.zeros((2, *here.shape))
    fields = pairs(found.distance), _gaps(found), (found.right, found.down), pairs(right)
    for weight, (near, far), (a, b, across, slope), linked, (to_near, to_far) in zip(
        weights, *fields, strict=True
    ):
        precision = np.square(unit / (NORMAL_ERROR * across * slope**2)[linked])
        flow = precision * (far - near + (a + b) / 2)[linked] / unit
        weight[: linked.shape[0], : linked.shape[1]][linked] = precision
        to_near[linked] -= flow
        to_far[linked] += flow
    enough = SOLVED**2 * float(here.sum())
    smooth = poisson_heights(weights[0], weights[1], held, right, measured, enough, 0)
    return np.where(here, unit * smooth, np.nan)


def _normals(points: Array, normals: Array, mask: Mask, directions: Array) -> Array:
    """(h, w, 3) unit normals: given ones, or those of neighbouring points."""
    given = mask & np.isfinite(normals).all(axis=-1)
    found = np.where(given[..., None], normals, _by_differences(points))
    found = np.where(np.isfinite(found).all(axis=-1, keepdims=True), found, -directions)
    found[~np.isfinite(points).all(axis=-1)] = np.nan
    return unit(found)


def _by_differences(points: Array) -> Array:
    """(h, w, 3): unit cross products of the shorter of both differences along rows and columns."""
    sides = []
    for axis in (1, 0):
        hole = np.full_like(np.take(points, [0], axis=axis), np.nan)
        before = np.diff(points, axis=axis, prepend=hole)
        after = np.diff(points, axis=axis, append=hole)
        length = [np.nan_to_num(np.linalg.norm(s, axis=-1), nan=np.inf) for s in (after, before)]
        sides.append(np.where((length[0] <= length[1])[..., None], after, before))
    normals = np.cross(sides[0], -sides[1])
    with np.errstate(invalid="ignore"):
        return unit(normals)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))
