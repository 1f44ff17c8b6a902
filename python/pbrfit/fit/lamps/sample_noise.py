"""How far samples under lamps may be off: what grows with the light, and cast shadows.

A sample y has a normal distribution around the model's radiance I with the variance

    s² = σ² + γ y,

as of photons, though what is left is mostly misfit. With a variance in proportion to y², as misfit
has it, the many samples that are diffuse would outvote the few that see a highlight; with an equal
one, a highlight would be all that counts. Variances are of samples, not of the model, so that a
model does not gain by showing what it would then be excused for.

What is darker than the model may be in a cast shadow, anything between 0 and I:

    p(y | shadow) = 1/I.

So a highlight that is shown where there is none costs more the brighter it is. Nothing excuses what
is brighter than the model: of outliers on both sides, highlights would be one. As a sum of squares
Σ w (I − y)² a sample counts P/s² + (1 − P)/(I |I − y|), with the probability P that it is in no
shadow: the weights that have the gradient of the likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance
from pbrfit.fit.settings import MEAN_RADIANCE

Array = NDArray[np.float64]

NOISE_MIN = 1e-4
"""Least σ, in units where the mean radiance is 0.4: below what 8 bits or float16 can tell."""

RELATIVE_MIN = 0.05
"""Least relative deviation of a sample of the mean radiance, √(γ/0.4): no surface is as diffuse as
the model, and no lamp as far away, to better than some per cent. Where pictures obey the model,
nothing is left, and weights do not matter."""

SHADOWS = 1e-3, 0.5
"""Bounds of the share of a picture's samples in cast shadows: with more, they would be the rule."""

FIRST_FLOOR, FIRST_RELATIVE, FIRST_SHADOWS = 0.02, 0.15, 0.1
"""σ, relative deviation and shadows before anything was fitted, for which 10 % are much."""

ROUNDS = 20
"""Number of times that the equations for σ and κ are solved, which are linear given the
variances."""


