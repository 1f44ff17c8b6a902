"""Depth from normals, and from both where depth is noisy.

A pixel looks along r = (x, y, -1) and sees the point P = z r; x and y are in units of the focal
length, p pixels each. On a plane n·P = z n·r is constant. So between two places a, b of one plane

    ln z_b - ln z_a = ln (n·r_a / n·r_b),                                   (perspective)

without any error of discretisation, and for small steps ∂ ln z/∂x = -n_x / (n·r): the unknown is
the logarithm of depth, and scaling a scene adds a constant to it (Quéau, Durou and Aujol, "Normal
integration: a survey", Journal of Mathematical Imaging and Vision 60, 2018). Without perspective
P = (x, y, -z), and z itself has n_z (z_b - z_a) = n_x (x_b - x_a) + n_y (y_b - y_a). Between the
centres of neighbours each pixel's plane counts up to the middle, which makes

    g_ab = ln (n_a·r_a / n_a·r_m) + ln (n_b·r_m / n_b·r_b),    r_m = (r_a + r_b)/2.

The depth sought minimises

    Σ_ab w_ab p² (ln z_b - ln z_a - g_ab)² + λ Σ_a (ln z_a - ln d_a)²,

d the depth that is given, if any. A normal that is off by δ changes the slope, a tangent, by
δ/cos² θ, θ the angle to the ray; so w_ab has the factor cos⁴ θ, and λ is (δ/ε)² for a relative
deviation ε of d.

**Jumps.** Where the surface is interrupted, no difference of neighbours is told by normals. So
residuals e are weighed by 1/(1 + (e/s)²), as for noise of a Cauchy distribution, s a multiple of
their median, and this is repeated; the first residuals are those of the depth that is given.
Neighbours in different segments count `BORDER_WEIGHT`, so much that segments without depth hang
together. Pixels without normals are bridged by `BRIDGE_WEIGHT`, with the least slope.

**Solution.** The matrix is a weighted Laplacian: conjugate gradients, with smoothed aggregation
(Vaněk, Mandel and Brezina, Computing 56, 1996) as preconditioner, need a number of steps that
hardly depends on the size, so time is about linear in the pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.checks import any_array
from pbrfit.model import geometry
from pbrfit.scene.depth import without_holes

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]

DEPTH_WEIGHT = 4.0
"""λ of depth that is off by half as much, relatively, as normals are in radians: 5 %, 6 degrees."""

BORDER_WEIGHT = 1e-3
"""Weight of a difference between neighbours in different segments, of one inside."""

BRIDGE_WEIGHT = 1e-4
"""Weight of a difference between neighbours of which one has no normal, of one that faces."""

COSINE_MIN = 0.02
"""Least cosine between normal and ray of slopes: beyond, a surface is thinner than a pixel."""

NORMAL_ERROR_MIN = 0.02
"""Radians: residuals below it, about a degree, are no jumps, however small most are."""

RESIDUAL_SCALE = 3 * 1.4826
"""Scale s of the weights in medians of the residuals: three standard deviations."""

ROUNDS = 6
"""Times that the equations are solved, weights of residuals found in between."""

TOLERANCE, ROUGH_TOLERANCE = 1e-7, 1e-3
"""Norm of the residual of solved linear equations, relative to their right side; of those that only
weights are found from, which move by less than that."""

ITERATIONS_MAX = 500
"""Steps of conjugate gradients at most."""

DIRECT_MAX = 1500
"""Unknowns up to which the linear equations are factorised."""

STRONG = 0.08
"""Coupling a_ij²/(a_ii a_jj) from the square of which on unknowns are aggregated."""


def depth_from_normals(
    normals: NDArray[np.floating[Any]],
    fov: float,
    mask: NDArray[np.bool_] | None = None,
    segments: NDArray[np.integer[Any]] | None = None,
    depth: NDArray[np.floating[Any]] | None = None,
) -> NDArray[np.float32]:
    """Depth of a surface with given normals; the module says by which equations.

    Normals (H, W, 3) are unit vectors in camera space, NaN where unknown, which is bridged; the
    mask (H, W) is True where depth is wanted; borders of segments (H, W) may be jumps. `depth`
    (H, W) are noisy distances along the camera's axis, NaN where unknown: normals alone tell depth
    up to a factor, without perspective up to an offset, of each surface that hangs together.

    Returns (H, W) float32 distances along the camera's axis, NaN outside the mask; in the unit of
    `depth`, without any with median 1 (orthographic: minimum 1). Raises InputError if an array has
    another size, or no pixel of the mask has a normal.
    """
    geometry.check_fov(fov)
    shape = np.shape(normals)[:2]
    wanted = np.ones(shape, bool) if mask is None else np.asarray(mask, bool)
    for name, array in (("mask", mask), ("segments", segments), ("depth", depth)):
        if array is not None:
            any_array(name, array, shape)
    known = wanted & np.isfinite(normals).all(axis=-1)
    if not known.any():
        raise InputError("normals: expected some in the mask, found none")
    unit: Array = np.where(known[..., None], normals, 0.0).astype(np.float64)
    edges = _Edges.of(unit, known, fov, segments)
    pixels = edges.pixels_per_unit

    given, data = np.zeros((2, known.size))  # data is λ/p² where depth is given
    if depth is not None:
        distances = without_holes(depth)[0].astype(np.float64)
        given = (distances if fov == 0 else np.log(distances)).ravel()
        told = np.isfinite(given) & wanted.ravel()
        data[told] = DEPTH_WEIGHT / pixels**2
        given = np.where(told, given, 0.0)
    found, weights = given, edges.reweighted(given, data > 0)
    # Weights are found from rough solutions: only the last is what they ask for.
    for tolerance in (*[ROUGH_TOLERANCE] * (ROUNDS - 1), TOLERANCE):
        found = _solved(edges, weights, data, given, found, tolerance)
        if tolerance > TOLERANCE:
            weights = edges.reweighted(found)
    plane = found.reshape(shape)
    if fov == 0:
        plane = plane - (0.0 if data.any() else plane[wanted].min() - 1.0)
    else:
        plane = np.exp(plane - (0.0 if data.any() else np.median(plane[wanted])))
    return np.where(wanted, plane, np.nan).astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Edges:
    """Pairs of neighbours: (E,) each."""

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    """Places of pixels, row by row."""
    differences: Array
    """g: what normals say of the second's unknown minus the first's."""
    weights: Array
    """w, before residuals are looked at."""
    certain: NDArray[np.bool_]
    """Whether both have normals and lie in one segment."""
    pixels_per_unit: float
    """p."""
    shape: tuple[int, int]

    @classmethod
    def of(
        cls,
        normals: Array,
        known: NDArray[np.bool_],
        fov: float,
        segments: NDArray[np.integer[Any]] | None,
    ) -> _Edges:
        """Of all neighbours in a picture, horizontal ones first."""
        shape = height, width = known.shape
        half_width = 1.0 if fov == 0 else math.tan(math.radians(fov) / 2)
        rays = geometry.positions(np.ones(shape), fov)
        cosine = np.einsum("hwi,hwi->hw", normals, geometry.view_directions(height, width, fov))
        cosine = np.clip(cosine, COSINE_MIN, 1.0)
        index = np.arange(known.size).reshape(shape)
        parts: list[list[NDArray[Any]]] = []
        for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            both = known[a] & known[b]
            step = rays[b] - rays[a]
            middle = (rays[a] + rays[b]) / 2
            change = np.zeros(both.shape)
            for n, end, sign in ((normals[a], rays[a], 1), (normals[b], rays[b], -1)):
                change += _half(n, end, middle, step, fov, sign)
            # cos⁴ θ of the more slanted of the two.
            weight = np.minimum(cosine[a], cosine[b]) ** 4
            weight[~both] = BRIDGE_WEIGHT
            inside = both.copy()
            if segments is not None:
                border = segments[a] != segments[b]
                weight[border & both] *= BORDER_WEIGHT
                inside &= ~border
            parts.append([index[a], index[b], np.where(both, change, 0.0), weight, inside])
        first, second, differences, weights, certain = (
            np.concatenate([part[k].ravel() for part in parts]) for k in range(5)
        )
        return cls(first, second, differences, weights, certain, width / (2 * half_width), shape)

    def reweighted(self, unknown: Array, told: NDArray[np.bool_] | None = None) -> Array:
        """Weights by residuals; those between pixels that are not `told` stay as they are."""
        # Radians for surfaces that face the camera, in standard deviations that are equal for all,
        # as weights of slanted surfaces are small.
        change = unknown[self.second] - unknown[self.first] - self.differences
        residual = np.sqrt(self.weights) * (self.pixels_per_unit * change)
        told = np.ones(unknown.shape, bool) if told is None else told
        looked_at = told[self.first] & told[self.second]
        some = np.abs(residual[self.certain & looked_at])
        middle = float(np.median(some)) if some.size else 0.0
        scale = max(NORMAL_ERROR_MIN, RESIDUAL_SCALE * middle)
        factor = np.where(looked_at, 1.0 / (1.0 + (residual / scale) ** 2), 1.0)
        return self.weights * factor


def _half(normals: Array, end: Array, middle: Array, step: Array, fov: float, sign: int) -> Array:
    """What a pixel's plane says of the way from its centre to the middle, or back: (...,)."""
    if fov == 0:
        z = np.maximum(normals[..., 2], COSINE_MIN)
        return np.asarray((normals[..., :2] * step[..., :2]).sum(axis=-1) / z / 2)
    at_end, at_middle = (
        np.maximum(-np.einsum("...i,...i->...", normals, ray), COSINE_MIN) for ray in (end, middle)
    )
    return np.asarray(sign * np.log(at_end / at_middle))


