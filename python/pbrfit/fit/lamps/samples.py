"""What a start is found from, the samples of the pixels of a mask, and what is found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.sampling import placed, slices
from pbrfit.fit.settings import COMPARE_PATCHES, PIXELS_AT_ONCE
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array, Floats, Mask

Pixels = slice | NDArray[np.intp]
Pictures = NDArray[Any] | Sequence[NDArray[Any]]
"""(N, H, W, C)"""
Colors = tuple[Floats, Mask]
"""(P, N, C) of some pixels, finite, and which of them are told: usable, such as not clipped."""

MATT_PIXELS = 4000
"""Pixels that lamps are found from, or held against, by matt shading: N lamps of three numbers each
are known to a per cent of σ by as many, and each patch of the picture has 60."""

BAS_RELIEF = np.zeros((3, 3, 3))
BAS_RELIEF[0, [0, 1], [0, 1]] = BAS_RELIEF[1, 0, 2] = BAS_RELIEF[2, 1, 2] = 1.0
"""By what M of the generalised bas-relief transformation differs from 1: how deep the surface is,
and the two planes that are added to it."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Pixels of the mask: their grey samples, and how to look at their colours."""

    colors: Callable[[Pixels], Colors]
    """Of some of the pixels: all at once would be a second copy of the pictures."""
    relative: Array
    """(P, N): grey samples divided by the brightness of their pixel."""
    usable: Mask
    """(P, N)"""
    brightness: Array
    """(P,): the median of each pixel's samples that are not black, at least a ten-thousandth of
    that of all pixels, which keeps black pixels finite."""
    where: tuple[NDArray[np.intp], ...]
    mask: Mask
    threads: int = 0

    @classmethod
    def of(cls, colors: Callable[[Pixels], Colors], mask: Mask, threads: int = 0) -> Samples:
        """Of colours of the pixels of a mask (H, W)."""
        where = np.nonzero(mask)
        count, pictures = len(where[0]), colors(slice(1))[0].shape[1]
        relative, usable = np.empty((count, pictures)), np.empty((count, pictures), bool)
        middle = np.empty(count)

        def read(piece: slice) -> None:
            grey, used = grey_samples(*colors(piece))
            relative[piece], usable[piece] = grey, used
            middle[piece] = median_where(used & (grey > 0), grey)

        in_pieces(threads, read, slices(count, PIXELS_AT_ONCE))
        some = middle > 0
        floor = 1e-4 * float(np.median(middle[some])) if some.any() else 1.0
        brightness = np.maximum(middle, max(floor, np.finfo(np.float64).tiny))
        relative /= brightness[:, None]
        return cls(colors, relative, usable, brightness, where, mask, threads)

    @classmethod
    def of_pictures(
        cls, samples: Pictures, usable: Pictures, mask: Mask, threads: int = 0
    ) -> Samples:
        """Of pictures (N, H, W, C), in which some values are usable, of that shape."""
        if len(samples) < 3:
            raise InputError(f"pictures: expected three or more of one view, found {len(samples)}")
        places = np.flatnonzero(mask)

        def at(pictures: Pictures, pixels: Pixels) -> NDArray[Any]:
            flat = [one.reshape(-1, one.shape[-1])[places[pixels]] for one in pictures]
            return np.stack(flat, axis=1)

        def colors(pixels: Pixels) -> Colors:
            found = at(samples, pixels)
            told = at(usable, pixels) & np.isfinite(found)
            found[~told] = 0.0
            return found, told

        return cls.of(colors, mask, threads)

    @property
    def pictures(self) -> int:
        """How many."""
        return int(self.relative.shape[1])

    def plane(self, values: NDArray[Any], outside: float) -> Array:
        """(H, W, ...) of values of pixels (P, ...)."""
        return placed(values, self.mask, outside)


@dataclass(frozen=True, eq=False)
class FirstShape:
    """Normals and lamps far away that pictures alone have told, where a joint fit begins.

    A sample is albedo times strength times max(n·l, 0).
    """

    normals: Array
    """(H, W, 3), NaN outside the mask."""
    albedo: Array
    """(H, W, 3) linear, up to a factor for each channel; NaN outside the mask."""
    directions: Array
    strengths: Array
    """(N, 3) each: unit vectors to the lamps, and their colours up to that factor."""
    undetermined: tuple[str, ...]
    """What the pictures leave open, each in words."""
    relief: Any = None
    """`ambiguity.Relief`, what the cues say of other bas-reliefs; None where lamps are known, or
    no outline is there, without which misfit would outvote all cues."""
    note: str = ""
    """How they were found, and what the pictures leave open."""


def median_where(counted: Mask, samples: Array) -> Array:
    """(P,): the median of those of each pixel's samples (P, N) that are counted; 0 of none."""
    count = np.count_nonzero(counted, axis=1)
    rising = np.sort(np.where(counted, samples, np.inf), axis=1)
    rows = np.arange(len(samples))
    middle = (rising[rows, (count - 1) // 2] + rising[rows, count // 2]) / 2
    return np.where(count > 0, middle, 0.0)


def grey_samples(colors: Floats, told: Mask) -> tuple[Array, Mask]:
    """Grey samples (P, N), and which are usable, of colours (P, N, C) of which some are told.

    A pixel is judged by the same channels in all pictures, those that are told most often. The red
    of a saturated orange is clipped wherever a lamp is near; its green and blue tell its shape.
    """
    often = told.sum(axis=1, keepdims=True)
    kept = often == often.max(axis=2, keepdims=True)
    grey = np.where(kept & told, colors, 0.0).sum(axis=2, dtype=np.float64) / kept.sum(axis=2)
    return grey, np.asarray((told | ~kept).all(axis=2))


def some_of(count: int, most: int) -> NDArray[np.intp]:
    """At most so many of the indices below `count`, at random but always the same."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


def blocks_of(where: tuple[NDArray[np.intp], ...]) -> NDArray[np.intp]:
    """Number of the block of each pixel."""
    rows, columns = where
    size = max(np.ptp(rows), np.ptp(columns)) / COMPARE_PATCHES + 1e-9
    down = np.minimum((rows - rows.min()) / size, COMPARE_PATCHES - 1).astype(np.intp)
    right = np.minimum((columns - columns.min()) / size, COMPARE_PATCHES - 1).astype(np.intp)
    return np.asarray(down * COMPARE_PATCHES + right)
