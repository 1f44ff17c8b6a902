"""Exposure: how bright pictures are beside one another, and when that is evened out.

A picture at ten times the exposure has ten times the residuals, be they noise of the light or what
the model lacks, and so a hundred times the weight in a sum of squares. Where exposures are far
apart, pictures are divided by theirs before they are fitted, and the lights multiplied by it
afterwards. For the loss that is a weight of 1/exposure² on the squares. For the solver it is more:
all lights are of one size, which weights would leave as far apart as the exposures, and L-BFGS then
gets nowhere.
"""

from __future__ import annotations

import numpy as np

from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array

EXPOSURE_RANGE = 4.0
"""Brightest over darkest picture, by mean radiance, beyond which exposures are evened out."""

LEAST_EXPOSURE = 1 / 16
"""Darker pictures count as this: what they show may be noise, and may be nothing."""


def mean_radiance(scene: Scene) -> Array:
    """Of each picture, (N,): the weighted mean over its valid samples and channels."""
    means = np.empty(len(scene.images))
    for i in range(len(means)):
        if scene.weights is None:
            means[i] = scene.brightness(i).mean()
        else:
            weights = scene.weights[i][scene.valid].astype(np.float64)
            means[i] = (weights * scene.samples(i)).sum() / weights.sum()
    return means


def relative_exposures(scene: Scene, equal: bool | None = None) -> Array | None:
    """What each picture is to be divided by, (N,), 1 on average; None where it stays as it is.

    `equal` decides; where it is None, they are divided if the brightest picture has more than
    `EXPOSURE_RANGE` times the mean radiance of the darkest.
    """
    if equal is False:
        return None
    means = mean_radiance(scene)
    mean = means.mean()
    if not 0 < mean < np.inf:
        return None  # no exposure to speak of; `Objective` says what is wrong
    if equal is None and means.max() <= EXPOSURE_RANGE * means.min():
        return None
    return np.asarray(np.maximum(means / mean, LEAST_EXPOSURE))


def in_words(exposures: Array) -> str:
    """What was done about exposures, for `Result.assumed`."""
    return (
        f"from {exposures.min():.2g} to {exposures.max():.2g} times the mean: each picture counts "
        "relative to its own"
    )
