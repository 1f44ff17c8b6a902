"""Matt shading: the pseudo-normal of each pixel under known lamps, and unknown lamps with them.

A diffuse surface under a distant lamp s, its direction times its strength, has the radiance

    I_n = max(b·s_n, 0),    b = albedo times normal, the pseudo-normal

(Woodham, "Photometric method for determining surface orientation from multiple images", Optical
Engineering 19, 1980). Three lamps tell b. Of more, some samples do not follow the law: highlights
lie above it, cast shadows below, and a sample whose lamp is behind the surface says only b·s ≤ 0.
So b is the one with the least

    Σ_n ρ((I_n - max(b·s_n, 0)) / (σ q)),    ρ(x) = x²/(1 + x²),

the loss of Geman and McClure: a sample that is far off costs 1, however far. q is the brightness of
the pixel, the median of its samples: what the law leaves out, gloss and light from other surfaces,
grows with the light that arrives. σ is the same for all pixels. The loss has several minima, so it
is looked at for the b of many triples of samples (Fischler and Bolles, "Random sample consensus",
Communications of the ACM 24, 1981), and repeated weighted least squares start at the best of them.

**Unknown lamps**, up to a matrix. Of P pixels in N pictures the radiance is I = B Sᵀ, B (P, 3) of
pseudo-normals and S (N, 3) of lamps, wherever b·s > 0; any invertible A gives B A and S A⁻ᵀ the
same pictures (Hayakawa, "Photometric stereo under a light source with arbitrary motion", Journal of
the Optical Society of America A 11, 1994). Shadows, highlights and clipped samples do not belong to
the product. So instead of a singular value decomposition, which has no place for missing entries,
pixels and pictures take turns: b of each pixel under the lamps so far, then s of each picture by
the same robust loss over pixels. The loss has minima of its own, so its scale σ falls from wide to
what the residuals say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.samples import Pixels, some_of
from pbrfit.fit.sampling import slices
from pbrfit.fit.settings import PIXELS_AT_ONCE
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array, Mask

TRIPLES_MAX = 48
"""Triples of samples that a pixel's start is chosen from. If 40 % of the samples follow the law,
48 random triples hold one without an outlier with a probability of 1 - (1 - 0.4³)^48 = 96 %."""

SCALE_MIN = 0.01
"""Smallest σ, of a pixel's brightness. A step of 8 bits of sRGB is 0.9 % of the radiance at middle
grey: below it, differences are those of the file."""

SCALE_START = 0.1
"""σ from which it is found: highlights and shadows differ by more, shading that is not quite
Lambertian by less."""

SCALE_PIXELS = 1 << 16
"""Pixels that tell σ: the error of a median of a dozen samples of each is below a thousandth."""

ROUNDS = 8
"""Rounds of weighted least squares at a pixel."""

DARK = 0.02
"""Share of a pixel's brightness, or of a picture's, below which a sample is dark: it is told to be
in shadow and says nothing of b. Interreflections bring a few per cent into shadows."""


@dataclass(frozen=True, eq=False)
class PseudoNormals:
    """What the samples of P pixels say under N lamps."""

    vectors: Array
    """(P, 3) b. In directions that a pixel's samples say nothing of it is 0."""
    relative: Array
    usable: Mask
    """(P, N) the samples, over their pixel's brightness, and which of them are usable."""
    lamps: Array
    """(N, 3) s."""
    sigma: float
    """σ of all pixels."""

    def weights(self, pixels: Pixels) -> Array:
        """(p, N) in [0, 1] of some of the pixels: how much each sample counts; 0 in shadow."""
        predicted = self.vectors[pixels] @ self.lamps.T
        return weights_of(self.relative[pixels], self.usable[pixels], predicted, self.sigma)

    def precision(self, pixels: Pixels, inverse: Array) -> Array:
        """(p, 3, 3): inverse of the covariance of b G, G⁻¹ (Σ_n w s sᵀ/σ²) G⁻ᵀ."""
        of_vectors = moments(self.weights(pixels), self.lamps) / self.sigma**2
        return np.asarray(inverse @ of_vectors @ inverse.T)

    def information(self, inverse: Array, threads: int) -> Array:
        """(P, 3) eigenvalues of that, the least first."""

        def of(piece: slice) -> Array:
            return np.asarray(np.linalg.eigvalsh(self.precision(piece, inverse)))

        pieces = slices(len(self.vectors), PIXELS_AT_ONCE)
        return np.concatenate(in_pieces(threads, of, pieces))


def pseudo_normals(relative: Array, usable: Mask, lamps: Array, threads: int = 0) -> PseudoNormals:
    """The pseudo-normal of each pixel, divided by its brightness, under known lamps.

    By radiance (P, N), divided by the pixel's brightness, of samples of which some are usable;
    lamps (N, 3) are direction times strength.
    """
    pieces = slices(len(relative), PIXELS_AT_ONCE)

    def best(piece: slice) -> Array:
        return _best_of_triples(relative[piece], usable[piece], lamps)

    def better(piece: slice) -> Array:
        return refined(relative[piece], usable[piece], lamps, found[piece], sigma)

    found, sigma = np.concatenate(in_pieces(threads, best, pieces)), SCALE_START
    some = some_of(len(relative), SCALE_PIXELS)
    for _ in range(ROUNDS):
        found = np.concatenate(in_pieces(threads, better, pieces))
        sigma = scale_of(relative[some], usable[some], found[some] @ lamps.T)
    return PseudoNormals(found, relative, usable, lamps, sigma)


