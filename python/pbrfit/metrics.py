"""Errors between maps or pictures: pure functions on arrays.

NaN pixels, which are the ones outside the mask, never enter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

PROTOCOL = "pbrfit-1: RMSE over valid pixels and channels, linear values; relight under true lights"


def rmse(found: NDArray[np.floating[Any]], true: NDArray[np.floating[Any]]) -> float:
    """Root mean square difference over the entries that are NaN in neither array.

    Raises
    ------
    ValueError
        If the shapes differ or all entries are NaN in one of the arrays.
    """
    if found.shape != true.shape:
        raise ValueError(f"rmse: expected equal shapes, found {found.shape} and {true.shape}")
    difference = found.astype(np.float64) - true
    difference = difference[~(np.isnan(found) | np.isnan(true))]
    if not difference.size:
        raise ValueError("rmse: expected at least one entry that is NaN in neither array")
    largest = float(np.max(np.abs(difference)))
    if largest == 0.0:
        return 0.0
    # Divided by the largest, because squares of large radiance overflow.
    return largest * math.sqrt(float(np.mean(np.square(difference / largest))))


def scaled_per_channel(
    found: NDArray[np.floating[Any]], true: NDArray[np.floating[Any]]
) -> NDArray[np.float64]:
    """`found` times the factor per channel (last axis) that brings it closest to `true`.

    Pictures alone fix albedo and light only up to such a factor once there is noise; comparing
    after the best factor shows what remains.
    """
    axes = tuple(range(found.ndim - 1))
    both = np.isfinite(found) & np.isfinite(true)
    f = np.where(both, found, 0.0).astype(np.float64)
    t = np.where(both, true, 0.0)
    square = np.sum(f * f, axis=axes)
    factor = np.divide(np.sum(f * t, axis=axes), square, out=np.ones_like(square), where=square > 0)
    return np.asarray(found * factor)
