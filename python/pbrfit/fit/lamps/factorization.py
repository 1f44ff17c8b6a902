"""Pseudo-normals and unknown lamps, up to a matrix: a robust factorisation of rank 3.

With P pixels in N pictures, the radiance of a diffuse surface under distant lamps is I = B Sᵀ, B
(P, 3) of pseudo-normals and S (N, 3) of lamps, wherever b·s > 0; any invertible A gives B A and
S A⁻ᵀ the same pictures (Hayakawa, "Photometric stereo under a light source with arbitrary motion",
Journal of the Optical Society of America A 11, 1994). Shadows, highlights and clipped samples do
not belong to the product. So instead of a singular value decomposition, which has no place for
missing entries, pixels and pictures take turns: b of each pixel by robust photometric stereo under
the lamps so far (`photometric`), then s of each picture by the same robust loss over pixels. The
loss has minima of its own, so its scale σ falls from wide to what the residuals say.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.photometric import DARK, SCALE_MIN, refined, scale_of, solved, weights_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Factors(NamedTuple):
    """Lamps of a product B Sᵀ."""

    lamps: Array
    """(N, 3) S, with columns that are orthogonal, by the root mean square size of what they bring,
    the largest first: so b is of about length 1 in each direction."""
    rank: int
    """3; 2 or 1 if lamps lie in a plane or a line, as far as the samples show; 0 if none do."""


def factors(relative: Array, usable: Mask) -> Factors:
    """Factors of samples (P, N), divided by their pixel's brightness, that are usable (P, N).

    Pixels with fewer than three usable samples that are not dark tell nothing of lamps.
    """
    telling = (usable & (relative >= DARK)).sum(axis=1) >= 3
    relative, usable = relative[telling], usable[telling]
    if len(relative) < 3:
        return Factors(np.zeros((relative.shape[1], 3)), 0)
    # Lamps in front bring at most 1/cos of their angle to the normal times the median.
    filled = np.where(usable, np.minimum(relative, 2.5), 1.0)
    # By the N × N matrix: the same right singular vectors, without the P × N decomposition.
    _, singular = np.linalg.eigh(filled.T @ filled)
    lamps, _ = _whitened(singular[:, -3:])
    vectors = solved(relative, (usable & (relative >= DARK)).astype(np.float64), lamps)
    # At first nearly all samples count; ten rounds take σ to that of gloss and shadows.
    sigma, fall = 0.5, 0.8
    for _ in range(40):
        before = lamps
        vectors = refined(relative, usable, lamps, vectors, sigma)
        weights = weights_of(relative, usable, vectors @ lamps.T, sigma)
        lamps, back = _whitened(solved(relative.T, weights.T, vectors))
        vectors = vectors @ back
        told = scale_of(relative, usable, vectors @ lamps.T)
        cosines = np.linalg.svd(before.T @ lamps / len(lamps), compute_uv=False)
        if fall * sigma <= told and 1 - cosines.min() ** 2 < 1e-4**2:  # a hundredth of a degree
            break
        sigma = max(told, fall * sigma)
    return _ordered(relative, usable, lamps, vectors, sigma)


def _whitened(lamps: Array) -> tuple[Array, Array]:
    """S with SᵀS/N = 1 of the same span, and R with S_before = S Rᵀ: b of the new S is b R."""
    orthonormal, upper = np.linalg.qr(lamps)
    root = np.sqrt(len(lamps))
    return orthonormal * root, upper.T / root


def _ordered(relative: Array, usable: Mask, lamps: Array, vectors: Array, sigma: float) -> Factors:
    """Factors with the product's directions by size.

    Shadows put something into a third direction even where lamps lie in a plane, but only in the
    samples that they fall on. So the rank is the least one with which the samples that follow three
    are hardly farther off.
    """
    weights = weights_of(relative, usable, vectors @ lamps.T, sigma)
    # With SᵀS/N = 1 |b| is the root mean square of a pixel's samples, about 1. That of a pixel of
    # which few samples tell is anything, and would be most of a mean of squares.
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    shares = weights.sum(axis=1)
    mean = (unit * shares[:, None]).T @ unit / max(shares.sum(), 1e-300)
    squared, turned = np.linalg.eigh(mean)
    lamps = lamps @ turned[:, ::-1]
    follows = usable & (relative >= DARK) & (weights >= 0.25)  # residuals below σ
    residuals = [_residual(relative, follows, lamps * (np.arange(3) < rank)) for rank in (1, 2, 3)]
    # For noise alone the ratio is hardly above 1, as the samples are those that suit three.
    most = max(1.5 * residuals[2], SCALE_MIN)
    rank = 1 + int(np.argmax(np.array(residuals) <= most))
    return Factors(lamps * np.sqrt(np.maximum(squared[::-1], 0.0)), rank)


def _residual(relative: Array, follows: Mask, lamps: Array) -> float:
    """Median pixel's standard deviation of residuals under lamps (N, 3), some directions of them 0.

    0 if no pixel has more samples than directions.
    """
    free = follows.sum(axis=1) - np.count_nonzero(lamps.any(axis=0))
    some = free > 0
    if not some.any():
        return 0.0
    vectors = solved(relative[some], follows[some].astype(np.float64), lamps)
    squared = np.where(follows[some], relative[some] - vectors @ lamps.T, 0.0) ** 2
    return float(np.median(np.sqrt(squared.sum(axis=1) / free[some])))
