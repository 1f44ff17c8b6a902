"""How far samples under lamps may be off: noise, misfit of the lobe, and outliers.

An ordinary sample has a normal distribution around the model's radiance I = I_d + I_s, of a diffuse
part and a lobe, with the variance

    s² = σ² + (κ I)² + (κ_s I_s)²:

noise of the camera and what is proportional to the light, and `LOBE_MISFIT`, because no measured
lobe has the shape that the model's has (A. Ngan, F. Durand and W. Matusik, "Experimental analysis of
BRDF models", EGSR 2005). An outlier, in a cast shadow or where a neighbour is mirrored, may be a
factor of e or more off on either side: ln y − ln I has a Laplace distribution of scale 1, which in
shadows is a uniform one of y in [0, I],

    p(y | outlier) = 1/(2 I) for y < I,     I/(2 y²) for y > I.

So a highlight that is shown where there is none costs more the brighter it is. As a sum of squares
Σ w (I − y)² a sample counts P/s² + (1 − P)/(I |I − y|), or y in place of I if that is more, with the
probability P that it is ordinary: the weights that have the gradient of the likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance

Array = NDArray[np.float64]

NOISE_MIN = 1e-4
"""Least σ, in units where the mean radiance is 0.4: below what 8 bits or float16 can tell."""

RELATIVE_MIN = 0.005
"""Least κ: lamps that are a per cent larger or nearer than taken make as much."""

LOBE_MISFIT = 0.3
"""κ_s: the root mean square error of the best fits of one lobe to measured highlights is some tens
of per cent."""

OUTLIERS_MIN, OUTLIERS_MAX = 1e-3, 0.5
"""Bounds of the share of outliers in a picture: with more than a half, they would be the rule."""

FIRST_FLOOR, FIRST_RELATIVE, FIRST_OUTLIERS = 0.02, 0.1, 0.1
"""σ, κ and outliers before anything was fitted, for which 10 % are much."""

ROUNDS = 20
"""Of the equations for σ and κ, which are linear given the variances."""


@dataclass(frozen=True, eq=False)
class Left:
    """What a state leaves of samples, (P, N, 3) each."""

    residuals: Array
    level: Array
    """The model's radiance, or the sample if it is more."""
    lobe: Array
    """What of the level is no diffuse reflection."""
    counted: NDArray[np.bool_]
    """(P, N): samples that are data."""

    @classmethod
    def of(cls, pixels: LampPixels, state: LampState, shown: Array | None = None) -> Left:
        """At a state, whose radiance may be known."""
        shown = radiance(pixels, state) if shown is None else shown
        directions, strengths = state.incident(pixels)
        cosines = np.maximum(np.einsum("px,pkx->pk", state.normals, directions), 0) * strengths
        diffuse = np.zeros(shown.shape)
        for k, picture in enumerate(state.lamps.pictures):
            diffuse[:, picture] += cosines[:, k, None] * state.lamps.colors[k]
        diffuse *= (state.albedo * (1 - state.metallic[:, None]))[:, None]
        level = np.maximum(np.maximum(shown, pixels.samples), NOISE_MIN)
        lobe = np.maximum(shown - diffuse, 0.0)
        return cls(pixels.residuals(shown), level, lobe, (pixels.weights > 0).any(axis=-1))


@dataclass(frozen=True, eq=False)
class Noise:
    """Of samples under lamps."""

    floor: float
    """σ, in the pictures' scale."""
    relative: float
    """κ."""
    outliers: Array
    """(N,): share of outliers of each picture."""

    @classmethod
    def first(cls, pixels: LampPixels) -> Noise:
        """Before anything was fitted."""
        share = np.full(pixels.pictures, FIRST_OUTLIERS)
        return cls(FIRST_FLOOR, FIRST_RELATIVE, share)

    def variance(self, left: Left) -> Array:
        """(P, N, 3): s²."""
        of_lobe = (LOBE_MISFIT * left.lobe) ** 2
        return np.asarray(self.floor**2 + (self.relative * left.level) ** 2 + of_lobe)

    def log_odds(self, left: Left) -> Array:
        """(P, N): ln of the odds that a sample is ordinary.

        Its channels share what is left of them, so they tell as much as one.
        """
        variance = self.variance(left)
        misfit = 0.5 * (np.square(left.residuals) / variance).mean(axis=-1)
        density = 0.5 * np.log(2 * np.pi * variance).mean(axis=-1)
        share = np.clip(self.outliers, OUTLIERS_MIN, OUTLIERS_MAX)
        return np.asarray(np.log(1 / share - 1) - misfit - density - self._log_outlier(left))

    def _log_outlier(self, left: Left) -> Array:
        """(P, N): ln of the density of a sample that is an outlier."""
        level = left.level.mean(axis=-1)
        over = left.residuals.mean(axis=-1)
        shown = np.where(over > 0, level, np.maximum(level + over, NOISE_MIN))
        return np.asarray(np.log(shown) - 2 * np.log(level) - np.log(2))

    def log_likelihoods(self, left: Left) -> Array:
        """(P, N): ln of the likelihood of samples, ordinary or not; 0 of those that are no data."""
        share = np.clip(self.outliers, OUTLIERS_MIN, OUTLIERS_MAX)
        each = np.log(share) + self._log_outlier(left) + np.logaddexp(0, self.log_odds(left))
        return np.asarray(each * left.counted)

    def weights(self, left: Left, odds: Array | None = None) -> Array:
        """(P, N, 3): what samples weigh in a sum of squares; `odds` (P, N) replace their own."""
        odds = self.log_odds(left) if odds is None else odds
        ordinary = probability(odds)[..., None]
        variance = self.variance(left)
        # No outlier weighs more than it would as an ordinary sample.
        of_outliers = np.minimum(
            1 / (left.level * np.maximum(np.abs(left.residuals), NOISE_MIN)), 1 / variance
        )
        return np.asarray(ordinary / variance + (1 - ordinary) * of_outliers)

    def renewed(self, left: Left, freedom: float) -> Noise:
        """From what is left; `freedom` is the share that the unknowns have not taken up."""
        ordinary = probability(self.log_odds(left)) * left.counted
        weights = np.repeat(ordinary[..., None], 3, axis=-1).ravel()
        squares = np.square(left.residuals).ravel() / freedom
        squares = np.maximum(squares - (LOBE_MISFIT * left.lobe.ravel()) ** 2, 0)
        bright = np.square(left.level).ravel()
        lobe = (LOBE_MISFIT * left.lobe.ravel()) ** 2
        floor2, relative2 = self.floor**2, self.relative**2
        for _ in range(ROUNDS):
            # The likelihood's equations, weighed by 1/variance²: two straight lines.
            w = weights / np.maximum(floor2 + relative2 * bright + lobe, NOISE_MIN**2) ** 2
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
        seen = np.maximum(left.counted.sum(axis=0), 1)
        share = (left.counted - ordinary).sum(axis=0) / seen
        return Noise(
            float(np.sqrt(floor2)),
            float(np.sqrt(relative2)),
            np.clip(share, OUTLIERS_MIN, OUTLIERS_MAX),
        )


def probability(odds: Array) -> Array:
    """Of ln odds."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -50, 50))))
