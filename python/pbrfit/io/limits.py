"""Samples at a limit of their file: what is stored bounds the radiance and does not tell it.

Above the largest value that a file or a sensor holds there may have been any amount of light more.
Below the smallest there was less, but radiance is not negative, so what is hidden there is at most
the value of that code. Where both meet in one number, the bound from above is the one that counts.
"""

from __future__ import annotations

import numpy as np

from pbrfit.values.arrays import Array, Codes

ORDINARY, AT_LEAST, AT_MOST = 0, 1, 2
"""What a sample says of the true radiance: what it is; at least so much; at most so much."""

Limits = Codes

_NO_PART = 1e-3
"""Share of a file's channel in a converted one up to which it has no part: rounding of profiles."""


def converted(limits: Limits, matrix: Array | None) -> Limits:
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
