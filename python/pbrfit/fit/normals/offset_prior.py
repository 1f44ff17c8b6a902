"""The prior on tangent offsets: errors of normals are alike nearby.

Errors of estimated normals are no noise: they are alike over neighbouring pixels, and often over
the whole picture. So the tangent offsets δ = (a, b) of neighbours are drawn to each other,

    s² Σ_pq w_pq u_pq |δ_p − δ_q|² / σ²  +  s² Σ_p |δ_p|² / σ₀²

beside the sum of squared residuals, with the noise's variance s², edge-aware weights w and
u = 1/(1 + d²/c²) of Student's kind for the few large steps d = |δ_p − δ_q| / σ at outlines. The
second term is weak: lights can follow a turn that all normals have in common at little cost.

σ is found from the offsets themselves, by expectation and maximisation,

    σ² = Σ w u (|δ_p − δ_q|² + tr V_p + tr V_q) / 2 Σ w u

where V_p is the covariance of δ_p that is left.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.sampling import pairs_apart

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pairs of pixels, and how far their normals' changes are expected to be alike."""

    pairs: NDArray[np.intp]
    """(E, 2) indices."""
    weights: Array
    """(E,): w = e^(−|Δn|²/0.1) of the given normals, less where these are known to be unsure."""
    count: int

    @classmethod
    def of(
        cls, index: NDArray[np.intp], normals: Array, normal_sigma: Array | None
    ) -> Neighbourhood:
        """Of pixels beside and below each other, by their `index` at row and column, or −1.

        Where the given normals (P, 3) of a pair are twice as unsure as the mean by `normal_sigma`
        (P,), in any unit, their changes may differ twice as far.
        """
        first, second = pairs = np.concatenate(pairs_apart(index), axis=1)
        difference = normals[first] - normals[second]
        squared = np.einsum("ed,ed->e", difference, difference)
        weights = np.exp(-squared / settings.NORMALS_EDGE_SCALE)
        if normal_sigma is not None and normal_sigma.any():
            mean = normal_sigma.mean()
            of_pairs = 0.5 * (normal_sigma[first] + normal_sigma[second])
            weights /= (np.maximum(of_pairs, settings.NORMALS_GIVEN_SIGMA_MIN * mean) / mean) ** 2
        return cls(pairs.T, weights, len(normals))

    def sums(self, values: Array, weights: Array) -> Array:
        """Σ over the neighbours of each pixel of `weights` (E,) times their `values` (P, ·)."""
        first, second = self.pairs.T
        found = np.zeros_like(values)
        for column in range(values.shape[1]):
            found[:, column] = np.bincount(
                first, weights * values[second, column], minlength=self.count
            ) + np.bincount(second, weights * values[first, column], minlength=self.count)
        return found


@dataclass(frozen=True, eq=False)
class TangentOffsetPrior:
    """The penalty on tangent offsets (P, 2) of some pixels, for noise of variance s²."""

    neighbourhood: Neighbourhood
    sigma: float = settings.NORMALS_OFFSET_SIGMA_START
    """σ, in radians."""
    robust_weights: Array = field(default_factory=lambda: np.ones(1))
    """(E,): u, or (1,) where all are alike."""

    def conditional(self, offsets: Array, variance: float) -> tuple[Array, Array]:
        """Mean (P, 2) and precision (P, 2) of each pixel's offset while the others stay."""
        weights = self.neighbourhood.weights / self.sigma**2 * self.robust_weights
        of_pairs = self.neighbourhood.sums(np.ones((len(offsets), 1)), weights)
        own = of_pairs + 1 / settings.NORMALS_OFFSET_SIGMA_ALONE**2
        mean = self.neighbourhood.sums(offsets, weights) / own
        return mean, np.repeat(variance * own, 2, axis=1)

    def fitted(self, offsets: Array, variances: Array) -> TangentOffsetPrior:
        """With σ and u from offsets (P, 2) and the variance that is left of each, tr V (P,)."""
        first, second = self.neighbourhood.pairs.T
        difference = offsets[second] - offsets[first]
        squared = np.einsum("ed,ed->e", difference, difference)
        squared = squared + variances[first] + variances[second]
        of_half_weight = 2 * settings.NORMALS_HALF_WEIGHT_STEP**2 * self.sigma**2
        robust_weights = 1 / (1 + squared / of_half_weight)
        weights = self.neighbourhood.weights * robust_weights
        total = float(weights.sum())
        if not total > 0:  # there are no pairs, or none that could be alike
            return self
        sigma = np.sqrt(float(weights @ squared) / (2 * total))
        sigma = float(np.clip(sigma, *settings.NORMALS_OFFSET_SIGMA_RANGE))
        return replace(self, sigma=sigma, robust_weights=robust_weights)
