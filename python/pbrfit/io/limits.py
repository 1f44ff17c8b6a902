"""Samples at a limit of their file: what is stored bounds the radiance and does not tell it.

Above the largest value that a file or a sensor holds there may have been any amount of light more.
Below the smallest there was less, but radiance is not negative, so what is hidden there is at most
the value of that code. Where both meet in one number, the bound from above is the one that counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core

ORDINARY, AT_LEAST, AT_MOST = 0, 1, 2
"""What a sample says of the true radiance: what it is; at least so much; at most so much."""

Limits = NDArray[np.uint8]

_NO_PART = 1e-3
"""Share of a file's channel in a converted one up to which it has no part: rounding of profiles."""


def of_colors(matrix: NDArray[np.float64] | None) -> Limits:
    """(27, 3): `converted` limits of red, green and blue, at 9 red + 3 green + blue."""
    return converted(np.indices((3, 3, 3), dtype=np.uint8).reshape(3, 27).T, matrix)


def converted(limits: Limits, matrix: NDArray[np.float64] | None) -> Limits:
    """Limits (..., 3) of the colours that a matrix makes, from those of its channels.

    Of a channel that is clipped from above, or several, the radiance exceeds the stored one by an
    unknown amount, taken as the same in all of them: the sum of their coefficients tells the side.
    What is hidden below the lowest code is small beside it, and counts where nothing else does.
    """
    if matrix is None:
        return limits
    parts = np.where(np.abs(matrix) > _NO_PART, matrix, 0.0).astype(np.float32)
    found = np.zeros_like(limits)
    for c, row in enumerate(parts):
        for same, opposite in ((AT_MOST, AT_LEAST), (AT_LEAST, AT_MOST)):
            sums = (limits == same) @ row
            found[..., c][sums > 0], found[..., c][sums < 0] = same, opposite
    return found


def averaged(
    limits: Limits, size: tuple[int, int], matrix: NDArray[np.float64] | None = None
) -> Limits:
    """Limits (height, width, 3), `converted`, of means over the area that falls on each pixel.

    A mean that has a part in a sample of "at least" is at least what it is, whatever else it has a
    part in; else it is "at most" if it has a part in one of those.
    """
    codes = np.array([1, 2, 0], np.uint8)[limits]  # below 1 is "at most", above it "at least"
    every = [(0, length) for length in limits.shape[:2]]
    no_curve, colors = np.zeros((1, 256), np.float32), of_colors(matrix)
    found = np.zeros((*size, 3), np.uint8)
    light = np.empty(found.shape, np.float32)
    _core.average_light(codes, every, no_curve, (1, 1), colors, light, found)
    return found
