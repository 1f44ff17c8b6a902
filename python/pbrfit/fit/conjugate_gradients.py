"""Preconditioned conjugate gradients that know when enough is gained."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings

Array = NDArray[np.float64]


def conjugate_gradients(
    right: Array,
    product: Callable[[Array], Array],
    solved: Callable[[Array], Array],
    *,
    ratio: float,
    iterations: int,
    enough: float,
    stop: Callable[[], bool],
) -> tuple[Array, int]:
    """S⁻¹ `right`, and the number of products with S, which is positive definite.

    Parameters
    ----------
    right
        (M,).
    product
        S v.
    solved
        M⁻¹ v of the preconditioner.
    ratio
        Of the remaining error to the first, in the norm of the preconditioner, at which to stop.
    iterations
        Products at most.
    enough
        Size r·M⁻¹r of the right side, what is to be gained, below which nothing is done. A tenth of
        it left to gain ends it too (`settings.CG_GAIN_SHARE`).
    stop
        Whether to leave it at what is found so far.
    """
    residual, found = right.copy(), np.zeros_like(right)
    direction = preconditioned = solved(residual)
    first = size_now = float(residual @ preconditioned)
    if not first >= enough:
        return found, 0
    number = 0
    while number < iterations and not stop():
        number += 1
        along = product(direction)
        curvature = float(direction @ along)
        if not curvature > 0:
            break
        length = size_now / curvature
        found += length * direction
        residual -= length * along
        preconditioned = solved(residual)
        size_before, size_now = size_now, float(residual @ preconditioned)
        if size_now <= max(ratio**2 * first, settings.CG_GAIN_SHARE * enough):
            break
        direction = preconditioned + size_now / size_before * direction
    return found, number
