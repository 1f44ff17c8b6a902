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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance, surface_of
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.values.arrays import Array, Mask

NOISE_MIN = 1e-4
"""Least σ, in units where the mean radiance is 0.4: below what 8 bits or float16 can tell."""

RELATIVE_MIN = 0.05
"""Least relative deviation of a sample of the mean radiance, √(γ/0.4), and least spread of the
logarithm of albedo: no surface is as diffuse as the model, no lamp as far away, and no surface
without light from others, to better than some per cent. After the last look lamps and shape are
found as if this were 0: renders obey the model."""

SHADOWS = 1e-3, 0.5
"""Bounds of the share of a picture's samples in cast shadows: with more, they would be the rule."""


class Judged(NamedTuple):
    """What noise makes of samples."""

    odds: Array
    """(P, N): ln of the odds that a sample is in no cast shadow; infinite where none is darker."""
    likelihoods: Array
    """(P,): ln of the likelihood of all samples of a pixel."""
    weights: Array
    """(P, N, 2, 3): what samples weigh in a sum of squares, in a cast shadow and in none."""

    def weighed(self, odds: Array | None = None) -> Array:
        """(P, N, 3): weights of samples, with odds (P, N) in place of their own if given."""
        shadowed, lit = self.weights[:, :, 0], self.weights[:, :, 1]
        ordinary = probability(self.odds if odds is None else odds)
        return np.asarray(shadowed + ordinary[..., None] * (lit - shadowed))


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

    relative_min: float = RELATIVE_MIN
    """Least `relative` that is found."""

    @classmethod
    def first(cls, pixels: LampPixels, *, proportional: bool = False) -> Noise:
        """Before anything was fitted."""
        # Shadows on 10 % of the samples are much.
        share, floor = np.full(pixels.pictures, 0.1), NOISE_MIN if proportional else 0.02
        return cls(floor, 0.15, share, proportional)

    def variance(self, pixels: LampPixels) -> Array:
        """(P, N, 3): s²."""
        return np.asarray(self.floor**2 + self.relative**2 * self._growth(pixels))

    def _growth(self, pixels: LampPixels) -> Array:
        level = np.maximum(pixels.samples, NOISE_MIN)
        return level**2 if self.proportional else MEAN_RADIANCE * level

    def judged(self, pixels: LampPixels, state: LampState) -> Judged:
        """Samples at a state.

        Channels of a sample share what is left of them, so they tell as much as one.
        """
        growth = self.relative**2 * (1.0 if self.proportional else MEAN_RADIANCE)
        shadows = np.clip(self.shadows, *SHADOWS)
        noise = self.floor, growth, self.proportional, NOISE_MIN
        given = pixels.weights, surface_of(state), noise, shadows
        return Judged(*pixels.under(state).judge(*given))

    def renewed(self, pixels: LampPixels, state: LampState, freedom: float) -> Noise:
        """From what is left; `freedom` is the share that the unknowns have not taken up."""
        values = pixels.weights > 0
        counted = over_channels(values) > 0
        ordinary = probability(self.judged(pixels, state).odds) * counted
        weights = (ordinary[..., None] * values).ravel()
        squares = np.square(pixels.residuals(radiance(pixels, state))).ravel() / freedom
        bright = self._growth(pixels).ravel()
        # What highlights leave says nothing of other samples.
        weights = weights * (bright < np.quantile(bright, 0.95))
        floor2, relative2 = self.floor**2, self.relative**2
        for _ in range(20):
            # The likelihood's equations, weighed by 1/variance²: two straight lines, given these.
            w = weights / np.maximum(floor2 + relative2 * bright, NOISE_MIN**2) ** 2
            a, b, c = w.sum(), (w * bright).sum(), (w * bright * bright).sum()
            d, e = (w * squares).sum(), (w * bright * squares).sum()
            determinant = a * c - b * b
            if determinant > 1e-12 * a * c:
                floor2, relative2 = (c * d - b * e) / determinant, (a * e - b * d) / determinant
            if floor2 < NOISE_MIN**2 or determinant <= 1e-12 * a * c:
                floor2 = NOISE_MIN**2
                relative2 = (e - b * floor2) / max(c, np.finfo(np.float64).tiny)
            if relative2 < self.relative_min**2:
                relative2 = self.relative_min**2
                floor2 = max((d - b * relative2) / max(a, 1e-300), NOISE_MIN**2)
        seen = np.maximum(counted.sum(axis=0), 1)
        share = (counted - ordinary).sum(axis=0) / seen
        floor, relative = float(np.sqrt(floor2)), float(np.sqrt(relative2))
        return replace(self, floor=floor, relative=relative, shadows=np.clip(share, *SHADOWS))


def seen_error(pixels: LampPixels, state: LampState, *, relative: bool = False) -> Array:
    """(P, N): Σ (√I − √y)² over the channels of a sample: about what the eye makes of differences.

    A highlight that is missing, or in a wrong place, counts more than shadows and what surfaces are
    not quite diffuse, however many samples these are.
    """
    shown = pixels.samples + pixels.residuals(radiance(pixels, state))
    if relative:
        # Near lamps: in proportion, of which no more than a factor of e counts.
        floor = 0.01 * MEAN_RADIANCE
        logs = np.log(np.maximum(shown, 0) + floor) - np.log(np.maximum(pixels.samples, 0) + floor)
        return np.asarray((pixels.weights * np.minimum(logs**2, 1.0)).sum(axis=2))
    roots = np.sqrt(np.maximum(shown, 0)) - np.sqrt(np.maximum(pixels.samples, 0))
    return np.asarray((pixels.weights * roots**2).sum(axis=2))


def kept_and_judged(pictures: int) -> tuple[Mask, Mask]:
    """(N,) each: pictures that surfaces are fitted to, and the third that judges; all if few."""
    kept = np.ones(pictures, bool)
    if pictures < 4:  # three others are nine samples for five unknowns, if roughness is held
        return kept, kept
    kept[1::3] = False
    return kept, ~kept


def over_channels(values: NDArray[Any]) -> Array:
    """(...,): sums of (..., 3), several times as fast as along an axis so short."""
    return np.asarray(np.add(values[..., 0], values[..., 1], dtype=np.float64) + values[..., 2])


def probability(odds: Array) -> Array:
    """Of ln odds."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -50, 50))))