def _solved(
    edges: _Edges, weights: Array, data: Array, given: Array, start: Array, tolerance: float
) -> Array:
    """The unknowns (P,) that minimise the weighted squares."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import LinearOperator, cg

    count = data.size
    if count == 1:
        return given  # of no neighbours
    total = np.bincount(edges.first, weights, count) + np.bincount(edges.second, weights, count)
    held = data
    if not data.any():  # a constant is free: one unknown in the middle is held at 0
        held = np.zeros(count)
        held[edges.first[len(edges.first) // 4]] = 1.0
    rows = np.concatenate([edges.first, edges.second])
    columns = np.concatenate([edges.second, edges.first])
    couplings = coo_array((-np.concatenate([weights] * 2), (rows, columns)), shape=(count, count))
    matrix = (couplings + diags_array(total + held)).tocsr()
    flow = weights * edges.differences
    flows = np.bincount(edges.second, flow, count) - np.bincount(edges.first, flow, count)
    right = data * given + flows
    # In units in which the diagonal is 1: bridges weigh as much as all else.
    size = 1.0 / np.sqrt(total + held)
    scaled = (diags_array(size) @ matrix @ diags_array(size)).tocsr()
    places = np.divmod(np.arange(count), edges.shape[1])
    cycle = _multigrid(scaled, np.stack(places, axis=-1), size[:, None] ** -1)
    operator = LinearOperator(scaled.shape, matvec=cycle, dtype=np.float64)
    found, _ = cg(
        scaled, size * right, start / size, rtol=tolerance, maxiter=ITERATIONS_MAX, M=operator
    )
    return np.asarray(found * size)


def _multigrid(
    matrix: csr_array[np.float64], places: NDArray[np.intp], smooth: Array
) -> Callable[[Array], Array]:
    """A V-cycle of smoothed aggregation, as a function of the right side.

    `smooth` (P, 1) is the vector that is constant in the picture; the coarse unknowns of a block of
    3 × 3 that hang together hold it.
    """
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import splu

    count = matrix.shape[0]
    blocks = places // 3
    if count > DIRECT_MAX:
        diagonal = matrix.diagonal()
        table = matrix.tocoo()
        row, column = table.coords
        coupling = np.abs(table.data) / np.sqrt(diagonal[row] * diagonal[column])
        inside = (coupling > STRONG) & (blocks[row] == blocks[column]).all(axis=-1)
        graph = csr_array((coupling[inside], (row[inside], column[inside])), shape=matrix.shape)
        coarse, label = connected_components(graph, directed=False)
    if count <= DIRECT_MAX or coarse > 0.7 * count:
        factors = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return lambda right: np.asarray(factors.solve(right))
    length = np.sqrt(np.bincount(label, smooth[:, 0] ** 2, coarse))
    values = smooth[:, 0] / length[label]
    tentative = csr_array((values, (np.arange(count), label)), shape=(count, coarse))
    # Smoothed without couplings weaker than two strong ones in a row, which are on the diagonal, or
    # coarse equations fill up. The largest eigenvalue of D⁻¹A of a Laplacian is at most 2.
    kept = coupling >= STRONG**2
    smoother = csr_array((table.data[kept], (row[kept], column[kept])), shape=matrix.shape)
    smoother = smoother + diags_array(np.asarray((matrix - smoother).sum(axis=1), np.float64))
    inverse = diags_array(1.0 / smoother.diagonal())
    prolong = (tentative - (2 / 3) * (inverse @ (smoother @ tentative))).tocsr()
    restrict = prolong.T.tocsr()
    new_places = blocks[np.unique(label, return_index=True)[1]]
    below = _multigrid((restrict @ matrix @ prolong).tocsr(), new_places, length[:, None])
    damping = (2 / 3) / diagonal

    def cycle(right: Array) -> Array:
        found = damping * right
        found += damping * (right - matrix @ found)
        coarse_right = np.asarray(restrict @ (right - matrix @ found))
        found += np.asarray(prolong @ below(coarse_right))
        found += damping * (right - matrix @ found)
        found += damping * (right - matrix @ found)
        return found

    return cycle
