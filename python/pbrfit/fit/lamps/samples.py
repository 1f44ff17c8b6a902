"""What a start is found from, the samples of the pixels of a mask, and what is found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.sampling import placed
from pbrfit.fit.settings import COMPARE_PATCHES

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MATT_PIXELS = 4000
"""Pixels that lamps are found from, or held against, by matt shading: N lamps of three numbers each
are known to a per cent of σ by as many, and each patch of the picture has 60."""

BAS_RELIEF = np.zeros((3, 3, 3))
BAS_RELIEF[0, [0, 1], [0, 1]] = BAS_RELIEF[1, 0, 2] = BAS_RELIEF[2, 1, 2] = 1.0
"""By what M of the generalised bas-relief transformation differs from 1: how deep the surface is,
and the two planes that are added to it."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Pixels of the mask: (P, N) grey samples, what of them is usable, and their colours."""

    colors: NDArray[np.floating[Any]]
    """(P, N, C): also those not told, such as clipped ones, and 0 for what is not finite."""
    told: Mask
    """(P, N, C): which of the colours are usable."""
    grey: Array
    usable: Mask
    brightness: Array
    where: tuple[NDArray[np.intp], ...]
    mask: Mask
    threads: int = 0

    @classmethod
    def of(cls, samples: Array, usable: Mask, mask: Mask, threads: int = 0) -> Samples:
        """Of pictures (N, H, W, C), in which some values are usable, of that shape."""
        if len(samples) < 3:
            raise InputError(f"pictures: expected three or more of one view, found {len(samples)}")
        colors = np.stack([picture[mask] for picture in samples], axis=1)
        told = np.stack([of[mask] for of in usable], axis=1) & np.isfinite(colors)
        colors[~np.isfinite(colors)] = 0.0
        grey, used = grey_samples(colors, told)
        bright = brightness(grey, used)
        return cls(colors, told, grey, used, bright, np.nonzero(mask), mask, threads)

    @property
    def pictures(self) -> int:
        """How many."""
        return int(self.grey.shape[1])

    @property
    def relative(self) -> Array:
        """Grey samples divided by the brightness of their pixel."""
        return np.asarray(self.grey / self.brightness[:, None])

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


def brightness(samples: Array, usable: Mask) -> Array:
    """Brightness q (P,): the median of each pixel's samples that are not black.

    At least a ten-thousandth of that of all pixels, which keeps black pixels finite.
    """
    lit = np.where(usable & (samples > 0), samples, np.nan)
    some = np.isfinite(lit).any(axis=1)
    middle = np.zeros(len(samples))
    middle[some] = np.nanmedian(lit[some], axis=1)
    floor = 1e-4 * float(np.median(middle[some])) if some.any() else 1.0
    return np.maximum(middle, max(floor, np.finfo(np.float64).tiny))


def grey_samples(colors: NDArray[np.floating[Any]], told: Mask) -> tuple[Array, Mask]:
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
