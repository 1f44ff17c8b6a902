"""What a matrix must do so that pseudo-normals become those of a surface: integrability.

The pseudo-normals of a factorisation are b, those of the surface m = Gᵀ b with columns g₁, g₂, g₃
of G. A surface z ahead of a camera that looks along r = (x, y, -1) has

    ∂ ln z/∂x = -m₁/(m·r),    ∂ ln z/∂y = -m₂/(m·r)

(`pbrfit.scene.integration`), and the derivative by y of the first is that by x of the second, so
that with M = -m·r = m₃ - x m₁ - y m₂

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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, gaussian_filter

from pbrfit.fit.lamps.samples import some_of
from pbrfit.values.arrays import Array, Mask

SMOOTHING = 1.0
"""Standard deviation in pixels of the mean that b is taken over before it is differentiated: the
derivatives' noise falls to a fifth, and details of two pixels remain."""

EQUATIONS_MAX = 1 << 17
"""Pixels whose equations are summed: what other surfaces reflect shifts them more than noise."""


@dataclass(frozen=True, eq=False)
class Integrability:
    """Equations of integrability, summed."""

    squares: Array
    noise: Array
    """(9, 9) Q and N; C is taken column by column."""
    blocks: int
    """Blocks of the picture that they lie in."""

    def null_vector(self) -> Array:
        """c₁ and c₂ (2, 3) of the least ratio with c₃ = 0."""
        Q, N = self.squares[:6, :6], self.noise[:6, :6]
        N = N + 1e-9 * np.trace(N) * np.eye(6)
        return np.asarray(scipy.linalg.eigh(Q, N, subset_by_index=(0, 0))[1][:, 0].reshape(2, 3))


def equations(
    vectors: Array,
    covariances: Callable[[NDArray[np.intp], NDArray[np.intp]], Array],
    mask: Mask,
    views: Array,
    blocks: NDArray[np.intp],
) -> Integrability:
    """Equations of integrability at the pixels of a mask (H, W).

    By b (H, W, 3), divided by the pixels' brightness, 0 outside the mask; covariances (P, 3, 3) of
    it, up to a factor, of the pixels in some rows and columns (P,); unit vectors to the camera
    (H, W, 3); and the block of each pixel, negative outside.
    """
    weight = gaussian_filter(mask.astype(np.float64), SMOOTHING)
    weight = np.maximum(weight, np.finfo(np.float64).tiny)
    smooth = gaussian_filter(vectors, (SMOOTHING, SMOOTHING, 0)) / weight[..., None]
    row, column = np.nonzero(binary_erosion(mask))
    some = some_of(len(row), EQUATIONS_MAX)
    row, column = row[some], column[some]
    b = smooth[row, column]
    along_x = (smooth[row, column + 1] - smooth[row, column - 1]) / 2
    along_y = (smooth[row - 1, column] - smooth[row + 1, column]) / 2
    view = views[row, column]
    x, y = (-view[:, :2] / view[:, 2:]).T
    across_x, across_y = np.cross(b, along_x), np.cross(b, along_y)
    across_rays = x[:, None] * across_x + y[:, None] * across_y
    rows = np.concatenate([across_x, across_y, across_rays], axis=1)
    # Equations count by the square of the direction of b alone, not by brightness.
    size = np.maximum(np.einsum("pi,pi->p", b, b), np.finfo(np.float64).tiny)
    rows /= size[:, None]
    cross = np.cross(np.eye(3), b[:, None])  # rows e_i × b, which is [b]ₓ
    shaken = cross @ covariances(row, column) @ np.swapaxes(cross, 1, 2)
    shaken /= size[:, None, None] ** 2
    # A column's row of derivatives, (1, 0), (0, 1) and (x, y), by those of the others.
    by = np.stack([[1 + 0 * x, 0 * x], [0 * x, 1 + 0 * x], [x, y]])
    factors = np.einsum("adp,bdp->pab", by, by)
    count = len(np.unique(blocks[row, column]))
    weights = np.ones(len(b))
    for _ in range(6):  # jumps of depth, where no surface goes on, are weighed down
        mean = np.einsum("p,pab,pij->aibj", weights, factors, shaken, optimize=True)
        found = Integrability((rows * weights[:, None]).T @ rows, mean.reshape(9, 9), count)
        if not len(b):
            break
        halves = found.null_vector()
        variance = np.einsum("ki,pij,kj->p", halves, shaken, halves, optimize=True)
        misfit = np.abs(rows[:, :6] @ halves.ravel()) / np.sqrt(np.maximum(variance, 1e-300))
        middle = max(1.4826 * float(np.median(misfit)), np.finfo(np.float64).tiny)
        with np.errstate(over="ignore"):  # beside an exact fit of most, what jumps weighs nothing
            weights = 1 / (1 + (misfit / (3 * middle)) ** 2) ** 2
    return found