@dataclass(frozen=True, eq=False)
class Left:
    """What a state leaves of samples, (P, N, 3) each."""

    residuals: Array
    shown: Array
    """The model's radiance."""
    level: Array
    """The sample, or `NOISE_MIN`."""
    values: NDArray[np.bool_]
    """Those that are data."""

    @classmethod
    def of(cls, pixels: LampPixels, state: LampState) -> Left:
        """At a state."""
        shown = radiance(pixels, state)
        return cls(
            pixels.residuals(shown),
            np.maximum(shown, NOISE_MIN),
            np.maximum(pixels.samples, NOISE_MIN),
            np.asarray(pixels.weights > 0),
        )

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(P, N): samples of which some value is data."""
        return np.asarray(over_channels(self.values) > 0)

    @property
    def dark(self) -> NDArray[np.bool_]:
        """(P, N): samples that are darker than the model has them."""
        return np.asarray(over_channels(self.residuals) > 0)


@dataclass(frozen=True, eq=False)
class Noise:
    """Of samples under lamps."""

    floor: float
    """σ, in the pictures' scale."""
    relative: float
    """√(γ/0.4): relative, at the mean radiance."""
    shadows: Array
    """(N,): share of samples in cast shadows of each picture."""

    proportional: bool = False
    """Whether (κ y)² stands for γ y: near lamps light what is beside them a hundred times as much
    as the rest, and what is off is off in proportion."""

    @classmethod
    def first(cls, pixels: LampPixels, *, proportional: bool = False) -> Noise:
        """Before anything was fitted."""
        share = np.full(pixels.pictures, FIRST_SHADOWS)
        floor = NOISE_MIN if proportional else FIRST_FLOOR
        return cls(floor, FIRST_RELATIVE, share, proportional)

    def variance(self, left: Left) -> Array:
        """(P, N, 3): s²."""
        return np.asarray(self.floor**2 + self.relative**2 * self._growth(left.level))

    def _growth(self, level: Array) -> Array:
        return level**2 if self.proportional else MEAN_RADIANCE * level

    def log_odds(self, left: Left) -> Array:
        """(P, N): ln of the odds that a sample is in no cast shadow; infinite where it is brighter.

        Its channels share what is left of them, so they tell as much as one.
        """
        share = np.clip(self.shadows, *SHADOWS)
        odds = np.log(1 / share - 1) + self._log_ordinary(left) + np.log(_shown(left))
        return np.where(left.dark, odds, np.inf)

    def _log_ordinary(self, left: Left) -> Array:
        variance = self.variance(left)
        terms = np.square(left.residuals) / variance + np.log(2 * np.pi * variance)
        values = np.maximum(over_channels(left.values), 1)
        return np.asarray(-0.5 * over_channels(terms * left.values) / values)

    def log_likelihoods(self, left: Left) -> Array:
        """(P, N): ln of the likelihood of samples; 0 of those that are no data."""
        share = np.clip(self.shadows, *SHADOWS)
        ordinary = np.log(1 - share) + self._log_ordinary(left)
        shadow = np.log(share) - np.log(_shown(left))
        each = np.where(left.dark, np.logaddexp(ordinary, shadow), ordinary)
        return np.asarray(each * left.counted)

    def weights(self, left: Left, odds: Array | None = None) -> Array:
        """(P, N, 3): what samples weigh in a sum of squares; `odds` (P, N) replace their own."""
        odds = self.log_odds(left) if odds is None else odds
        ordinary = probability(odds)[..., None]
        variance = self.variance(left)
        # In a shadow no sample weighs more than in none.
        of_shadow = np.minimum(
            1 / (left.shown * np.maximum(np.abs(left.residuals), NOISE_MIN)), 1 / variance
        )
        return np.asarray(ordinary / variance + (1 - ordinary) * of_shadow)

    def renewed(self, left: Left, freedom: float) -> Noise:
        """From what is left; `freedom` is the share that the unknowns have not taken up."""
        counted = left.counted
        ordinary = probability(self.log_odds(left)) * counted
        weights = (ordinary[..., None] * left.values).ravel()
        squares = np.square(left.residuals).ravel() / freedom
        bright = self._growth(left.level.ravel())
        # What highlights leave says nothing of other samples.
        weights = weights * (bright < np.quantile(bright, 0.95))
        floor2, relative2 = self.floor**2, self.relative**2
        for _ in range(ROUNDS):
            # The likelihood's equations, weighed by 1/variance²: two straight lines.
            w = weights / np.maximum(floor2 + relative2 * bright, NOISE_MIN**2) ** 2
            a, b, c = w.sum(), (w * bright).sum(), (w * bright * bright).sum()
            d, e = (w * squares).sum(), (w * bright * squares).sum()
            determinant = a * c - b * b
            if determinant > 1e-12 * a * c:
                floor2, relative2 = (c * d - b * e) / determinant, (a * e - b * d) / determinant
            if floor2 < NOISE_MIN**2 or determinant <= 1e-12 * a * c:
                floor2 = NOISE_MIN**2
                relative2 = (e - b * floor2) / max(c, np.finfo(np.float64).tiny)
            if relative2 < RELATIVE_MIN**2:
                relative2 = RELATIVE_MIN**2
                floor2 = max((d - b * relative2) / max(a, 1e-300), NOISE_MIN**2)
        seen = np.maximum(counted.sum(axis=0), 1)
        share = (counted - ordinary).sum(axis=0) / seen
        floor, relative = float(np.sqrt(floor2)), float(np.sqrt(relative2))
        return replace(self, floor=floor, relative=relative, shadows=np.clip(share, *SHADOWS))


def _shown(left: Left) -> Array:
    """(P, N): the model's radiance, mean over channels."""
    return np.asarray(over_channels(left.shown) / 3)


def over_channels(values: NDArray[Any]) -> Array:
    """(...,): sums of (..., 3), several times as fast as along an axis so short."""
    return np.asarray(np.add(values[..., 0], values[..., 1], dtype=np.float64) + values[..., 2])


def probability(odds: Array) -> Array:
    """Of ln odds."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -50, 50))))
