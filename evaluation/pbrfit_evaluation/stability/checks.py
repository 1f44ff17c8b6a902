"""What every measurement of stability ends in: a figure, its bound, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDING = 2.0**-24
"""u: the largest relative error of rounding to float32."""

SMALLEST_NORMAL = float(np.finfo(np.float32).tiny)

# Bounds on band weights and slopes, on the loss relative to itself, on entries of the gradient
# relative to their natural scale, and on blocks of it relative to their norm.
BAND_BOUND = 1e-14
SLOPE_BOUND = 5e-14
LOSS_BOUND = 5e-7
ENTRY_BOUND = 2e-6
BLOCK_BOUND = 1e-6

BRANCH = 0.4
"""Roughness at which band weights change from the closed form to series."""

RANDOM, ONE_SIGN = "random signs", "one sign"
"""Forms of the residuals."""


@dataclass(frozen=True)
class Check:
    """One figure and what it may be.

    Attributes
    ----------
    key
        Name in `summary.json`.
    what
        What is measured, in words.
    worst
        The figure.
    bound
        At most this; None = reported only.
    why
        A sentence on the bound.
    where
        Where the worst was found.
    """

    key: str
    what: str
    worst: float
    bound: float | None
    why: str
    where: str = ""

    @property
    def passed(self) -> bool:
        """Whether the bound holds; a figure that is not a number holds none."""
        return self.bound is None or self.worst <= self.bound


def worst_of(figures: Mapping[str, float]) -> tuple[str, float]:
    """Name and value of the largest figure; one that is not a number beats them all."""
    name = max(figures, key=lambda n: math.inf if math.isnan(figures[n]) else figures[n])
    return name, figures[name]


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
