"""Names for kinds of arrays, and small things that many suites do with figures and arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from pbrfit.model.materials import nearest_inside
from pbrfit.values.arrays import Array as Array
from pbrfit.values.arrays import Floats as Floats
from pbrfit.values.arrays import Mask as Mask

T = TypeVar("T")


def known(value: T | None) -> T:
    """A value that synthetic scenes always have, such as their truth and its lights."""
    assert value is not None
    return value


def filled(vectors: Floats, valid: Mask) -> Array:
    """Vectors (H, W, 3), outside the mask those of the nearest pixel inside."""
    return np.asarray(np.asarray(vectors, dtype=np.float64)[nearest_inside(valid)])


def worst(figures: Mapping[str, float]) -> tuple[float, str]:
    """Value and name of the largest figure; one that is not a number beats them all."""
    name = max(figures, key=lambda n: math.inf if math.isnan(figures[n]) else figures[n])
    return float(figures[name]), name
