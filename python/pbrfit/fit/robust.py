"""Cauchy's loss: its scale from residuals, and the weights that it stands for.

A robust loss φ(e) is e² for residuals e that noise explains and grows slower beyond, so that
shadows, interreflections and highlights outside the model weigh less (the formulas are in
`rust/problem/robust.rs`). Where it bends is its scale δ, a multiple of the noise's standard
deviation σ, which is not known and is taken from the residuals themselves.

Notes
-----
Half of Gaussian noise is below 0.6745 σ in size, the third quartile of the normal distribution, and
outliers hardly move a median. So σ = median |e| / 0.6745 (F. R. Hampel, "The influence curve and
its role in robust estimation", J. Am. Stat. Assoc. 69, 1974).

A fit takes up some of the noise: of n samples with p unknowns the residuals' variance is
(n − p) / n of the noise's. So σ is larger by √(n / (n − p)).

δ is 2.385 σ. On purely Gaussian noise estimates then have 95 % of the efficiency of least squares:
σ² E[φ'']² / E[φ'²] = 0.95, where E is the mean over e ~ N(0, σ²) and φ = e² gives 1 (P. W. Holland
and R. E. Welsch, "Robust regression using iteratively reweighted least-squares", Commun. Stat. A6,
1977).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.settings import DEGREES_OF_FREEDOM_SHARE_MIN

CAUCHY_SCALE = 2.385
"""δ/σ, for an efficiency of 95 % on Gaussian noise."""

MEDIAN_TO_SIGMA = 1.482602218505602
"""1 / 0.6745: σ over the median of |e| where e is Gaussian."""

LARGEST_RATIO = np.float32(1e19)
"""Ratio of residuals to the scale: larger ones, whose squares float32 cannot hold, count as this.
"""


def irls_weights(scale: float, residuals: NDArray[np.float32]) -> NDArray[np.float32]:
    """φ'(e)/2e: the weight of a residual beside its square, 1 for small ones.

    Squares with these weights have the slopes that the loss of scale δ has.
    """
    sizes = np.minimum(np.abs(residuals), LARGEST_RATIO * np.float32(scale)) / np.float32(scale)
    return np.asarray(1 / (1 + np.square(sizes)))


def noise_sigma(
    residuals: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None = None,
    *,
    unknowns: float = 0.0,
) -> float:
    """Standard deviation of the noise, from residuals of which some may be outliers.

    Of residuals (N, P, C) those of weight (N, P, 1 or C) 0 are no data. p, how many `unknowns` were
    fitted to them, is of a few pixels' residuals their own unknowns and their share of the lights';
    more than 90 % of the samples count as 90 %. If half of the residuals are 0, so is σ.
    """
    sizes = np.abs(np.asarray(residuals, dtype=np.float64))
    used = np.broadcast_to(True if weights is None else weights > 0, sizes.shape)
    samples = int(np.count_nonzero(used))
    degrees = max(samples - unknowns, DEGREES_OF_FREEDOM_SHARE_MIN * samples)
    return float(MEDIAN_TO_SIGMA * np.median(sizes[used]) * np.sqrt(samples / degrees))
