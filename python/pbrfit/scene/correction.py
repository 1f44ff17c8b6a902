"""What undoes a camera's tone curve and vignetting, before pictures are fitted.

With c the radiance that arrives from a direction, over a reference, and ρ the distance from the
middle of the picture, 1 in its corners, a camera shows

    y = R(c V(ρ))        ln V = −v₁ ρ² − v₂ ρ⁴        ln R(c) = l − θ₀ l − θ₁ b₁(l) − θ₂ b₂(l)

with l = ln c, b₁ = min(l − ln ⅓, 0) and b₂ = max(l − ln 3, 0): a curve of three straight pieces in
logarithms, whose slopes stay positive. Below 1/50 its gain is constant, for noise has values of any
sign there. A common factor is left to the lights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DARKEST = math.log(1 / 50)
KNEES = math.log(1 / 3), math.log(3)
"""Logarithms of radiance over the reference between which the curve's pieces lie."""

BRIGHTEST = math.log(1e12)
"""Up to where the last piece is written down."""

SLOPE_CHANGE_MAX = 0.6
"""Largest change of a slope of the curve from 1: it stays positive."""

SLOPES, FALLOFF = (0, 1, 2), (3, 4)
"""Which numbers are the curve's and which the vignetting's."""


@dataclass(frozen=True)
class Correction:
    """A tone curve and a vignetting that are undone."""

    reference: float
    """Radiance, in picture units."""
    numbers: tuple[float, ...] = (0.0,) * 5
    """θ₀, θ₁, θ₂, v₁, v₂."""

    def changed(self, index: int, value: float) -> Correction:
        """With another number; slopes stay positive."""
        numbers = list(self.numbers)
        numbers[index] = float(value)
        low, middle, high = numbers[1], numbers[0], numbers[2]
        middle = min(max(middle, -SLOPE_CHANGE_MAX), SLOPE_CHANGE_MAX)
        sides = (
            min(max(middle + side, -SLOPE_CHANGE_MAX), SLOPE_CHANGE_MAX) - middle
            for side in (low, high)
        )
        return replace(self, numbers=(middle, *sides, *numbers[3:]))

    def applied(self, samples: NDArray[np.floating[Any]], radius_squared: Array) -> Array:
        """Radiance (..., C) of samples (..., C), where ρ² is `radius_squared` (...)."""
        knots = np.array([DARKEST, *KNEES, BRIGHTEST])
        shown = knots - sum(
            number * basis for number, basis in zip(self.numbers, _bases(knots), strict=False)
        )
        logarithm = np.log(np.maximum(samples / self.reference, math.exp(shown[0])))
        gain = np.exp(np.interp(logarithm, shown, knots) - logarithm)
        first, second = (self.numbers[i] for i in FALLOFF)
        even = np.exp(first * radius_squared + second * radius_squared**2)
        return np.asarray(samples * gain * even[..., None])

    def directions(self, radiance: Array, radius_squared: Array) -> tuple[list[Array], Array]:
        """∂c/∂ of each number where y stays, and ∂y/∂c, at radiance c (..., C), in picture units.

        Of what a model shows, which has no noise: the noise of the pictures would be taken for a
        curve wherever it is not the same in bright and dark.
        """
        first, second = (self.numbers[i] for i in FALLOFF)
        shade = np.exp(-first * radius_squared - second * radius_squared**2)[..., None]
        arriving = radiance * shade
        logarithm = np.log(np.maximum(arriving / self.reference, math.exp(DARKEST)))
        bases = _bases(logarithm)
        inside = logarithm > DARKEST
        slope = 1.0 - inside * (
            self.numbers[0]
            + self.numbers[1] * (logarithm < KNEES[0])
            + self.numbers[2] * (logarithm > KNEES[1])
        )
        found = [radiance * basis / slope for basis in bases]
        rho = radius_squared[..., None]
        found += [radiance * rho, radiance * rho**2]
        bent = sum(number * basis for number, basis in zip(self.numbers, bases, strict=False))
        return found, np.asarray(np.exp(-bent) * slope * shade)

    def in_words(self) -> dict[str, str]:
        """What is undone, by topic."""
        words = {}
        if any(self.numbers[i] for i in SLOPES):
            middle, low, high = self.numbers[:3]
            slopes = ", ".join(f"{1 - middle - side:.2f}" for side in (low, 0.0, high))
            words["response"] = f"a tone curve was fitted and undone, of exponents {slopes}"
        if any(self.numbers[i] for i in FALLOFF):
            corner = 1 - math.exp(-sum(self.numbers[i] for i in FALLOFF))
            words["vignetting"] = f"fitted and undone, {100 * corner:.0f} % in the corners"
        return words


def _bases(logarithm: Array) -> list[Array]:
    """Of the curve, at ln c."""
    return [logarithm, np.minimum(logarithm - KNEES[0], 0.0), np.maximum(logarithm - KNEES[1], 0.0)]


def radius_squared(height: int, width: int) -> Array:
    """(height, width): ρ² of pixels, 1 in the corners of the picture."""
    y, x = (np.arange(count) + 0.5 - count / 2 for count in (height, width))
    return np.asarray((y[:, None] ** 2 + x**2) / ((height / 2) ** 2 + (width / 2) ** 2))
