"""How large pictures may be, so that a page stays one that can be sent by mail."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")

LIMIT = 20_000_000
"""Bytes that a page has at most."""

VIEW_SHARE = 0.4
"""Share of the limit that the relight view may take; what a part does not need goes to the next."""

MAPS_SHARE = 0.6
"""Share of what the view leaves that the maps may take; pictures have the rest."""

LARGEST = 1024
"""Longer side of a map or the relight view in pixels."""

MAP_SIDES = (LARGEST, 768, 512, 384, 256, 128)
PICTURE_SIDES = (384, 256, 192, 128)


@dataclass(frozen=True)
class Fitted(Generic[T]):
    """What was made, how large it is, and the side it was made with."""

    made: T
    bytes: int
    side: int


def of_base64(length: int) -> int:
    """Letters that so many bytes take in a page."""
    return -(-length // 3) * 4


def sides_for(longer: int, sides: Sequence[int]) -> list[int]:
    """Sides that make sense for a picture: its own where it is smaller than the largest."""
    return [min(longer, sides[0]), *(side for side in sides[1:] if side < min(longer, sides[0]))]


def largest_that_fits(
    make: Callable[[int], T], size: Callable[[T], int], sides: Sequence[int], limit: float
) -> Fitted[T]:
    """Make something with the largest of the (falling) `sides` at which it fits into `limit` bytes.

    Bytes grow about as the square of the side, so few are tried. The smallest side is taken even
    where it does not fit.
    """
    i = 0
    while True:
        made = make(sides[i])
        taken = size(made)
        if taken <= limit or i == len(sides) - 1:
            return Fitted(made, taken, sides[i])
        expected = sides[i] * math.sqrt(limit / taken)
        fits = [j for j in range(i + 1, len(sides)) if sides[j] <= expected]
        i = fits[0] if fits else len(sides) - 1


def choose(sizes: Sequence[Sequence[int]], limit: float) -> tuple[int, list[int]]:
    """Choose how large and which of many pictures are shown.

    `sizes` are the bytes of each picture, by side, the largest side first; `limit` those of all
    that are shown. Returns the index of the largest side at which all fit and all pictures; or the
    smallest side and as many, evenly spread, as fit at it.
    """
    count = len(sizes)
    for side in range(len(sizes[0])):
        if sum(of_picture[side] for of_picture in sizes) <= limit:
            return side, list(range(count))
    side = len(sizes[0]) - 1
    for shown in range(count - 1, 0, -1):
        chosen = np.linspace(0, count - 1, shown).round().astype(int).tolist()
        if sum(sizes[i][side] for i in chosen) <= limit:
            return side, chosen
    return side, []
