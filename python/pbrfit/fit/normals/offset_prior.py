"""What is thought likely of the change of normals before pictures tell: it is alike nearby.

Errors of estimated normals are no noise: they are alike over neighbouring pixels, and often over
the whole picture. So the changes δ = (a, b) of neighbours are drawn to each other,

    s² Σ_pq w_pq u_pq |δ_p − δ_q|² / σ²  +  s² Σ_p |δ_p|² / σ₀²

beside the sum of squares, with the noise's variance s², edge-aware weights w and u = 1/(1 + d²/c²)
of Student's kind for the few large steps d = |δ_p − δ_q| / σ at outlines. The second term is weak
on purpose: counted once a pixel, a stronger one would hold back a turn that all normals have in
common, which lights can follow at little cost.

σ is not told. It is found from the changes themselves, by expectation and maximisation,

    σ² = Σ w u (|δ_p − δ_q|² + tr V_p + tr V_q) / 2 Σ w u

where V_p is what is still uncertain of δ_p.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.normals.strided_subset import Neighbourhood

Array = NDArray[np.float64]

LOOSEST = np.radians(60.0)
"""σ₀."""

FIRST_SPREAD = np.radians(6.0)
SMALLEST_SPREAD, LARGEST_SPREAD = np.radians(0.05), np.radians(12.0)
"""σ: at first, and between which it may be found."""

HEAVY = 3.0
"""c: steps of so many σ count half."""


@dataclass(frozen=True, eq=False)
class TiltPrior:
    """The penalty on tilts (P, 2) of some pixels.

    Attributes
    ----------
    around
        Which pixels are neighbours.
    spread
        σ, in radians.
    robust
        (E,): u.
    """

    around: Neighbourhood
    spread: float = FIRST_SPREAD
    robust: Array | None = None

    @property
    def _weights(self) -> Array:
        of_pairs = self.around.weights / self.spread**2
        return of_pairs if self.robust is None else of_pairs * self.robust

    def cost(self, tilts: Array, variance: float) -> float:
        """The penalty for noise of this variance s²."""
        alike = float(self._weights @ self.around.squares(tilts))
        return float(variance * (alike + np.square(tilts).sum() / LOOSEST**2))

    def slope(self, tilts: Array, variance: float) -> Array:
        """Half of its gradient, (P, 2)."""
        weights = self._weights
        own = self.around.degrees(weights) + 1 / LOOSEST**2
        return np.asarray(variance * (own[:, None] * tilts - self.around.sums(tilts, weights)))

    def diagonal(self, variance: float) -> Array:
        """Of half of its second derivatives, (P,), the same for a and b."""
        return np.asarray(variance * (self.around.degrees(self._weights) + 1 / LOOSEST**2))

    def coupling(self, variance: float) -> Array:
        """Half of the second derivative by the tilts of each pair, (E,)."""
        return np.asarray(-variance * self._weights)

    def beside_others(self, tilts: Array, variance: float) -> tuple[Array, Array]:
        """Centre (P, 2) and precision (P, 2) that each pixel feels while the others stay."""
        own = self.around.degrees(self._weights) + 1 / LOOSEST**2
        centre = self.around.sums(tilts, self._weights) / own[:, None]
        return centre, np.repeat(variance * own[:, None], 2, axis=1)

    def learnt(self, tilts: Array, uncertain: Array) -> TiltPrior:
        """With σ and u from tilts (P, 2) and what is uncertain of them, tr V (P,)."""
        first, second = self.around.pairs.T
        if not len(first):
            return self
        squares = self.around.squares(tilts) + uncertain[first] + uncertain[second]
        robust = 1 / (1 + squares / (2 * HEAVY**2 * self.spread**2))
        weights = self.around.weights * robust
        total = float(weights.sum())
        if not total > 0:
            return self
        spread = np.sqrt(float(weights @ squares) / (2 * total))
        spread = float(np.clip(spread, SMALLEST_SPREAD, LARGEST_SPREAD))
        return replace(self, spread=spread, robust=robust)
