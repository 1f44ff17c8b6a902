"""Whether what a fit leaves of the pictures is noise, or something that the model does not have."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pbrfit.objective import Objective
from pbrfit.priors import tied_neighbours
from pbrfit.sampling import spread

Array = NDArray[np.float64]

PAIRS = 1024
"""Neighbouring pixels by which a fit is judged."""

NOISE_SHARED = 0.1
"""Correlation of neighbours' residuals up to which they are noise. On twelve synthetic rooms noise
alone left at most 0.005, and wrong normals, field of view or SH order 0.33 and more."""


class Neighbours:
    """Some pairs of neighbouring pixels of a scene.

    Attributes
    ----------
    pixels
        (Q,) indices of those that are in a pair; none where no two pixels are neighbours.
    """

    def __init__(self, objective: Objective) -> None:
        pairs = tied_neighbours(objective.layout)
        pairs = pairs[:, spread(pairs.shape[1], PAIRS)].astype(np.uint64)
        self.pixels = np.unique(pairs).astype(np.uint64)
        self._first, self._second = np.searchsorted(self.pixels, pairs)
        self._objective = objective

    def shared(self, x: Array) -> float:
        """Correlation between the residuals of neighbours at x; 0 where nothing is left of any."""
        residuals = self._objective.problem.residuals(self._objective.for_core(x), self.pixels)
        one = residuals[:, self._first].astype(np.float64)
        other = residuals[:, self._second].astype(np.float64)
        alone = math.sqrt((one**2).sum()) * math.sqrt((other**2).sum())
        return float((one * other).sum()) / alone if alone > 0 else 0.0
