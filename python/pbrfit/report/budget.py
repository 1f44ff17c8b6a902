"""How large pictures may be, so that a page stays one that can be sent by mail."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Generic, TypeVar

import numpy as np

from pbrfit.threads import in_turn

T = TypeVar("T")

LIMIT = 20_000_000
"""Bytes that a page has at most."""

VIEW_SHARE = 0.6
"""Share of the limit that the view may take; what a part does not need goes to the next."""

FILM_SHARE = 0.15
"""Share of the limit that pictures to compare with may take; they are a part of the view."""

MAPS_SHARE = 0.5
"""Share of what the view leaves that the maps may take; pictures have the rest."""

VIEW_SIDES = (4096, 3072, 2560, 2048, 1792, 1536, 1280, 1024, 896, 768, 640, 512, 384, 256, 128)
"""Longer sides that the maps of the view may have, in pixels."""

MAP_SIDES = (384, 256, 192, 128)
"""Longer sides of the maps beside each other; in the view they are larger."""

PICTURE_SIDES = (384, 256, 192, 128)
"""Longer sides of the pictures beside their reconstructions."""


@dataclass(frozen=True)
class Fitted(Generic[T]):
    """What was made, how large it is, and the side it was made with."""

    made: T
    bytes: int
    side: int


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


def choose(
    sides: int, count: int, size: Callable[[int, int], int], limit: float
) -> tuple[int, list[int]]:
    """Choose how large and which of many pictures are shown.

    `size(side, i)` are the bytes of picture i at a side, 0 the largest of all `sides`; they are
    asked for only as far as they are needed. `limit` is the bytes of all that are shown. Returns
    the index of the largest side at which all fit and all pictures; or the smallest side and as
    many, evenly spread, as fit at it.
    """
    for side in range(sides):
        taken = in_turn(0, partial(size, side), range(count))
        if all(total <= limit for total in accumulate(taken)):
            return side, list(range(count))
    side = sides - 1
    for shown in range(count - 1, 0, -1):
        chosen = np.linspace(0, count - 1, shown).round().astype(int).tolist()
        if sum(size(side, i) for i in chosen) <= limit:
            return side, chosen
    return side, []
