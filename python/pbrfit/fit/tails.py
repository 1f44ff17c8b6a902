"""How noise is distributed around 0, for squares r² in units of the variance of an ordinary sample.

Least squares is for a normal distribution. Two others have tails:

- **Student's t** with ν degrees of freedom, where what is left varies from sample to sample;
- **a normal distribution with outliers**: a share ε of the samples is k times as wide (J. W. Tukey,
  "A survey of sampling from contaminated distributions", 1960). Hot pixels are a few that say
  nothing beside many that are sound, of which t would doubt a part as well.

With p the density, −2 ln p is lowered by squares with the weight w = −2 d ln p / d(r²):

    t           w = (ν + 1) / (ν + r²)
    outliers    w = 1 − q (1 − 1/k²)      q = ε φ(r/k)/k / ((1 − ε) φ(r) + ε φ(r/k)/k)

q is the probability that a sample is an outlier. The likeliest of all is taken, by Akaike's
criterion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pbrfit.fit import settings
from pbrfit.values.arrays import Array


@dataclass(frozen=True)
class StudentT:
    """Student's t; of infinite degrees of freedom it is normal."""

    freedom: float
    """ν."""

    has_outliers = False
    """Whether some samples say nothing."""

    @property
    def is_normal(self) -> bool:
        """Whether it has no tails."""
        return math.isinf(self.freedom)

    @property
    def largest_weight(self) -> float:
        """That of r = 0."""
        return 1.0 if self.is_normal else (self.freedom + 1) / self.freedom

    def weights(self, squares: Array) -> Array:
        """The w of r²."""
        if self.is_normal:
            return np.ones_like(squares)
        return np.asarray((self.freedom + 1) / (self.freedom + squares))

    def deviances(self, squares: Array) -> Array:
        """−2 ln p, less ln 2π."""
        if self.is_normal:
            return squares
        v = self.freedom
        constant = math.lgamma((v + 1) / 2) - math.lgamma(v / 2) - math.log(v / 2) / 2
        return np.asarray((v + 1) * np.log1p(squares / v) - 2 * constant)

    def in_words(self) -> str:
        """For a stage's note."""
        return "normal" if self.is_normal else f"Student's t of {self.freedom:g} degrees"

    def remark(self) -> str:
        """For `Result.assumed`; empty if it is normal."""
        if self.is_normal:
            return ""
        return f"outliers weigh less (Student's t of {self.freedom:g} degrees of freedom)"


@dataclass(frozen=True)
class WithOutliers:
    """A normal distribution, of which a share is wider."""

    share: float
    width: float
    """ε and k."""

    freedom = math.inf
    is_normal = False
    has_outliers = True
    largest_weight = 1.0

    def _log_odds(self, squares: Array) -> Array:
        """Of q."""
        of_share = math.log(self.share / (1 - self.share) / self.width)
        return np.asarray(of_share + squares * (0.5 - 0.5 / self.width**2))

    def outliers(self, squares: Array) -> Array:
        """The q of r²."""
        return np.asarray(1 / (1 + np.exp(-np.minimum(self._log_odds(squares), 700.0))))

    def weights(self, squares: Array) -> Array:
        """The w of r²."""
        return 1 - self.outliers(squares) * (1 - 1 / self.width**2)

    def deviances(self, squares: Array) -> Array:
        """−2 ln p, less ln 2π."""
        odds = np.logaddexp(0.0, self._log_odds(squares))
        return np.asarray(squares - 2 * (math.log1p(-self.share) + odds))

    def in_words(self) -> str:
        """For a stage's note."""
        return f"normal with {100 * self.share:.2g} % outliers"

    def remark(self) -> str:
        """For `Result.assumed`."""
        return f"{100 * self.share:.2g} % of the samples are outliers, and weigh next to nothing"

    @classmethod
    def fitted(cls, squares: Array, width: float) -> WithOutliers:
        """With the likeliest share, by expectation–maximisation."""
        found = cls(settings.OUTLIER_SHARE_START, width)
        for _ in range(settings.OUTLIER_STEPS):
            share = float(found.outliers(squares).mean())
            found = cls(min(max(share, 1e-9), settings.OUTLIER_SHARE_MAX), width)
        return found


Tails = StudentT | WithOutliers

NORMAL = StudentT(math.inf)


def likeliest(squares: Array, *, outliers: bool = True) -> Tails:
    """Of some samples; a normal distribution unless another is clearly likelier."""
    candidates: list[tuple[int, Tails]] = [(0, NORMAL)]
    candidates += [(1, StudentT(freedom)) for freedom in settings.NOISE_FREEDOMS]
    if outliers:
        widths = settings.OUTLIER_WIDTHS
        candidates += [(2, WithOutliers.fitted(squares, width)) for width in widths]
    costs = [2 * numbers + float(one.deviances(squares).sum()) for numbers, one in candidates]
    return candidates[int(np.argmin(costs))][1]
