"""The surface that pixels show: which neighbours belong together, and points without their noise.

Two neighbours p and q have tangent planes. The plane of p says where the ray of q would meet it,
at t_p(q), and the other way round. A smooth surface has t_p(q) = t_q and t_q(p) = t_p. Where two
planes meet in an edge between the pixels, t_p − t_q(p) and t_p(q) − t_q have opposite signs:
the planes cross on the way. A jump is where neither holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.transport.rays import Array, Rays, rays_of

Mask = NDArray[np.bool_]
Sides = tuple[NDArray[Any], NDArray[Any]]

LEAST_FACING = 0.2
"""Least |n·ray| that a tangent plane is extended with: planes seen from the side tell little."""
TOLERANCE = 0.75
"""Gap between tangent planes up to which neighbours belong together, in their distance across."""
TOLERANCE_AT_BORDERS = 0.3
"""The same between pixels of different segments."""
SIGMAS = 3.0
"""Standard deviations of the noise of depth that a gap may have besides."""
NORMAL_ERROR = 0.1
"""Slope, in radians, that normals may be wrong by: what smoothing trusts them to."""
LEAST_NOISE = 1e-3
"""Relative noise of depth that points have at least: of files, of networks at their best."""
OUTLIER = 3.0
"""Standard deviations from what the normals tell at which a distance counts half."""
BESIDE_JUMPS = 0.03
"""How much distances beside jumps count at first, where networks blur."""
AIRBORNE = 0.01
"""What a distance counts below which it is taken to hang between two surfaces."""
ROUNDS = 4
"""Rounds of smoothing, each with the jumps of the one before."""
FLYING = 9
"""Most pixels of a piece without neighbours that is taken for a wrong depth and not a thing."""
NEAR_NORMAL = 4.0
"""Distance, in pixels in space, within which a point without segment takes another's normal."""


@dataclass(frozen=True)
class Relief:
    """The pixels' points, in a grid of every `step`-th pixel.

    Attributes
    ----------
    rows, columns
        Which pixels.
    rays, origins, directions
        Rays of the picture; those of the grid, (h, w, 3) each, unit directions.
    distance
        (h, w) along the rays; NaN where there is no point.
    normals
        (h, w, 3) unit normals that face the camera; NaN where there is no point.
    segments
        (h, w) ids; all 0 where none are known.
    right, down
        (h, w − 1) and (h − 1, w) bool: neighbours that belong to one surface.
    noise
        Standard deviation of the distances that is left, relative.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    rays: Rays
    origins: Array
    directions: Array
    distance: Array
    normals: Array
    segments: NDArray[np.integer]
    right: Mask
    down: Mask
    noise: float

    @property
    def points(self) -> Array:
        """(h, w, 3); NaN where there is none."""
        return self.origins + self.distance[..., None] * self.directions

    @property
    def here(self) -> Mask:
        """(h, w): where there is a point."""
        return np.isfinite(self.distance)

    @property
    def step(self) -> int:
        """Pixels from one point to the next."""
        return int(self.rows[1] - self.rows[0]) if len(self.rows) > 1 else 1

    @property
    def footprint(self) -> Array:
        """(h, w): distance across the rays from one point to the next."""
        apart = self.step * abs(self.rays.columns[0])
        if self.rays.orthographic:
            return np.where(self.here, apart, np.nan)
        return self.distance * apart * np.abs(self.directions[..., 2])

    def pieces(self, those: Mask) -> NDArray[np.int32]:
        """(h, w): numbers of the connected pieces of some pixels, from 0; −1 elsewhere."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        height, width = those.shape
        number = np.arange(height * width).reshape(height, width)
        right = self.right & those[:, 1:] & those[:, :-1]
        down = self.down & those[1:] & those[:-1]
        ends = np.concatenate([number[:, :-1][right], number[:-1][down]])
        others = np.concatenate([number[:, 1:][right], number[1:][down]])
        graph = coo_array(
            (np.ones(len(ends), bool), (ends, others)), shape=(number.size, number.size)
        )
        labels = connected_components(graph, directed=False)[1].reshape(height, width)
        found = np.full(those.shape, -1, np.int32)
        found[those] = np.unique(labels[those], return_inverse=True)[1]
        return found


