"""Derivatives from values alone, with an estimate of their error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


def ridders(
    function: Callable[[float], Array | float], step: float, *, one_sided: bool = False
) -> tuple[Array, Array]:
    """Derivative of `function` at 0 and its estimated error, each entry on its own.

    Ridders' method: difference quotients at step, step/2, step/4, … are extrapolated to step
    zero by Neville's scheme, and each entry keeps the extrapolation with the least change. The
    error of the central quotient is a series in h², of the one-sided one (f(h) − f(0))/h in h.

    C. J. F. Ridders, "Accurate computation of F'(x) and F'(x)F''(x)",
    Adv. Eng. Software 4(2), 1982.
    """
    factor = 2.0
    series = factor if one_sided else factor**2
    best = error = np.zeros(())
    previous: list[Array] = []
    for level in range(8):
        h = step / factor**level
        low = 0.0 if one_sided else -h
        quotient = (np.asarray(function(h)) - np.asarray(function(low))) / (h - low)
        row = [quotient]
        for order, coarse in enumerate(previous, start=1):
            power = series**order
            row.append((power * row[-1] - coarse) / (power - 1))
        if level == 0:
            best, error = quotient, np.full_like(quotient, np.inf)
        for order in range(1, len(row)):
            change = np.maximum(
                np.abs(row[order] - row[order - 1]), np.abs(row[order] - previous[order - 1])
            )
            best = np.where(change < error, row[order], best)
            error = np.minimum(change, error)
        previous = row
    return best, error
