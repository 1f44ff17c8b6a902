"""What undoes a camera's tone curve, before pictures are fitted.

With c the radiance over a reference and l = ln c, a camera shows R(c),

    ln R = l − θ₀ l − θ₁ b₁(l) − θ₂ b₂(l),    b₁ = min(l − ln ⅓, 0),    b₂ = max(l − ln 3, 0):

a curve of three straight pieces in logarithms, whose slopes stay positive. Below 1/50 its gain is
constant, for noise has values of any sign there. A common factor is left to the lights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.values.arrays import Array, Floats

DARKEST = math.log(1 / 50)
KNEES = math.log(1 / 3), math.log(3)
"""Logarithms of radiance over the reference between which the curve's pieces lie."""

BRIGHTEST = math.log(1e12)
"""Up to where the last piece is written down."""

SLOPE_CHANGE_MAX = 0.6
"""Largest change of a slope of the curve from 1: it stays positive."""


@dataclass(frozen=True)
class Correction:
    """A tone curve that is undone."""

    reference: float
    """Radiance, in picture units."""
    numbers: tuple[float, ...] = (0.0,) * 3
    """θ₀, θ₁, θ₂."""

    def changed(self, index: int, value: float) -> Correction:
        """With another number; slopes stay positive."""
        numbers = list(self.numbers)
        numbers[index] = float(value)
        middle, *sides = numbers
        limits = -SLOPE_CHANGE_MAX, SLOPE_CHANGE_MAX
        middle = float(np.clip(middle, *limits))
        sides = (np.clip(np.add(middle, sides), *limits) - middle).tolist()
        return replace(self, numbers=(middle, *sides))

    def applied(self, samples: Floats) -> Array:
        """Radiance of samples (...)."""
        knots = np.array([DARKEST, *KNEES, BRIGHTEST])
        shown = knots - self._bent(knots)
        logarithm = np.log(np.maximum(samples / self.reference, math.exp(shown[0])))
        return np.asarray(samples * np.exp(np.interp(logarithm, shown, knots) - logarithm))

    def directions(self, radiance: Array) -> tuple[list[Array], Array]:
        """∂c/∂ of each number where R stays, and ∂R/∂c, at radiance c (...), in picture units.

        Of what a model shows, which has no noise: the noise of the pictures would be taken for a
        curve wherever it is not the same in bright and dark.
        """
        logarithm = np.log(np.maximum(radiance / self.reference, math.exp(DARKEST)))
        slope = 1.0 - (logarithm > DARKEST) * (
            self.numbers[0]
            + self.numbers[1] * (logarithm < KNEES[0])
            + self.numbers[2] * (logarithm > KNEES[1])
        )
        found = [radiance * basis / slope for basis in _bases(logarithm)]
        return found, np.asarray(np.exp(-self._bent(logarithm)) * slope)

    def in_words(self) -> str:
        """What is undone."""
        middle, low, high = self.numbers
        slopes = ", ".join(f"{1 - middle - side:.2f}" for side in (low, 0.0, high))
        return f"a tone curve was fitted and undone, of exponents {slopes}"

    def _bent(self, logarithm: Array) -> Array:
        """Of ln c the logarithm that R lacks of it."""
        return np.asarray(np.tensordot(self.numbers, _bases(logarithm), axes=1))


def _bases(logarithm: Array) -> list[Array]:
    """Of the curve, at ln c."""
    return [
        logarithm,
        np.minimum(logarithm - KNEES[0], 0.0),
        np.maximum(logarithm - KNEES[1], 0.0),
    ]
