"""Exposure of synthetic pictures: how bright each is, and all of them together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEAN_RADIANCE = 0.4
"""Mean radiance of the training pictures of a scene, all together."""


def gains(images: Array, rng: np.random.Generator) -> Array:
    """(N,) factors that take the mean of each of N pictures (N, ...) to between 1/√2 and √2."""
    level = np.sqrt(2) ** rng.uniform(-1, 1, size=len(images))
    return np.asarray(level / images.reshape(len(images), -1).mean(axis=1))
