"""Segment ids: arbitrary whole numbers as labels that arrays can be indexed with."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def consecutive_labels(ids: NDArray[np.integer[Any]]) -> tuple[NDArray[np.intp], int]:
    """Labels 1 … S in the order of the ids, of the shape of `ids`, and S; id 0 stays 0.

    0 means unclassified, whether or not it occurs. Ids may be negative, large and sparse.
    """
    found, index = np.unique(ids, return_inverse=True)
    classified = found != 0
    labels = np.where(classified, np.cumsum(classified), 0)
    return labels[index.reshape(ids.shape)], int(np.count_nonzero(classified))
