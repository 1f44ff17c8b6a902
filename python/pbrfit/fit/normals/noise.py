"""The noise of a fit with free normals, and what it leaves uncertain of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import chunks
from pbrfit.fit.priors.penalties import tied_neighbours
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.fit.settings import (
    DEGREES_OF_FREEDOM_SHARE_MIN,
    NEIGHBOUR_PAIRS_MAX,
    NOISE_VARIANCE_MIN,
)

Array = NDArray[np.float64]


def degrees_of_freedom(objective: Objective) -> float:
    """Samples of a pixel, less its own unknowns."""
    layout = objective.layout
    samples = objective.samples / objective.pixels
    left = samples - layout.maps.stop / objective.pixels
    return float(max(left, DEGREES_OF_FREEDOM_SHARE_MIN * samples))


def noise_variance(objective: Objective, sum_sq_residuals: Array) -> float:
    """s² of samples of weight 1, as the better half of the pixels has it, from their sums (P,)."""
    median = float(np.median(sum_sq_residuals))
    return max(median / degrees_of_freedom(objective), NOISE_VARIANCE_MIN)


def mean_over_median(objective: Objective, sum_sq_residuals: Array) -> float:
    """Mean of the pixels' sums (P,) over their median, divided by that ratio for noise alone.

    Sums of k squares of noise have a median of k (1 − 2/(9k))³ (Wilson and Hilferty 1931). Pixels
    that are not explained raise the mean and leave the median.
    """
    of_noise = (1 - 2 / (9 * max(degrees_of_freedom(objective), 1.0))) ** 3
    median = max(float(np.median(sum_sq_residuals)), float(np.finfo(np.float64).tiny))
    return float(np.mean(sum_sq_residuals)) * of_noise / median


def pixel_sums(objective: Objective, x: Array) -> Array:
    """Summed squared residuals Σ ω (I − T)² of each pixel, (P,)."""
    found = np.empty(objective.pixels)
    for chunk in chunks(objective.pixels):
        found[chunk] = objective.problem.normal_equations(objective.for_core(x), chunk)[2]
    return found


def offset_variances(objective: Objective, x: Array, precision: Array, variance: float) -> Array:
    """Tr V of each pixel's tangent offset, its other unknowns free and its neighbours held, (P,).

    `precision` (P, F + 2) is that of the priors on roughness, metallic and the tangent offset, for
    noise of this `variance`.
    """
    found = np.empty(objective.pixels)
    channels = objective.channels
    for chunk in chunks(objective.pixels):
        matrices, _, _ = objective.problem.normal_equations(objective.for_core(x), chunk)
        diagonal = np.einsum("pii->pi", matrices)
        diagonal[:, channels:] += precision[chunk]
        diagonal *= 1 + 1e-9
        diagonal += np.finfo(np.float64).tiny + 1e-12 * diagonal.max()
        covariance = np.linalg.inv(matrices)
        found[chunk] = variance * np.einsum("pii->p", covariance[:, -2:, -2:])
    return found


class NeighbourPairs:
    """Some pairs of neighbouring pixels of a scene; `pixels` (Q,) are those that are in one."""

    def __init__(self, objective: Objective) -> None:
        pairs = tied_neighbours(objective.layout)
        if pairs.shape[1] > NEIGHBOUR_PAIRS_MAX:
            pairs = pairs[:, evenly_spaced(pairs.shape[1], NEIGHBOUR_PAIRS_MAX)]
        pairs = pairs.astype(np.uint64)
        self.pixels = np.unique(pairs).astype(np.uint64)
        self._first, self._second = np.searchsorted(self.pixels, pairs)
        self._objective = objective

    def residual_correlation(self, x: Array) -> float:
        """Mean cosine between the residuals of neighbours at x; 0 where nothing is left of any.

        Each pair counts as much as any other: a few pixels that are still in a wrong minimum do not
        decide. 0 where no two pixels are neighbours, too.
        """
        if not self.pixels.size:
            return 0.0
        residuals = self._objective.problem.residuals(self._objective.for_core(x), self.pixels)
        of_pixels = residuals.transpose(1, 0, 2).reshape(len(self.pixels), -1).astype(np.float64)
        size = np.sqrt(np.einsum("ps,ps->p", of_pixels, of_pixels))
        of_pixels /= np.maximum(size, np.finfo(np.float64).tiny)[:, None]
        return float(np.einsum("ps,ps->p", of_pixels[self._first], of_pixels[self._second]).mean())
