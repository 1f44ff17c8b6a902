"""How much pictures can tell of a pixel: the numbers that independent lights show of it.

Pictures are linear in the light, so those under sums of R lights are the same sums of R pictures:
copies, exposures, tints and mixtures show nothing new. In C channels a pixel then has R C numbers.
Where its unknowns are as many, whatever is wrong is taken up and leaves no residual; where few
more, most of it: of an error of n numbers a fit of m unknowns leaves (n − m)/n.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pbrfit.fit.settings import EXACT_RMSE
from pbrfit.values.arrays import Array, Floats

NUMBERS_MIN = 1.5
"""Numbers of a pixel for each of its unknowns, below which the fit takes up more than two thirds of
what is wrong. Of 11 rooms under two lights, mixed or copied, six had wrong maps with small
deviations; of ten under three lights the two whose normals were refined."""


@dataclass(frozen=True)
class Shown:
    """What pictures show of a pixel, beside noise."""

    lights: tuple[int, ...]
    """Independent lights in each channel."""
    unknowns: float
    """Of a pixel, with its share of those of the lights; albedo counts where there is light."""

    @property
    def numbers(self) -> int:
        """Independent ones of a pixel."""
        return sum(self.lights)

    @property
    def is_nothing(self) -> bool:
        """Whether any surface explains the numbers."""
        return self.numbers <= self.unknowns

    @property
    def is_little(self) -> bool:
        """Whether residuals tell too little of what is wrong."""
        return self.numbers < NUMBERS_MIN * self.unknowns

    @classmethod
    def by(
        cls,
        pictures: Array,
        variance: float,
        weights: Floats | None,
        unknowns: float,
        of_light: float = 0.0,
    ) -> Shown:
        """Of pictures (N, Q, C) with noise of this variance at weight 1.

        `weights` (N, Q, 1 or C) are the samples'; pixels without all samples are left out if some
        have them. Of `unknowns` a pixel has one for each channel; `of_light` are those of one
        light's, in all channels, by pixel.

        Noise alone gives the pictures' Gram matrix, by pixel, eigenvalues up to s² (1 + √(N/Q))²
        (V. Marčenko and L. Pastur, Mathematics of the USSR-Sbornik 1, 1967). A light counts that
        adds as much to them as the noise of a sample is, s².
        """
        if weights is not None:
            whole = (weights > 0).all(axis=(0, 2))
            whole = whole if whole.any() else np.ones_like(whole)
            of_pictures = np.mean(weights[:, whole], axis=1, keepdims=True, dtype=np.float64)
            pictures = pictures[:, whole] * np.sqrt(of_pictures)
        count, pixels, _ = pictures.shape
        least = 1 + (1 + np.sqrt(count / pixels)) ** 2
        grams = np.einsum("nqc,mqc->cnm", pictures, pictures, optimize=True) / pixels
        seen = np.linalg.eigvalsh(grams) > least * max(variance, EXACT_RMSE**2)
        lights = tuple(seen.sum(axis=1).tolist())
        return cls(lights, unknowns - lights.count(0) + max(lights) * of_light)
