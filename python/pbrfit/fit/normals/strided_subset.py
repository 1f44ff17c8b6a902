"""Some pixels on a regular lattice, and which of them are neighbours with one surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.parameters import ParameterLayout

Array = NDArray[np.float64]

EDGE = 0.1
"""Of |Δn|² between the given normals of neighbours, that is 18 degrees: from about here on an edge
lies between them, across which changes of the normal need not be alike."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pairs of pixels, and how far their normals' changes are expected to be alike.

    Attributes
    ----------
    pairs
        (E, 2) indices.
    weights
        (E,): e^(−|Δn|²/0.1) of the given normals, less where these are known to be unsure.
    count
        Of the pixels.
    """

    pairs: NDArray[np.intp]
    weights: Array
    count: int

    @classmethod
    def of(cls, index: NDArray[np.intp], normals: Array, sigma: Array | None) -> Neighbourhood:
        """Of pixels beside and below each other.

        Parameters
        ----------
        index
            (rows, columns): the pixel that is there, or −1.
        normals
            (P, 3): the given ones.
        sigma
            (P,): how sure these are, in any unit; None = all alike. Where both of a pair are twice
            as unsure as the mean, their changes may differ twice as far.
        """
        beside = np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()], axis=-1)
        below = np.stack([index[:-1].ravel(), index[1:].ravel()], axis=-1)
        pairs = np.concatenate([beside, below])
        pairs = pairs[(pairs >= 0).all(axis=1)]
        first, second = pairs.T
        difference = normals[first] - normals[second]
        weights = np.exp(-np.einsum("ed,ed->e", difference, difference) / EDGE)
        if sigma is not None and sigma.any():
            least = 0.1 * sigma.mean()  # nothing is known for sure
            relative = np.maximum(0.5 * (sigma[first] + sigma[second]), least) / sigma.mean()
            weights /= relative**2
        return cls(pairs, weights, len(normals))

    def sums(self, values: Array, weights: Array) -> Array:
        """Σ over the neighbours of each pixel of `weights` (E,) times their `values` (P, 2)."""
        first, second = self.pairs.T
        found = np.zeros_like(values)
        for column in range(values.shape[1]):
            found[:, column] = np.bincount(
                first, weights * values[second, column], minlength=self.count
            ) + np.bincount(second, weights * values[first, column], minlength=self.count)
        return found

    def degrees(self, weights: Array) -> Array:
        """Sum of the weights of each pixel's pairs, (P,)."""
        first, second = self.pairs.T
        return np.asarray(
            np.bincount(first, weights, minlength=self.count)
            + np.bincount(second, weights, minlength=self.count)
        )

    def squares(self, values: Array) -> Array:
        """|v_second − v_first|² of each pair, (E,), for `values` (P, 2)."""
        first, second = self.pairs.T
        difference = values[second] - values[first]
        return np.asarray(np.einsum("ed,ed->e", difference, difference))


def lattice(layout: ParameterLayout, at_most: int) -> tuple[NDArray[np.uint64], NDArray[np.intp]]:
    """Valid pixels in every s-th row and column, and where they stand.

    Returns
    -------
    pixels
        (Q,) indices in the order of x, about `at_most` at most, and at least one.
    index
        (rows, columns): position in `pixels`, or −1 where the pixel there is not valid.
    """
    step = max(1, math.ceil(math.sqrt(layout.pixels / at_most)))
    # A picture or mask that is long and narrow has more pixels on a lattice than a square has.
    while (places := _places(layout.valid, step))[0] > 1.25 * at_most:
        step += 1
    _, row, column = places
    height, width = layout.valid.shape
    everywhere = numbered(layout)
    found = everywhere[np.ix_(np.arange(row, height, step), np.arange(column, width, step))]
    inside = found >= 0
    index = np.full(found.shape, -1)
    index[inside] = np.arange(np.count_nonzero(inside))
    return found[inside].astype(np.uint64), index


def _places(valid: NDArray[np.bool_], step: int) -> tuple[int, int, int]:
    """How many valid pixels a lattice has, and its first row and column.

    It begins half a step from the border, unless a mask with a pattern of its own (every other
    row, say) leaves it less than half of its share there.
    """
    rows, columns = np.nonzero(valid)
    counts = np.bincount(rows % step * step + columns % step, minlength=step**2)
    middle = [min(step // 2, size - 1) for size in valid.shape]
    place = middle[0] * step + middle[1]
    if 2 * step**2 * counts[place] < len(rows):
        place = int(counts.argmax())
    return int(counts[place]), place // step, place % step


def numbered(layout: ParameterLayout) -> NDArray[np.intp]:
    """(H, W): the index of each valid pixel in the order of x, −1 elsewhere."""
    index = np.full(layout.valid.shape, -1)
    index[layout.valid] = np.arange(layout.pixels)
    return index
