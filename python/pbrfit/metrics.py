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
    """Root mean square difference over the entries that are finite in both arrays.

    Raises
    ------
    ValueError
        If the shapes differ or no entry is finite in both.
    """
    if found.shape != true.shape:
        raise ValueError(f"rmse: expected equal shapes, found {found.shape} and {true.shape}")
    difference = found.astype(np.float64) - true
    square = np.square(difference[np.isfinite(difference)])
    if not square.size:
        raise ValueError("rmse: expected at least one entry that is finite in both arrays")
    return math.sqrt(float(square.mean()))


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
