"""Pseudo-normals and unknown lamps, up to a matrix: a robust factorisation of rank 3.

With P pixels in N pictures, the radiance of a diffuse surface under distant lamps is I = B Sᵀ, B
(P, 3) of pseudo-normals and S (N, 3) of lamps, wherever b·s > 0; any invertible A gives B A and
S A⁻ᵀ the same pictures (Hayakawa, "Photometric stereo under a light source with arbitrary motion",
Journal of the Optical Society of America A 11, 1994). Shadows, highlights and clipped samples do
not belong to the product. So instead of a singular value decomposition, which has no place for
missing entries, pixels and pictures take turns: b of each pixel by robust photometric stereo under
the lamps so far (`photometric`), then s of each picture by the same robust loss over pixels. The
loss has minima of its own, so its scale σ falls from wide to what the residuals say.

S is given with SᵀS/N = 1, its columns by the size of what they bring, the largest first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.photometric import (
    DARK,
    SCALE_MIN,
    brightness,
    moments,
    pseudo_normals,
    scale_of,
    weights_of,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCALES = (0.1, 0.07, 0.05)
"""σ of the first rounds, of a pixel's brightness: from what tells highlights and shadows from
shading down to what shading itself is off by."""

DRAWS = 120
"""Triples of pixels whose samples the lamps' space is tried from. If half of the pixels follow the
law in all pictures, one of eight triples does; most of these are too alike to span the space well,
and 120 leave more than ten."""

JUDGING = 300
"""Pixels that a draw is judged by: their mean loss is known to 1/√300, some 6 %."""

JUDGED_SCALE = 0.05
"""σ by which it is judged: a twentieth of a pixel's brightness, below any highlight's or shadow's
difference."""

ROUNDS_MAX = 40
"""Rounds at most after the first ones."""

TURNS = 2
"""Rounds of weighted least squares at a pixel or a picture before the other side's turn."""

COMPLETIONS = 12
"""Rounds in which the start's missing samples are filled in by what the largest three singular
values say of them."""

BRIGHT = 2.5
"""Radiance, of a pixel's median one, above which a sample is left out of the start as a highlight.
Lamps in front of the surface bring at most 1/cos of their angle to the normal times the median."""

UNCHANGED = 1e-4
"""Sine of the largest angle between the lamps' spaces of two rounds below which they are found: a
hundredth of a degree."""

RANK_GAIN = 1.5
"""Standard deviation of the residuals without a direction, of that with it, up to which there is
none. For noise alone it is 1, and hardly above it as the samples are those that suit three."""

INLIER = 0.25
"""Weight from which on a sample follows the law: its residual is below σ."""

LENGTH_MAX = 3.0
"""Length of b, of the median one, above which it says nothing of sizes: with whitened lamps |b| is
the root mean square of a pixel's samples, all near its brightness."""


@dataclass(frozen=True, eq=False)
class Factors:
    """What B Sᵀ is made of.

    Attributes
    ----------
    lamps
        (N, 3) S.
    rank
        3; 2 or 1 if lamps lie in a plane or a line, as far as the samples show.
    sizes
        (3,) root mean square size of the product's directions, of the pixels' brightness.
    scale
        σ.
    """

    lamps: Array
    rank: int
    sizes: Array
    scale: float


def factors(samples: Array, usable: Mask) -> Factors:
    """Factors of samples (P, N), of those that are usable (P, N); N of 3 or more.

    Pixels with fewer than three usable samples that are not dark tell nothing of lamps.
    """
    relative = samples / brightness(samples, usable)[:, None]
    telling = (usable & (relative >= DARK)).sum(axis=1) >= 3
    relative, usable = relative[telling], usable[telling]
    count = relative.shape[1]
    if len(relative) < 3:
        return Factors(np.zeros((count, 3)), 0, np.zeros(3), SCALES[-1])
    lamps = _best_start(relative, usable)
    vectors: Array | None = None
    sigma = SCALES[0]
    for round_ in range(len(SCALES) + ROUNDS_MAX):
        begins = round_ < len(SCALES)
        if begins:
            sigma = SCALES[round_]
        found = pseudo_normals(relative, usable, lamps, start=vectors, scale=sigma, rounds=TURNS)
        before = lamps
        if round_ == len(SCALES) - 1:
            lamps = _reconsidered(relative, usable, found.vectors, lamps)
        lamps, back = _whitened(_lamps_from(relative, usable, found.vectors, lamps, sigma))
        vectors = found.vectors @ back
        if not begins:
            sigma = scale_of(relative, usable, vectors @ lamps.T)
            if _largest_sine(before, lamps) < UNCHANGED:
                break
    assert vectors is not None
    return _ordered(relative, usable, lamps, vectors, sigma)


