"""Whether the light of a picture fits those of the others: a quick decomposition at low resolution.

Divided by what the other pictures have in common at a pixel, the median of their logarithms, a
picture is an illumination: the albedo is gone, whatever the material is painted with. Light adds
up, and illuminations of one view are few functions of direction and place. So that of a picture
must be, nearly, a sum of those of the others,

    E_i(x, c) ≈ Σ_j Σ_c' a_jc' E_j(x, c') + b

with coefficients that hold for the whole picture. What was repainted is not: no light makes a chair
blue and leaves the wall. The coefficients are fitted by iteratively reweighted least squares with
Cauchy's weight, so that the repainted part has no say in them.

A shadow that only this picture has is left over too. But what is blocked is missing in all
channels, so that the residual has one sign in all three, where another colour of the same
brightness has both. `mixed` is the smaller of the largest positive and the largest negative
residual of the channels, smoothed. `brightness`, the mean of the channels, is large in shadows too;
it counts beside what the others of a set show there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.values.arrays import Array, Mask

SIDE = 128
"""Longer side at which this is done, in pixels."""

WINDOW = 6.0
"""Standard deviation in pixels over which residuals are averaged."""

FEWEST = 4
"""Pictures, the photograph included, below which nothing can be said."""

_FLOOR = 0.005  # added to pictures before they are divided, of white
_DARK, _BRIGHT = 0.01, 0.9  # between these, of white, a pixel has a say
_RIDGE = 1e-4
_STEPS = 8


def usable(pictures: NDArray[Any]) -> Mask:
    """(N, P): neither clipped nor dark."""
    return np.asarray((pictures.min(axis=-1) > _DARK) & (pictures.max(axis=-1) < _BRIGHT))


def unexplained(index: int, pictures: Array, used: Mask) -> Array:
    """Residual (P, 3) of a picture's illumination, as a logarithm; 0 where it is not usable.

    Pictures are (N, P, 3), linear, white = 1; `used` (N, P), see `usable`.
    """
    lit = pictures + _FLOOR
    others = np.delete(lit, index, axis=0)
    # Without the picture itself: what is wrong in it would show in all illuminations.
    albedo = np.exp(np.median(np.log(others), axis=0))
    pixels = len(albedo)
    basis = (others / albedo).transpose(1, 0, 2).reshape(pixels, -1)
    basis = np.concatenate([basis, np.ones((pixels, 1))], axis=1)
    wanted = lit[index] / albedo
    sound = used[index]
    if np.count_nonzero(sound) < basis.shape[1]:
        return np.zeros((pixels, 3))
    # Errors are relative to the illumination.
    scale = 1 / (0.05 + wanted.mean(axis=-1)) ** 2
    trust = np.ones(pixels)
    residual = np.zeros((pixels, 3))
    for _ in range(_STEPS):
        weighted = basis * (sound * scale * trust)[:, None]
        matrix = weighted.T @ basis
        matrix[np.diag_indices_from(matrix)] += _RIDGE * np.trace(matrix) / len(matrix)
        explained = basis @ np.linalg.solve(matrix, weighted.T @ wanted)
        residual = np.log((wanted + 0.02) / (explained.clip(0.02) + 0.02))
        spread = 1.5 * np.median(np.abs(residual[sound])) + 0.01
        trust = 1 / (1 + ((residual / spread) ** 2).sum(axis=-1) / 12)
    return np.asarray(residual * sound[:, None])


def brightness(residual: Array) -> Array:
    """(H, W): size of the mean over channels of smoothed residuals (H, W, 3)."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(np.abs(gaussian_filter(residual.mean(axis=-1), WINDOW)))


def mixed(residual: Array) -> Array:
    """(H, W): how far smoothed residuals (H, W, 3) go up in one channel and down in another."""
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(residual, (WINDOW, WINDOW, 0))
    return np.asarray(np.minimum(smooth.max(axis=-1), -smooth.min(axis=-1)).clip(0))
