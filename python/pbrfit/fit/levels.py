"""Levels: strided subsets of the pixels that find what all pixels share, at a cost of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.objective import Objective
from pbrfit.fit.sampling import Pixels, groups_of, pixel_index, stride


@dataclass(frozen=True, eq=False)
class Level:
    """Pixels in every s-th row and column, and where they stand."""

    whole: Objective
    objective: Objective
    """Of all pixels, and of these alone."""
    pixels: Pixels
    """Which of the whole's pixels they are."""
    index: NDArray[np.intp]
    """By row and column of the subset, the position in `pixels`; −1 where there is none."""

    @classmethod
    def of(cls, objective: Objective, at_most: int) -> Level:
        """About so many of an objective's pixels at most; see `stride`."""
        step, row, column = stride(objective.layout.valid, at_most)
        found = pixel_index(objective.layout.valid)[row::step, column::step]
        pixels = found[found >= 0].astype(np.uint64)
        return cls(objective, objective.restricted(pixels), pixels, pixel_index(found >= 0))

    def patches(self, side: int = settings.PATCH_SIDE) -> list[Pixels]:
        """Positions in `pixels` of square pieces of the picture, of so many pixels a side."""
        rows, columns = np.nonzero(self.index >= 0)
        patch = rows // side * (self.index.shape[1] // side + 1) + columns // side
        return groups_of(patch)