def _best_start(relative: Array, usable: Mask) -> Array:
    """The lamps, of some spaces, with the least robust loss over some pixels.

    The samples of three pixels, if all follow the law, span the space of the lamps.
    """
    draws = np.random.default_rng(0)
    sample = draws.choice(len(relative), min(len(relative), JUDGING), replace=False)
    lit = np.where(usable & (relative <= BRIGHT), relative >= DARK, False).sum(axis=1)
    # The half of the pixels that are lit most: a sample in shadow spoils a draw.
    candidates = np.argsort(-lit, kind="stable")[: max(len(lit) // 2, 3)]
    tried = [_start(relative, usable)]
    for _ in range(DRAWS):
        rows = relative[draws.choice(candidates, 3, replace=False)]
        singular = np.linalg.svd(rows, compute_uv=False)
        if singular[2] > 1e-2 * singular[0]:
            tried.append(_whitened(rows.T)[0])
    some, used = relative[sample], usable[sample]
    losses = []
    for lamps in tried:
        plain = _solved(some, used & (some >= DARK) & (some <= BRIGHT), lamps)
        found = pseudo_normals(some, used, lamps, start=plain, scale=SCALES[0], rounds=TURNS)
        residual = (some - np.maximum(found.vectors @ lamps.T, 0.0)) / JUDGED_SCALE
        squared = residual**2
        losses.append(float(np.where(used, squared / (1 + squared), 0.0).sum()))
    return tried[int(np.argmin(losses))]


def _solved(relative: Array, counted: Mask, lamps: Array) -> Array:
    """Least squares at each pixel with the samples that are counted."""
    matrices = moments(counted.astype(np.float64), lamps) + 1e-6 * np.eye(3)
    return np.asarray(np.linalg.solve(matrices, ((counted * relative) @ lamps)[..., None])[..., 0])


def _start(relative: Array, usable: Mask) -> Array:
    """Lamps by singular values, missing samples filled in round by round."""
    known = usable & (relative >= DARK) & (relative <= BRIGHT)
    filled = np.where(known, relative, 1.0)
    for _ in range(COMPLETIONS):
        # By the N × N matrix: the same right singular vectors, without the P × N decomposition.
        _, vectors = np.linalg.eigh(filled.T @ filled)
        basis = vectors[:, -3:]
        filled = np.where(known, relative, np.clip(filled @ basis @ basis.T, 0.0, BRIGHT))
    return _whitened(basis * np.sign(basis.sum(axis=0)))[0]


def _lamps_from(relative: Array, usable: Mask, vectors: Array, lamps: Array, sigma: float) -> Array:
    """Lamps (N, 3) by weighted least squares over pixels, from b and the lamps so far."""
    products = (vectors[:, :, None] * vectors[:, None, :]).reshape(-1, 9)
    ridge = 1e-9 * np.eye(3) * float(np.einsum("px,px->", vectors, vectors))
    for _ in range(TURNS):
        weights = weights_of(relative, usable, vectors @ lamps.T, sigma)
        matrices = (weights.T @ products).reshape(-1, 3, 3) + ridge
        right = ((weights * relative).T @ vectors)[..., None]
        lamps = np.asarray(np.linalg.solve(matrices, right)[..., 0])
    return lamps


def _reconsidered(relative: Array, usable: Mask, vectors: Array, lamps: Array) -> Array:
    """Lamps, each of which is replaced by one from three pixels where that leaves a lower loss.

    A lamp that began wrong, at the samples of pixels in its shadow, calls all others outliers and
    stays: its own loss has a minimum there.
    """
    draws = np.random.default_rng(1)
    found = lamps.copy()
    for n in range(len(lamps)):
        lit = np.flatnonzero(usable[:, n] & (relative[:, n] >= DARK))
        sample = np.flatnonzero(usable[:, n])
        if len(lit) < 3:
            continue
        sample = draws.choice(sample, min(len(sample), 2 * JUDGING), replace=False)
        triples = lit[draws.integers(0, len(lit), (DRAWS, 3))]
        volume = np.abs(np.linalg.det(vectors[triples]))
        triples = triples[volume > 0.01 * volume.max() + np.finfo(np.float64).tiny]
        if not len(triples):
            continue
        solved = np.linalg.solve(vectors[triples], relative[triples, n][..., None])[..., 0]
        tried = np.concatenate([lamps[n : n + 1], solved])
        predicted = np.maximum(vectors[sample] @ tried.T, 0.0)
        squared = ((relative[sample, n][:, None] - predicted) / JUDGED_SCALE) ** 2
        found[n] = tried[(squared / (1 + squared)).sum(axis=0).argmin()]
    return found


def _whitened(lamps: Array) -> tuple[Array, Array]:
    """S with SᵀS/N = 1 of the same span, and R with S_before = S Rᵀ: b of the new S is b R."""
    orthonormal, upper = np.linalg.qr(lamps)
    root = np.sqrt(len(lamps))
    return orthonormal * root, upper.T / root


def _largest_sine(first: Array, second: Array) -> float:
    """Of the angles between the spaces of two whitened (N, 3)."""
    cosines = np.linalg.svd(first.T @ second / len(first), compute_uv=False)
    return float(np.sqrt(max(1 - cosines.min() ** 2, 0.0)))


def _ordered(relative: Array, usable: Mask, lamps: Array, vectors: Array, sigma: float) -> Factors:
    """Factors with the product's directions by size.

    With SᵀS/N = 1 the mean square of b·s over lamps is |b|². Shadows put something into a third
    direction even where lamps lie in a plane, but only in the samples that they fall on. So the
    rank is the least one with which the samples that follow three are hardly farther off.
    """
    weights = weights_of(relative, usable, vectors @ lamps.T, sigma)
    # b of a pixel that few samples tell of is anything: it would be most of a mean of squares.
    length = np.linalg.norm(vectors, axis=1)
    shares = weights.sum(axis=1) * (length <= LENGTH_MAX * np.median(length))
    mean = np.einsum("p,px,py->xy", shares, vectors, vectors) / max(shares.sum(), 1e-300)
    squared, turned = np.linalg.eigh(mean)
    order = np.argsort(-squared)
    sizes = np.sqrt(np.maximum(squared[order], 0.0))
    lamps = lamps @ turned[:, order]
    follows = usable & (relative >= DARK) & (weights >= INLIER)
    residuals = [_residual(relative, follows, lamps[:, :rank]) for rank in (1, 2, 3)]
    most = max(RANK_GAIN * residuals[2], SCALE_MIN)
    rank = 1 + int(np.argmax(np.array(residuals) <= most))
    return Factors(lamps, rank, sizes, sigma)


def _residual(relative: Array, follows: Mask, lamps: Array) -> float:
    """Median pixel's standard deviation of residuals under lamps (N, R) of a space of R directions.

    0 if no pixel has more samples than directions.
    """
    pictures, rank = lamps.shape
    padded = np.zeros((pictures, 3))
    padded[:, :rank] = lamps
    free = follows.sum(axis=1) - rank
    some = np.flatnonzero(free > 0)[:: max(len(relative) // (4 * JUDGING), 1)]
    if not len(some):
        return 0.0
    vectors = _solved(relative[some], follows[some], padded)
    squared = np.where(follows[some], relative[some] - vectors @ padded.T, 0.0) ** 2
    return float(np.median(np.sqrt(squared.sum(axis=1) / free[some])))
