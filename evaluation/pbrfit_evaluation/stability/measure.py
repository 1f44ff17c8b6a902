"""What sections of the stability suite share: figures, and errors relative to a size."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Figure = tuple[float, str]
"""The worst of all that was tried, and where it was found."""

Rows = dict[str, dict[str, float]]
"""What was found, by case and key."""

ROUNDING = 2.0**-24
"""u: the largest relative error of rounding to float32."""


def worst(figures: Mapping[str, float]) -> Figure:
    """Value and name of the largest figure; one that is not a number beats them all."""
    name = max(figures, key=lambda n: math.inf if math.isnan(figures[n]) else figures[n])
    return float(figures[name]), name


def ratio(error: float, size: float) -> float:
    """Error relative to a size, where nothing is allowed of nothing."""
    if error == 0:
        return 0.0
    return error / size if size else math.inf


def worst_entry(errors: Array, scale: Array) -> float:
    """Return the largest |error| over its entry's scale, where nothing is allowed of nothing."""
    errors = np.abs(errors)
    relative = np.divide(errors, scale, out=np.full_like(errors, np.inf), where=scale > 0)
    relative[(errors == 0) & (scale == 0)] = 0
    return float(relative.max())
