"""What a matrix must do so that pseudo-normals become those of a surface: integrability.

The pseudo-normals of a factorisation are b, those of the surface m = Gᵀ b with columns g₁, g₂, g₃
of G. A surface z ahead of a camera that looks along r = (x, y, -1) has

    ∂ ln z/∂x = -m₁/(m·r),    ∂ ln z/∂y = -m₂/(m·r)

(`pbrfit.scene.integration`), and the derivative by y of the first is that by x of the second. With
M = -m·r = m₃ - x m₁ - y m₂,

    M ∂_y m₁ - m₁ ∂_y M  =  M ∂_x m₂ - m₂ ∂_x M.

(g_i·b)(g_j·b') - (g_j·b)(g_i·b') = (g_i×g_j)·(b×b'), and the terms m₁ m₂ that come of ∂_y(y m₂) and
∂_x(x m₁) are on both sides. What remains is linear in the columns of the matrix of cofactors
C = [g₂×g₃, g₃×g₁, g₁×g₂]:

    c₁·(b×∂_x b) + c₂·(b×∂_y b) + c₃·(x b×∂_x b + y b×∂_y b) = 0.

C is also what lamps are multiplied by: L = S G⁻ᵀ = S C/det G. Without perspective x = y = 0 in the
rays: c₁ and c₂ are told up to a factor, c₃ is free, which is the generalised bas-relief ambiguity
(Yuille and Snow, "Shape and albedo from multiple images using integrability", CVPR 1997; Belhumeur,
Kriegman and Yuille, "The bas-relief ambiguity", International Journal of Computer Vision 35, 1999).
With it all of C is told (Papadhimitri and Favaro, "A new perspective on uncalibrated photometric
stereo", CVPR 2013), the less the narrower the field of view.

A row a of these equations has noise, as b has. With a covariance V of b and independent noise in
the derivatives, the noise of a·C has the variance Cᵀ N C, where N has the blocks [b]ₓ V [b]ₓᵀ. So C
is sought with the least Cᵀ Q C/Cᵀ N C, Q = Σ a aᵀ: least squares with Q alone would shrink those
parts of C that multiply noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTHING = 1.0
"""Standard deviation in pixels of the mean that b is taken over before it is differentiated: the
derivatives' noise falls to a fifth, and details of two pixels remain."""

ROUNDS = 5
"""Rounds in which jumps of depth, where no surface goes on, are weighed down."""


BLOCKS_DRAWN = 6
"""Blocks that a null vector is tried from: six unknowns need more than one shape."""

DRAWS = 60
"""Draws of blocks: if a third of them is spoiled, 0.67⁶ = 9 % of the draws are clean, and one of 60
is so with a probability of 99.6 %."""

JUDGED = 4000
"""Equations that draws are judged by."""


@dataclass(frozen=True, eq=False)
class Integrability:
    """Equations of integrability, summed.

    Attributes
    ----------
    squares, noise
        (9, 9) Q and N; C is taken column by column.
    blocks
        Blocks of the picture that they lie in.
    """

    squares: Array
    noise: Array
    blocks: int

    def ratios(self, C: Array) -> tuple[Array, Array]:
        """Cᵀ Q C and Cᵀ N C, (T,) each, for C (T, 3, 3)."""
        c = np.swapaxes(C, 1, 2).reshape(-1, 9)
        return ((c @ self.squares) * c).sum(axis=1), ((c @ self.noise) * c).sum(axis=1)

    def null_vectors(self) -> tuple[Array, Array]:
        """c₁ and c₂ (6,) with c₃ = 0 by rising ratio: (6,) ratios, (6, 6) in rows."""
        Q, N = self.squares[:6, :6], self.noise[:6, :6]
        N = N + 1e-9 * np.trace(N) * np.eye(6)
        values, vectors = scipy.linalg.eigh(Q, N)
        return values, vectors.T


