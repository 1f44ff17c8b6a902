"""What a whole scene has of samples, and what tiles have left of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.objective import Normalization, Objective
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]


class Total:
    """Samples of a whole scene, and what is left of the tiles so far.

    Attributes
    ----------
    channels, pixels, samples, weight
        How many channels are fitted, pixels are valid and samples have a weight, and the sum of the
        weights, of which the largest is 1.
    """

    def __init__(self, scene: Scene, units: Normalization, channels: int) -> None:
        self._scale, self.channels = units.scale, channels
        self._left = self._of = 0.0
        self.pixels = int(np.count_nonzero(scene.valid))
        if scene.weights is None or not scene.weighted:
            self.samples = channels * len(scene.images) * self.pixels
            self.weight = float(self.samples)
            return
        self.samples, self.weight = 0, 0.0
        for of_picture in scene.weights:
            inside = of_picture[scene.valid]
            self.samples += channels * int(np.count_nonzero(inside))
            self.weight += channels * float(inside.sum(dtype=np.float64)) / units.largest_weight

    def add(self, objective: Objective, x: Array) -> None:
        """One more tile; pixels of its margin count twice."""
        self._left += objective.data_value_and_grad(x)[0] * objective.total_weight
        self._of += objective.total_weight

    @property
    def mean(self) -> float:
        """Loss of the data."""
        return self._left / self._of

    @property
    def rmse(self) -> float:
        """In picture units."""
        return math.sqrt(self.mean) * self._scale
