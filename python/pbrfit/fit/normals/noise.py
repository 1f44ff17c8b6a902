"""The noise of a fit with free normals, and what it leaves uncertain of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.pixels import chunks
from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import NOISE_VARIANCE_MIN

Array = NDArray[np.float64]


def degrees_of_freedom(objective: Objective) -> float:
    """Samples of a pixel, less its own unknowns."""
    layout = objective.layout
    of_pixel = objective.samples / objective.pixels
    return float(max(of_pixel - layout.maps.stop / objective.pixels, 0.1 * of_pixel))


def noise_variance(objective: Objective, squares: Array) -> float:
    """s² of samples of weight 1, as the better half of the pixels has it, from squares (P,)."""
    return max(float(np.median(squares)) / degrees_of_freedom(objective), NOISE_VARIANCE_MIN)


def mean_over_median(objective: Objective, squares: Array) -> float:
    """How far the mean of squares (P,) is above their median, beside those of noise alone.

    For noise it is 1: squares of k numbers have a median of k (1 − 2/(9k))³ (Wilson and Hilferty
    1931). Pixels that are not explained raise the mean and leave the median.
    """
    of_noise = (1 - 2 / (9 * max(degrees_of_freedom(objective), 1.0))) ** 3
    median = max(float(np.median(squares)), float(np.finfo(np.float64).tiny))
    return float(np.mean(squares)) * of_noise / median


def pixel_squares(objective: Objective, x: Array) -> Array:
    """Σ ω (I − T)² of each pixel, (P,)."""
    squares = np.empty(objective.pixels)
    for chunk in chunks(objective.pixels):
        squares[chunk] = objective.problem.normal_equations(objective.for_core(x), chunk)[2]
    return squares


def uncertain_tilts(objective: Objective, x: Array, precision: Array, variance: float) -> Array:
    """Tr V of each pixel's tilt, its other unknowns free and its neighbours held, (P,).

    `precision` (P, F + 2) is of what draws roughness, metallic and the tilt, for noise of this
    `variance`.
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
