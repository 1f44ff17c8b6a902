"""Whether what a fit leaves of the pictures is noise, or something that the model does not have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.penalties import tied_neighbours
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.fit.settings import NEIGHBOUR_CORRELATION_MAX, NEIGHBOUR_PAIRS_MAX

Array = NDArray[np.float64]


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

    def are_noise(self, x: Array) -> bool:
        """Whether the residuals at x are noise: neighbours do not share them."""
        return self.residual_correlation(x) <= NEIGHBOUR_CORRELATION_MAX
