"""The stability suite's sections: how much of each is measured, and what measures it.

Each section gives `figures`, by key the worst value of all that was tried and where it was found,
and curves to draw. What a figure may be is said in `figures.py`. The bounds there hold for float32
arithmetic in any order with sums in blocks of up to about a thousand terms and float64 beyond; they
name nothing of how it is done.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDING = 2.0**-24
"""u: the largest relative error of rounding to float32."""

BRANCH = 0.4
"""Roughness at which band weights change from the closed form to series."""

RANDOM, ONE_SIGN = "random signs", "one sign"
"""Forms of the residuals."""


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    band_points: int
    pixels_of_a_kind: int
    pictures: int
    branch_pixels: int
    scan_points: int
    residual_pixels: int
    summed_pixels: tuple[int, ...]
    summed_pictures: int
    summed_many: tuple[int, int]
    draws: int
    subnormal_pixels: int
    repeated: tuple[tuple[int, int], ...]
    fit_size: int
    fit_pictures: int
    fit_iterations: int


_EFFORT: dict[str, tuple[Any, Any]] = {
    "band_points": (12_000, 2_000),
    "pixels_of_a_kind": (393_216, 8_192),
    "pictures": (8, 8),
    "branch_pixels": (64, 32),
    "scan_points": (201, 41),
    "residual_pixels": (65_536, 4_096),
    "summed_pixels": (tuple(4**k for k in range(3, 11)), tuple(4**k for k in range(3, 9))),
    "summed_pictures": (16, 16),
    "summed_many": ((65_536, 256), (4_096, 256)),
    "draws": (32, 8),
    "subnormal_pixels": (65_536, 8_192),
    "repeated": (
        ((1, 1), (17, 3), (1000, 5), (70_001, 4), (300_000, 2)),
        ((1, 1), (17, 3), (1000, 5), (20_001, 4)),
    ),
    "fit_size": (48, 10),
    "fit_pictures": (16, 5),
    "fit_iterations": (300, 20),
}

EFFORTS = {
    effort: Effort(**{name: of[quick] for name, of in _EFFORT.items()})
    for quick, effort in enumerate(("full", "quick"))
}

Figure = tuple[float, str]
"""The worst of all that was tried, and where it was found."""


def worst(figures: Mapping[str, float]) -> Figure:
    """Value and name of the largest figure; one that is not a number beats them all."""
    name = max(figures, key=lambda n: math.inf if math.isnan(figures[n]) else figures[n])
    return float(figures[name]), name


def count(figures: Mapping[str, int], what: str) -> Figure:
    """How many there are in all, and where most are; where there is none, of how many cases."""
    most, where = worst(figures)
    return sum(figures.values()), where if most else f"{len(figures)} {what}"


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