def relief(
    points: Array,
    normals: Array,
    mask: Mask,
    segments: NDArray[np.integer] | None,
    max_vertices: int,
) -> Relief:
    """Find surface and jumps.

    Parameters
    ----------
    points
        (H, W, 3), camera space; NaN where nothing is known to be.
    normals
        (H, W, 3), unit; used in the mask only. Others are taken from points nearby.
    mask
        (H, W): where normals hold.
    segments
        (H, W) ids, 0 = unclassified, or None.
    max_vertices
        Points to keep at most; of larger pictures every second, third, ... pixel.

    Raises
    ------
    InputError
        If there are too few points.
    """
    points = np.asarray(points, np.float64)
    rays = rays_of(points)
    step = max(1, int(np.ceil(np.sqrt(mask.size / max_vertices))))
    rows = np.arange(min(step // 2, mask.shape[0] - 1), mask.shape[0], step)
    columns = np.arange(min(step // 2, mask.shape[1] - 1), mask.shape[1], step)
    grid = np.ix_(rows, columns)
    origins, directions = rays.at(rows[:, None], columns)
    distance = np.einsum("hwi,hwi->hw", points[grid] - origins, directions)
    ids = np.zeros(distance.shape, np.int64) if segments is None else segments[grid]
    facing = _normals(points[grid], normals[grid], mask[grid], ids, directions)
    return _smoothed(rows, columns, rays, origins, directions, distance, facing, ids)


def extended(
    normals: Array, points: Array, distance: Array, origins: Array, directions: Array
) -> Array:
    """Where rays (..., 3) meet tangent planes of points, as distances (...) along the rays.

    `distance` (...) is where a plane seen from the side stays near to.
    """
    start = origins + distance[..., None] * directions
    along = np.minimum(np.einsum("...i,...i->...", normals, directions), -LEAST_FACING)
    return np.asarray(distance + np.einsum("...i,...i->...", normals, points - start) / along)


def _smoothed(
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    rays: Rays,
    origins: Array,
    directions: Array,
    distance: Array,
    normals: Array,
    segments: NDArray[np.integer],
) -> Relief:
    def made(distance: Array, noise: float) -> Relief:
        right, down = _links(origins, directions, distance, normals, segments, noise)
        return Relief(
            rows,
            columns,
            rays,
            origins,
            directions,
            distance,
            normals,
            segments,
            right,
            down,
            noise,
        )

    noise = _noise(origins, directions, distance, normals, segments)
    found = made(distance, noise)
    assumed = max(noise, LEAST_NOISE)
    trusted = _trusted(found)
    for _ in range(ROUNDS):
        calm = _calmed(found, distance, trusted, assumed)
        left = _noise(origins, directions, calm, normals, segments)
        found = made(calm, min(left, noise))
        off = (calm / distance - 1) / (OUTLIER * assumed)
        trusted = np.where(_lone(found), 0.0, np.where(found.here, 1 / (1 + off**2), 0.0))
    return found


def _pairs(a: NDArray[Any]) -> tuple[Sides, Sides]:
    """Left and right, upper and lower neighbours of an array (h, w, ...)."""
    return (a[:, :-1], a[:, 1:]), (a[:-1], a[1:])


def _gaps(
    origins: Array, directions: Array, distance: Array, normals: Array
) -> list[tuple[Array, Array, Array]]:
    """For neighbours to the right and below: t_p(q) − t_q, t_p − t_q(p), and distance across."""
    points = origins + distance[..., None] * directions
    found = []
    fields = (_pairs(a) for a in (points, directions, normals))
    for (p, q), (at_p, at_q), (of_p, of_q) in zip(*fields, strict=True):
        d = q - p
        ahead = -np.einsum("hwi,hwi->hw", of_p, d) / _steep(of_p, at_q)
        behind = -np.einsum("hwi,hwi->hw", of_q, d) / _steep(of_q, at_p)
        middle = (at_p + at_q) / 2
        across = np.linalg.norm(
            d - np.einsum("hwi,hwi->hw", d, middle)[..., None] * middle, axis=-1
        )
        found.append((ahead, behind, across))
    return found


def _steep(normals: Array, directions: Array) -> Array:
    return np.asarray(np.minimum(np.einsum("hwi,hwi->hw", normals, directions), -LEAST_FACING))


def _links(
    origins: Array,
    directions: Array,
    distance: Array,
    normals: Array,
    segments: NDArray[np.integer],
    noise: float,
) -> tuple[Mask, Mask]:
    slope = 1 / np.maximum(np.abs(np.einsum("hwi,hwi->hw", normals, directions)), LEAST_FACING)
    gaps = _gaps(origins, directions, distance, normals)
    links = []
    fields = (_pairs(a) for a in (segments, slope, distance))
    for (ahead, behind, across), (a, b), (s, t), (near, far) in zip(gaps, *fields, strict=True):
        tolerance = np.where(a == b, TOLERANCE, TOLERANCE_AT_BORDERS) * across
        tolerance += SIGMAS * noise * np.fmin(near, far)
        crossing = np.where(ahead * behind <= 0, 0.0, np.minimum(abs(ahead), abs(behind)))
        # Planes seen from the side cross anything; an edge is where both are near.
        reach = tolerance + across * (s + t)
        with np.errstate(invalid="ignore"):
            links.append((crossing <= tolerance) & (np.maximum(abs(ahead), abs(behind)) <= reach))
    return links[0], links[1]


def _noise(
    origins: Array,
    directions: Array,
    distance: Array,
    normals: Array,
    segments: NDArray[np.integer],
) -> float:
    """Relative standard deviation of distances, from what tangent planes leave of neighbours."""
    left = []
    for (ahead, behind, across), (near, far), (a, b) in zip(
        _gaps(origins, directions, distance, normals),
        _pairs(distance),
        _pairs(segments),
        strict=True,
    ):
        here = np.isfinite(ahead) & np.isfinite(behind) & (a == b)
        change = ((ahead + behind) / 2)[here] / np.minimum(near, far)[here]
        explained = (NORMAL_ERROR * across / np.minimum(near, far))[here]
        left.append(np.maximum(np.abs(change) - explained, 0.0))
    all_left = np.concatenate(left)
    return float(np.median(all_left) / 0.6745 / np.sqrt(2)) if len(all_left) else 0.0


def _lone(found: Relief) -> Mask:
    """(h, w): points in small pieces, between two surfaces."""
    piece = found.pieces(found.here)
    sizes = np.bincount(piece[piece >= 0])
    return np.asarray((piece >= 0) & (sizes[piece] <= FLYING))


def _trusted(found: Relief) -> Array:
    """(h, w): how much each distance counts at first; little beside jumps."""
    from scipy.ndimage import binary_dilation

    here = found.here
    trusted = np.where(here & ~_lone(found), 1.0, 0.0)
    beside = np.zeros(here.shape, bool)
    across = here[:, 1:] & here[:, :-1] & ~found.right
    beside[:, 1:] |= across
    beside[:, :-1] |= across
    across = here[1:] & here[:-1] & ~found.down
    beside[1:] |= across
    beside[:-1] |= across
    trusted[binary_dilation(beside, iterations=1) & here] *= BESIDE_JUMPS
    return trusted


def _calmed(found: Relief, measured: Array, trusted: Array, noise: float) -> Array:
    """Distances nearest to the measured ones whose steps are those that the normals tell.

    Least squares of ln t (perspective) or t (orthographic): steps to NORMAL_ERROR, the measured
    ones to `noise`.
    """
    from scipy import sparse
    from scipy.sparse.linalg import cg

    flat = found.rays.orthographic
    scale = float(np.nanmedian(measured)) if flat else 1.0
    value = measured / scale if flat else np.log(measured)
    here = found.here
    count = int(here.sum())
    number = np.full(here.shape, -1)
    number[here] = np.arange(count)
    weight = (trusted / noise**2)[here]
    matrix = [np.maximum(weight, 1e-3 / noise**2)]
    at: list[NDArray[Any]] = [np.arange(count)]
    to: list[NDArray[Any]] = [np.arange(count)]
    right = matrix[0] * value[here]
    links = (found.right | _same(found, trusted, 1), found.down | _same(found, trusted, 0))
    for linked, (a, b), (o_p, o_q), (w_p, w_q), (n_p, n_q) in zip(
        links,
        _pairs(number),
        _pairs(found.origins),
        _pairs(found.directions),
        _pairs(found.normals),
        strict=True,
    ):
        linked = linked & (a >= 0) & (b >= 0)
        steps, facing = [], []
        for n in (n_p, n_q):
            from_p, to_q = _steep(n, w_p), _steep(n, w_q)
            if flat:
                steps.append(-np.einsum("hwi,hwi->hw", n, o_q - o_p) / to_q / scale)
            else:
                raw = np.log(
                    np.minimum(np.einsum("hwi,hwi->hw", n, w_p), -1e-3)
                    / np.minimum(np.einsum("hwi,hwi->hw", n, w_q), -1e-3)
                )
                angle = np.linalg.norm(w_q - w_p, axis=-1)
                steps.append(np.clip(raw, -angle / LEAST_FACING, angle / LEAST_FACING))
            facing.append(np.abs(from_p + to_q) / 2)
        step = (steps[0] + steps[1])[linked] / 2
        across = np.linalg.norm(o_q - o_p, axis=-1) / scale if flat else angle
        spread = (NORMAL_ERROR * across / np.minimum(facing[0], facing[1]) ** 2)[linked]
        weight = 1 / spread**2
        p, q = a[linked], b[linked]
        at += [p, q, p, q]
        to += [p, q, q, p]
        matrix += [weight, weight, -weight, -weight]
        np.add.at(right, p, -weight * step)
        np.add.at(right, q, weight * step)
    system = sparse.coo_array(
        (np.concatenate(matrix), (np.concatenate(at), np.concatenate(to))), shape=(count, count)
    ).tocsr()
    diagonal = system.diagonal()
    solution, _ = cg(
        system,
        right,
        x0=value[here],
        rtol=1e-6,
        maxiter=600,
        M=sparse.diags_array(1 / diagonal),
    )
    calm = measured.copy()
    calm[here] = solution * scale if flat else np.exp(solution)
    return calm


def _same(found: Relief, trusted: Array, axis: int) -> Mask:
    """Neighbours of one segment with about the same normal, of which one hangs in the air."""
    ids, normals, trust = (
        _pairs(a)[0 if axis else 1] for a in (found.segments, found.normals, trusted)
    )
    with np.errstate(invalid="ignore"):
        alike = np.einsum("hwi,hwi->hw", *normals) > np.cos(np.radians(20))
    lone = (trust[0] < AIRBORNE) | (trust[1] < AIRBORNE)
    return np.asarray((ids[0] == ids[1]) & alike & lone)


def _normals(
    points: Array, normals: Array, mask: Mask, segments: NDArray[np.integer], directions: Array
) -> Array:
    """Normals of all points, facing the camera: given, of a point nearby, or of neighbours."""
    from scipy.spatial import cKDTree

    here = np.isfinite(points).all(axis=-1)
    known = here & mask & np.isfinite(normals).all(axis=-1)
    found = np.full(points.shape, np.nan)
    found[known] = normals[known]
    lacking = here & ~known
    if lacking.any():
        found[lacking] = _by_differences(points)[lacking]
        apart = np.linalg.norm(points, axis=-1) * np.median(
            np.linalg.norm(np.diff(directions, axis=1), axis=-1)
        )
        for one in np.unique(segments[lacking]):
            to, of = lacking & (segments == one), known & (segments == one)
            if of.any():
                distance, nearest = cKDTree(points[of]).query(points[to])
                near = (distance < NEAR_NORMAL * apart[to]) | (one != 0)
                found[to] = np.where(near[:, None], normals[of][nearest], found[to])
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        found = np.where(length > 0, found / length, -directions)
        found = np.where(np.isfinite(found), found, -directions)
    found[~here] = np.nan
    away = np.einsum("hwi,hwi->hw", found, directions)
    # A normal that faces away is tilted until it does not.
    with np.errstate(invalid="ignore"):
        tilted = found - np.maximum(away + 0.02, 0.0)[..., None] * directions
    return np.asarray(tilted / np.linalg.norm(tilted, axis=-1, keepdims=True))


def _by_differences(points: Array) -> Array:
    """(h, w, 3): cross products of the shorter of both differences along rows and columns."""
    sides = []
    for axis in (1, 0):
        step = np.diff(points, axis=axis)
        hole = np.full_like(np.take(points, [0], axis=axis), np.nan)
        after = np.concatenate([step, hole], axis=axis)
        before = np.concatenate([hole, step], axis=axis)
        length = [np.nan_to_num(np.linalg.norm(s, axis=-1), nan=np.inf) for s in (after, before)]
        sides.append(np.where((length[0] <= length[1])[..., None], after, before))
    return np.cross(sides[0], -sides[1])
