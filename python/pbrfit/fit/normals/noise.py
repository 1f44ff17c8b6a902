"""The noise of a fit with free normals, and what it leaves uncertain of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import chunks
from pbrfit.fit.settings import (
    DEGREES_OF_FREEDOM_SHARE_MIN,
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
