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

**Solution.** The equations are Poisson's, with weights; the core solves them by conjugate gradients
with multigrid as preconditioner, in a number of steps that does not depend on the size.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError, poisson_heights
from pbrfit.model import geometry
from pbrfit.scene.depth import without_holes
from pbrfit.values.arrays import Array, Floats, Mask
from pbrfit.values.checks import any_array

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

TOLERANCE, ROUGH_TOLERANCE = 1e-3, 1e-2
"""Error of solved equations as a share of what they leave of the slopes, both as roots of weighted
squares, so of normals' own error; and where only weights are found from the solution."""

EXACT = 1e-7
"""Share of all slopes that no solution is asked to be better than: rounding to float32."""


def depth_from_normals(
    normals: Floats,
    fov: float,
    mask: Mask | None = None,
    segments: NDArray[np.integer[Any]] | None = None,
    depth: Floats | None = None,
    *,
    threads: int = 0,
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
    pairs = _Pairs(unit, known, fov, segments)

    given, data = np.zeros((2, *shape))  # data is λ/p² where depth is given
    if depth is not None:
        distances = without_holes(depth)[0].astype(np.float64)
        given = distances if fov == 0 else np.log(distances)
        told = np.isfinite(given) & wanted
        data[told] = DEPTH_WEIGHT / pairs.pixels_per_unit**2
        given = np.where(told, given, 0.0)
    plane, weights = given, pairs.reweighted(np.where(data > 0, given, np.nan))
    for tolerance in (*[ROUGH_TOLERANCE] * (ROUNDS - 1), TOLERANCE):
        left = (weights * pairs.left(plane) ** 2).sum() + (data * (plane - given) ** 2).sum()
        enough = tolerance**2 * left
        enough += EXACT**2 * (weights * pairs.differences**2).sum()
        flows = pairs.flows(weights) + data * given
        plane = poisson_heights(weights[0], weights[1], data, flows, plane, enough, threads)
        if tolerance > TOLERANCE:
            weights = pairs.reweighted(plane)
    if fov == 0:
        plane = plane - (0.0 if data.any() else plane[wanted].min() - 1.0)
    else:
        plane = np.exp(plane - (0.0 if data.any() else np.median(plane[wanted])))
    return np.where(wanted, plane, np.nan).astype(np.float32)


PAIRS: tuple[tuple[Any, Any], ...] = (np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])
"""Where the first of two neighbours is, and the second: to its right, below it."""


class _Pairs:
    """Pairs of neighbours: (2, H, W) by the first, with its right and its lower one; 0 of none."""

    def __init__(self, normals: Array, known: Mask, fov: float, segments: Any) -> None:
        shape = height, width = known.shape
        self.pixels_per_unit = width / (2 if fov == 0 else 2 * math.tan(math.radians(fov) / 2))
        """p"""
        self.differences, self.weights = np.zeros((2, 2, *shape))
        """g, what normals say of the second's unknown minus the first's; w without residuals."""
        self.certain = np.zeros((2, *shape), bool)
        """Whether both have normals and lie in one segment."""
        rays = geometry.positions(np.ones(shape), fov)
        cosine = np.einsum("hwi,hwi->hw", normals, geometry.view_directions(height, width, fov))
        cosine = np.clip(cosine, COSINE_MIN, 1.0)
        for k, (a, b) in enumerate(PAIRS):
            both = known[a] & known[b]
            one = both if segments is None else both & (segments[a] == segments[b])
            step = rays[b] - rays[a]
            middle = (rays[a] + rays[b]) / 2
            change = _half(normals[a], rays[a], middle, step, fov, 1)
            change += _half(normals[b], rays[b], middle, step, fov, -1)
            self.differences[k][a] = np.where(both, change, 0.0)
            # cos⁴ θ of the more slanted of the two.
            slanted = np.minimum(cosine[a], cosine[b]) ** 4 * np.where(one, 1.0, BORDER_WEIGHT)
            self.weights[k][a] = np.where(both, slanted, BRIDGE_WEIGHT)
            self.certain[k][a] = one

    def left(self, unknown: Array) -> Array:
        """What the unknowns (H, W) differ by, less what normals say."""
        left = -self.differences
        for residual, (a, b) in zip(left, PAIRS, strict=True):
            residual[a] += unknown[b] - unknown[a]
        return np.asarray(left)

    def reweighted(self, unknown: Array) -> Array:
        """Weights by residuals; those between pixels that are unknown stay as they are."""
        # Radians for surfaces that face the camera, in standard deviations that are equal for all,
        # as weights of slanted surfaces are small.
        residual = np.sqrt(self.weights) * (self.pixels_per_unit * self.left(unknown))
        some = np.abs(residual[self.certain & np.isfinite(residual)])
        middle = float(np.median(some)) if some.size else 0.0
        scale = max(NORMAL_ERROR_MIN, RESIDUAL_SCALE * middle)
        return np.asarray(self.weights / (1.0 + np.nan_to_num(residual / scale) ** 2))

    def flows(self, weights: Array) -> Array:
        """(H, W): weighted differences that lead to a pixel, less those that lead away."""
        flows = np.zeros(self.weights.shape[1:])
        for flow, (a, b) in zip(weights * self.differences, PAIRS, strict=True):
            flows[b] += flow[a]
            flows[a] -= flow[a]
        return flows


def _half(normals: Array, end: Array, middle: Array, step: Array, fov: float, sign: int) -> Array:
    """What a pixel's plane says of the way from its centre to the middle, or back: (...,)."""
    if fov == 0:
        z = np.maximum(normals[..., 2], COSINE_MIN)
        return np.asarray((normals[..., :2] * step[..., :2]).sum(axis=-1) / z / 2)
    at_end, at_middle = (
        np.maximum(-np.einsum("...i,...i->...", normals, ray), COSINE_MIN) for ray in (end, middle)
    )
    return np.asarray(sign * np.log(at_end / at_middle))
