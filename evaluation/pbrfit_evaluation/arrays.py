"""Names for kinds of arrays, and small things that many suites do with figures and arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]

T = TypeVar("T")


def known(value: T | None) -> T:
    """A value that synthetic scenes always have, such as their truth and its lights."""
    assert value is not None
    return value


def unit(vectors: Floats) -> Array:
    """Vectors (..., 3) of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def filled(vectors: Floats, valid: Mask) -> Array:
    """Vectors (H, W, 3), outside the mask those of the nearest pixel inside."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    found: Array = np.asarray(vectors, dtype=np.float64)[tuple(nearest)]
    return found


def worst(figures: Mapping[str, float]) -> tuple[float, str]:
    """Value and name of the largest figure; one that is not a number beats them all."""
    name = max(figures, key=lambda n: math.inf if math.isnan(figures[n]) else figures[n])
    return float(figures[name]), name
