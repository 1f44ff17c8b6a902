"""What lasts under every light: gradients that all pictures of a view have in common.

A pixel's logarithm is the sum of those of albedo and of illumination. Illumination varies slowly,
or in other places in every picture; so the median over pictures of the gradient is the gradient of
the albedo (Weiss, Deriving intrinsic images from image sequences, 2001), and the median distance
from it, s, says how far it can be relied on there. Where a picture was painted over, the lasting
gradients are missing, and what replaces them does not correlate with them. So over a window

    kept = Σ w g · r / Σ w |r|²,    w = 1 / (s₀² + s²)

with the picture's gradients g and the lasting ones r is 1 for an honest picture whatever its light
and its shadows, whose borders are elsewhere, and 0 where the content is another.

Near black, log(I + ε) flattens: gradients are I / (I + ε) times those of log I. The lasting ones
are multiplied by the same factor before they are compared, so darkness is no evidence against a
picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.resampling import averaged
from pbrfit.registration.alignment import gradient
from pbrfit.values.arrays import Array, Mask

_FLOOR = 0.02  # ε, of white
_NOISE = 0.02  # s₀, gradient of a logarithm
_BLUR = 0.8  # pixels
_CLIPPED = 0.94  # of white: JPEG and resampling smear what is clipped
_BLACK = 0.004  # of white, code 13 of 255: below it whole numbers hide gradients
_DARKEST = 0.3  # I / (I + ε) below which a gradient says nothing

WINDOW = 24.0
"""Standard deviation of the window in pixels."""

LEAST = 3.0
"""Evidence, Σ w |r|² in the mean of a window, below which it is not judged."""


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients of the logarithm of a picture."""

    values: NDArray[np.complex64]
    """(H, W, 3) complex64: x + i y, of log(I + ε)."""
    factor: NDArray[np.float32]
    """(H, W, 3) float32: I / (I + ε)."""
    sound: Mask
    """(H, W, 3) bool: neither clipped nor black."""


def gradients(image: NDArray[Any], mask: Mask | None = None) -> Gradients:
    """Gradients of a picture (H, W, 3) of linear values, white = 1."""
    from scipy.ndimage import binary_erosion, gaussian_filter

    smooth = gaussian_filter(np.asarray(image, np.float32).clip(0), (_BLUR, _BLUR, 0))
    g = gradient(smooth)
    sound = (image < _CLIPPED) & (image > _BLACK)
    if mask is not None:
        sound &= mask[..., None]
    sound = binary_erosion(sound, structure=np.ones((3, 3, 1), bool), border_value=1)
    factor = (smooth / (smooth + _FLOOR)).astype(np.float32)
    return Gradients((g / (smooth + _FLOOR)).astype(np.complex64), factor, sound)


Lasting = tuple[NDArray[np.complex64], NDArray[np.float32]]
"""Gradients that pictures have in common, (H, W, 3), and their weight w."""


def lasting(pictures: Sequence[Gradients]) -> Lasting:
    """What pictures have in common: medians, component by component.

    Row by row, so that the memory does not grow with the number of pictures more than it must.
    """
    shape = pictures[0].values.shape
    values = np.empty(shape, np.complex64)
    weight = np.empty(shape, np.float32)
    for row in range(shape[0]):
        g = np.stack([p.values[row] / np.maximum(p.factor[row], _DARKEST) for p in pictures])
        middle = np.median(g.real, axis=0) + 1j * np.median(g.imag, axis=0)
        spread = np.median(np.abs(g - middle), axis=0)
        values[row] = middle
        weight[row] = 1 / (_NOISE**2 + spread**2)
    return values, weight


def kept(picture: Gradients, reference: Lasting, size: tuple[int, int]) -> Array:
    """Share of the lasting gradients that a picture keeps, at the most.

    The border of one shadow in a window of few lasting gradients lowers the share by chance, the
    more the fewer they are. So 1/√(Σ w |r|²) is added to it. Returns (h, w): 1 or more for an
    honest picture, about 0 where the content is another; NaN where there is too little to judge by.

    Both are of one size; `size` (h, w) is that of the result, averaged down: the window is wide.
    """
    from scipy.ndimage import gaussian_filter

    values, trust = reference
    expected = picture.factor * values
    weight = picture.sound * trust
    along = (weight * (picture.values * expected.conj()).real).sum(axis=-1)
    there = (weight * np.abs(expected) ** 2).sum(axis=-1)
    pixel = along.shape[0] / size[0]
    along, evidence = (
        gaussian_filter(averaged(part, size), WINDOW / pixel) for part in (along, there)
    )
    sure = np.maximum(evidence, LEAST)
    return np.where(evidence > LEAST, along / sure + 1 / np.sqrt(sure), np.nan)
