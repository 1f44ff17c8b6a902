"""Errors between maps or pictures: pure functions on arrays.

NaN pixels, which are the ones outside the mask, never enter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

PROTOCOL = (
    "pbrfit-1: RMSE over valid pixels and channels, linear values; "
    "recon with the samples' weights; relight under true lights"
)


def rmse(
    found: NDArray[np.floating[Any]],
    true: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None = None,
) -> float:
    """Root mean square difference over the entries that are NaN in neither array.

    Parameters
    ----------
    found, true
        Arrays of one shape.
    weights
        How much each entry counts, 0 or more, of a shape that broadcasts to theirs; None = all the
        same. Entries of weight 0 never enter, whatever they are.

    Raises
    ------
    ValueError
        If the shapes differ, or no entry is left that is NaN in neither array and has a weight.
    """
    if found.shape != true.shape:
        raise ValueError(f"rmse: expected equal shapes, found {found.shape} and {true.shape}")
    used = ~(np.isnan(found) | np.isnan(true))
    if weights is not None:
        weights = np.broadcast_to(weights, found.shape)
        used &= weights > 0
        weights = weights[used].astype(np.float64)
    difference = found[used].astype(np.float64) - true[used]
    if not difference.size:
        raise ValueError("rmse: expected at least one entry that is NaN in neither array")
    largest = float(np.max(np.abs(difference)))
    if largest == 0.0:
        return 0.0
    # Divided by the largest, because squares of large radiance overflow.
    return largest * math.sqrt(float(np.average(np.square(difference / largest), weights=weights)))


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
