"""Which pixels are worked on: evenly spaced ones that stand for all, or all in pieces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.settings import STRIDED_SUBSET_EXCESS
from pbrfit.values.arrays import Array, Floats, Mask

Pixels = NDArray[np.uint64]
"""Indices, in order."""

Labels = NDArray[np.intp]
"""One for each pixel."""


def evenly_spaced(count: int, at_most: int) -> Pixels:
    """Indices below `count`, spread evenly and in order: all of them, or `at_most`.

    The range is cut into equal pieces, and one index is taken from each, at fractions that follow
    the golden ratio: no row length makes that a pattern of columns. It is the same every time.
    """
    chosen = min(count, at_most)
    if chosen == 0:
        return np.empty(0, dtype=np.uint64)
    borders = np.arange(chosen + 1) * count // chosen
    fraction = np.arange(chosen) * ((np.sqrt(5.0) - 1.0) / 2.0) % 1.0
    return np.asarray(borders[:-1] + (fraction * np.diff(borders)).astype(np.int64), np.uint64)


def groups_of(labels: NDArray[np.integer[Any]]) -> list[Pixels]:
    """Indices into `labels` (P,), at least one, of each label, in order."""
    order = np.argsort(labels, kind="stable").astype(np.uint64)
    starts = np.flatnonzero(np.diff(labels[order], prepend=labels.min() - 1))
    return np.split(order, starts[1:])


def evenly_spaced_over(labels: Labels, at_most: int) -> Pixels:
    """Indices into `labels` (P,), in order, at most so many: spread evenly in each label.

    Half of them are shared out equally between labels, so that small ones are represented; what
    labels are too small to use, and the other half, is spread over all the rest.
    """
    if len(labels) <= at_most:
        return np.arange(len(labels), dtype=np.uint64)
    groups = groups_of(labels)
    order, share = np.concatenate(groups), at_most // 2 // len(groups)
    taken = np.zeros(len(labels), dtype=bool)
    for of_label in groups:
        taken[of_label[evenly_spaced(len(of_label), share)]] = True
    rest = order[~taken[order]]
    taken[rest[evenly_spaced(len(rest), at_most - int(np.count_nonzero(taken)))]] = True
    return np.flatnonzero(taken).astype(np.uint64)


def drawn(shares: Array, count: int) -> tuple[NDArray[np.intp], Array]:
    """Indices into `shares` (P,), in order, about `count` of them, and how many each stands for.

    Each is taken with a probability in proportion to its share: where the sum passes whole numbers,
    so that it is the same every time.
    """
    expected = np.minimum(shares * (count / shares.sum()), 1.0)
    rows = np.flatnonzero(np.diff(np.floor(np.cumsum(expected) + 0.5), prepend=0.0))
    return rows, 1 / expected[rows]


def stride(valid: Mask, at_most: int) -> tuple[int, int, int]:
    """Step s, first row and first column: every s-th row and column has about `at_most` pixels.

    Of the valid ones (H, W); `STRIDED_SUBSET_EXCESS` times as many at most. It begins half a step
    from the border, unless a mask with a pattern of its own (every other row, say) leaves it less
    than half of its share there.
    """

    def count(first: tuple[int, int]) -> int:
        return int(np.count_nonzero(valid[first[0] :: step, first[1] :: step]))

    pixels = int(np.count_nonzero(valid))
    step = max(1, math.ceil(math.sqrt(pixels / at_most)))
    while True:
        row, column = (min(step // 2, size - 1) for size in valid.shape)
        if 2 * step**2 * count((row, column)) < pixels:
            row, column = max(product(range(step), range(step)), key=count)
        if count((row, column)) <= STRIDED_SUBSET_EXCESS * at_most:
            return step, row, column
        # A long and narrow picture has more pixels in every s-th row and column than a square.
        step += 1


def placed(values: Floats, valid: Mask, fill: float = np.nan) -> Array:
    """(H, W, ...) of values (P, ...) of the valid pixels; `fill` elsewhere."""
    found = np.full(valid.shape + values.shape[1:], fill)
    found[valid] = values
    return found


def pixel_index(valid: Mask) -> NDArray[np.intp]:
    """(H, W): which of the valid pixels each is, row by row; −1 where it is none."""
    return np.where(valid, np.cumsum(valid).reshape(valid.shape) - 1, -1)


def pairs_apart(index: NDArray[np.intp], step: int = 1) -> tuple[NDArray[np.intp], ...]:
    """(2, Q) pixels of an index (H, W) and those as many columns to the right; the same below."""
    found = []
    for down, right in ((0, step), (step, 0)):
        here = index[: index.shape[0] - down, : index.shape[1] - right].ravel()
        there = index[down:, right:].ravel()
        found.append(np.stack([here, there])[:, (here >= 0) & (there >= 0)])
    return tuple(found)


def beside(
    places: NDArray[np.intp], width: int, steps: Iterable[tuple[int, int]]
) -> Iterator[NDArray[np.intp]]:
    """(P,) for each step (rows, columns): which of the places lies there, −1 = none."""
    rows, columns = np.divmod(places, width)
    rows = rows - rows.min() + 1
    index = np.full((int(rows.max()) + 2, width + 2), -1, np.intp)
    index[rows, columns + 1] = np.arange(len(places))
    for down, right in steps:
        yield index[rows + down, columns + 1 + right]


def slices(count: int, size: int) -> list[slice]:
    """Ranges of `size` and a rest that make up range(count)."""
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]