def equations(
    vectors: Array,
    covariances: Array,
    mask: Mask,
    views: Array,
    blocks: NDArray[np.intp],
) -> Integrability:
    """Equations of integrability at the pixels of a mask.

    Parameters
    ----------
    vectors
        (H, W, 3) b, divided by the pixels' brightness; 0 outside the mask.
    covariances
        (H, W, 3, 3) of b, up to a factor.
    mask
        (H, W): pixels with a b.
    views
        (H, W, 3) unit vectors to the camera.
    blocks
        (H, W): the block of each pixel, from 0; a negative number outside.
    """
    weight = gaussian_filter(mask.astype(np.float64), SMOOTHING)
    weight = np.maximum(weight, np.finfo(np.float64).tiny)
    smooth = np.stack(
        [gaussian_filter(np.where(mask, vectors[..., i], 0.0), SMOOTHING) for i in range(3)], -1
    )
    smooth /= weight[..., None]
    inside = np.zeros_like(mask)
    inside[1:-1, 1:-1] = (
        mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    )
    row, column = np.nonzero(inside & (blocks >= 0))
    b = smooth[row, column]
    along_x = (smooth[row, column + 1] - smooth[row, column - 1]) / 2
    along_y = (smooth[row - 1, column] - smooth[row + 1, column]) / 2
    view = views[row, column]
    x, y = (-view[:, :2] / view[:, 2:]).T
    across_x, across_y = np.cross(b, along_x), np.cross(b, along_y)
    rows = np.concatenate(
        [across_x, across_y, x[:, None] * across_x + y[:, None] * across_y], axis=1
    )
    # Equations count by the square of the direction of b alone, not by brightness.
    size = np.maximum(np.einsum("pi,pi->p", b, b), np.finfo(np.float64).tiny)
    rows /= size[:, None]
    cross = _cross_matrices(b)
    shaken = np.einsum("pij,pjk,plk->pil", cross, covariances[row, column], cross)
    shaken /= size[:, None, None] ** 2
    factors = np.zeros((len(b), 3, 3))
    factors[:, 0, 0] = factors[:, 1, 1] = 1
    factors[:, 0, 2] = factors[:, 2, 0] = x
    factors[:, 1, 2] = factors[:, 2, 1] = y
    factors[:, 2, 2] = x**2 + y**2
    count = len(np.unique(blocks[row, column]))

    def gathered_at(at: NDArray[np.intp]) -> Integrability:
        mean = np.einsum("pab,pij->aibj", factors[at], shaken[at], optimize=True)
        return Integrability(rows[at].T @ rows[at], mean.reshape(9, 9), count)

    def gathered(weights: Array) -> Integrability:
        mean = np.einsum("p,pab,pij->aibj", weights, factors, shaken, optimize=True)
        return Integrability((rows * weights[:, None]).T @ rows, mean.reshape(9, 9), count)

    def relative(null: Array, at: slice) -> Array:
        halves = null.reshape(2, 3)
        shake = np.einsum("ki,pij,kj->p", halves, shaken[at], halves, optimize=True)
        deviation = np.sqrt(np.maximum(shake, np.finfo(np.float64).tiny))
        return np.asarray(np.abs(rows[at, :6] @ null) / deviation)

    best = gathered(np.ones(len(b)))
    if not len(b):
        return best
    if count > BLOCKS_DRAWN:
        # Jumps and shadows' edges may outweigh all else in a sum of squares: the null vector is
        # that of a few blocks, drawn many times, for which the median residual is least.
        ids, block = np.unique(blocks[row, column], return_inverse=True)
        order = np.argsort(block, kind="stable")
        ends = np.searchsorted(block[order], np.arange(len(ids) + 1))
        parts = [order[ends[k] : ends[k + 1]] for k in range(len(ids))]
        sums = [gathered_at(part) for part in parts]
        at = slice(None, None, max(len(b) // JUDGED, 1))
        least = float(np.median(relative(best.null_vectors()[1][0], at)))
        draws = np.random.default_rng(0)
        for _ in range(DRAWS):
            some = draws.choice(len(parts), BLOCKS_DRAWN, replace=False)
            tried = Integrability(
                np.sum([sums[k].squares for k in some], axis=0),
                np.sum([sums[k].noise for k in some], axis=0),
                count,
            )
            middle = float(np.median(relative(tried.null_vectors()[1][0], at)))
            if middle < least:
                least, best = middle, tried
    for _ in range(ROUNDS):
        misfit = relative(best.null_vectors()[1][0], slice(None))
        middle = max(1.4826 * float(np.median(misfit)), np.finfo(np.float64).tiny)
        best = gathered(1 / (1 + (misfit / (3 * middle)) ** 2) ** 2)
    return best


def _cross_matrices(b: Array) -> Array:
    """[b]ₓ (P, 3, 3), with [b]ₓ v = b×v."""
    found = np.zeros((len(b), 3, 3))
    found[:, 0, 1], found[:, 0, 2] = -b[:, 2], b[:, 1]
    found[:, 1, 0], found[:, 1, 2] = b[:, 2], -b[:, 0]
    found[:, 2, 0], found[:, 2, 1] = -b[:, 1], b[:, 0]
    return found