def refined(relative: Array, usable: Mask, lamps: Array, vectors: Array, sigma: float) -> Array:
    """Pseudo-normals (P, 3) after a round of weighted least squares at each pixel."""
    return solved(relative, weights_of(relative, usable, vectors @ lamps.T, sigma), lamps)


def moments(weights: Array, lamps: Array) -> Array:
    """Σ_n w s sᵀ, (P, 3, 3)."""
    products = (lamps[:, :, None] * lamps[:, None, :]).reshape(len(lamps), 9)
    return (weights @ products).reshape(-1, 3, 3)


def weights_of(relative: Array, usable: Mask, predicted: Array, sigma: float) -> Array:
    """Weights of samples: the slope of ρ by x², 1/(1 + x²)²; 0 of those that are dark."""
    residual = (relative - predicted) / sigma
    weights = 1 / (1 + residual**2) ** 2
    weights[(relative < DARK) | ~usable] = 0.0
    return weights


def solved(relative: Array, weights: Array, lamps: Array) -> Array:
    """Weighted least squares at each pixel; 0 in directions that samples say nothing of."""
    # The ridge is far below what any usable sample weighs: it decides only where nothing does.
    ridge = max(1e-9 * (lamps**2).sum() / len(lamps), 1e-300)  # lamps may all be dark
    matrices = moments(weights, lamps) + ridge * np.eye(3)
    return np.asarray(np.linalg.solve(matrices, ((weights * relative) @ lamps)[..., None])[..., 0])


def scale_of(relative: Array, usable: Mask, predicted: Array) -> float:
    """σ from the median residual of lit samples, less what three unknowns a pixel take of it."""
    lit = usable & (relative >= DARK)
    free = np.maximum(lit.sum(axis=1) - 3, 0).sum() / max(np.count_nonzero(lit), 1)
    if free == 0:
        return SCALE_MIN
    median = np.median(np.abs((relative - predicted)[lit]))
    return float(np.clip(1.4826 * median / np.sqrt(free), SCALE_MIN, SCALE_START))


def _triples(lamps: Array) -> NDArray[np.intp]:
    """(T, 3) triples of lamps that span space best, spread over all lamps; always the same ones."""
    draws = np.random.default_rng(0)
    order = draws.permuted(np.tile(np.arange(len(lamps)), (8 * TRIPLES_MAX, 1)), axis=1)
    chosen = np.unique(np.sort(order[:, :3], axis=1), axis=0)
    length = np.linalg.norm(lamps, axis=1, keepdims=True)
    unit = lamps / np.maximum(length, np.finfo(np.float64).tiny)
    volume = np.abs(np.linalg.det(unit[chosen]))
    # Of a triple's own noise, what reaches b grows as 1/volume: the half that amplifies it least,
    # thinned at random so that all lamps take part.
    good = chosen[volume >= max(np.median(volume), 1e-3 * volume.max())]
    return draws.permutation(good)[:TRIPLES_MAX]


def _best_of_triples(relative: Array, usable: Mask, lamps: Array) -> Array:
    """The b of a triple of samples, of each pixel, with the least robust misfit."""
    plain = solved(relative, (usable & (relative >= DARK)).astype(np.float64), lamps)
    singular = np.linalg.svd(lamps, compute_uv=False)
    if len(lamps) < 4 or singular[2] < 1e-3 * singular[0]:
        return plain
    # Only a start is chosen: half the digits do.
    triples, of_lamps = _triples(lamps), lamps.T.astype(np.float32)
    inverses = np.linalg.inv(lamps[triples]).astype(np.float32)  # b = S⁻¹ I
    best = np.empty_like(plain)
    step = max((1 << 16) // (len(triples) * len(lamps)), 1)  # half a megabyte, which caches hold
    for first in range(0, len(relative), step):
        part = slice(first, first + step)
        here, used = relative[part].astype(np.float32), usable[part]
        tried = np.einsum("txk,ptk->ptx", inverses, here[:, triples])
        tried = np.concatenate([tried, plain[part, None].astype(np.float32)], axis=1)
        apart = (here[:, None] - np.maximum(tried @ of_lamps, 0)) / np.float32(SCALE_START)
        # Σ ρ is least where Σ 1 − ρ = Σ 1/(1 + x²) is most.
        agreed = (used[:, None] / (1 + np.square(apart))).sum(axis=2)
        agreed[:, :-1][~used[:, triples].all(axis=2)] = -1
        best[part] = tried[np.arange(len(here)), agreed.argmax(axis=1)]
    return best


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
