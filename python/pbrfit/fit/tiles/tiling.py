"""Which pixels of a large picture find the lights, and how it is cut into tiles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.tiles.part import Window

FEW = 1 << 18
"""Pixels that find the lights, at most: 512². Their noise leaves 1 % of a pixel's in the lights
then, and a fit of so many takes a minute."""

FEWEST = 1 << 12
"""And at least, where a mask would leave fewer of a lattice."""

MORE = 1.25
"""Times as many as at most may be there, for pixels cannot be chosen one by one."""

TILE = 512
"""Rows and columns of a tile."""

MARGIN = 32
"""Pixels around a tile that are fitted with it and left to its neighbours, where neighbouring
pixels are to be alike: the borders of two tiles then come from almost the same pixels."""

THIN_MARGIN = 2
"""The same where pixels are fitted each for itself: only those that are tried again look beside."""


@dataclass(frozen=True)
class Tile:
    """A tile: the pixels that are fitted, and those of them that are kept.

    Attributes
    ----------
    outer
        In the whole picture.
    inner
        In the whole picture, and
    inside
        the same in the outer one.
    """

    outer: Window
    inner: Window
    inside: Window


def lattice(valid: NDArray[np.bool_], few: int = FEW) -> Window:
    """Every s-th row and column, with about `few` of the valid pixels (H, W) at most."""
    least = max(1, math.ceil(math.sqrt(np.count_nonzero(valid) / few)))
    # A mask may have stripes that a lattice hits or misses altogether: then the nearest step that
    # does neither.
    for step in sorted(range(1, 2 * least), key=lambda step: (abs(step - least), step)):
        window = Window(*(slice(step // 2, None, step) for _ in range(2)))
        # Counts of a lattice differ a little from the share of all.
        if step == 1 or FEWEST <= np.count_nonzero(window.of(valid)) <= MORE * few:
            break
    return window


def tiles(valid: NDArray[np.bool_], margin: int, side: int = TILE) -> Iterator[Tile]:
    """Tiles that have valid pixels, row by row."""
    height, width = valid.shape
    rows, columns = (_cuts(length, side) for length in (height, width))
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            inner = Window(slice(top, bottom), slice(left, right))
            if not inner.of(valid).any():
                continue
            first_row, first_column = max(0, top - margin), max(0, left - margin)
            outer = Window(
                slice(first_row, min(height, bottom + margin)),
                slice(first_column, min(width, right + margin)),
            )
            inside = Window(
                slice(top - first_row, bottom - first_row),
                slice(left - first_column, right - first_column),
            )
            yield Tile(outer, inner, inside)


def _cuts(length: int, side: int) -> list[int]:
    """Borders of equal pieces that are no longer than `side`."""
    count = -(-length // side)
    return [length * i // count for i in range(count + 1)]
