"""Float pictures that were clipped before they were stored: a plateau at the maximum.

Samples of a continuous signal hardly ever repeat their exact maximum, and where values have few
digits (half floats, former 8-bit codes) all of them repeat alike. The upper tail of a histogram
falls: the largest value is met at most as often as each of the next K distinct ones. So of c
samples at the maximum and t at those K values, c is at most binomial, B(c + t, 1 / (K + 1)), and
where chance leaves so many less than `CHANCE`, the tail was cut off there. With K = 32 values that
are met once each that is from 10 samples on.

Constant surfaces and backgrounds repeat too. Their value differs from picture to picture with the
light, and stands apart from the next ones, while a tail that was cut off reaches up to the cut: the
gap below the maximum is exponential with the mean of the next K gaps. A plateau of one picture
counts where chance leaves so wide a gap at least `CHANCE`; one that several pictures share to the
last bit counts anyhow. A constant lamp in all pictures counts as clipped: it is at least as bright.

Zeros are black, not clipped: nothing is sought at the minimum.
"""

from __future__ import annotations

import math

import numpy as np

from pbrfit.io.limits import AT_LEAST, Limits
from pbrfit.values.arrays import Floats, Mask

CHANCE = 1e-6
"""Probability of a false alarm, of each of the 3 (N + 1) maxima that are looked at."""

NEXT_VALUES = 32
"""K: distinct values below the maximum that tell how often one is met, and how far apart they are.
Data with fewer are no continuous signal, and have no plateau."""

_COUNT_MIN = 10
"""Fewest samples at a maximum that can be a plateau: 9 beside K values have a chance of 3e-6."""


def plateaus(images: Floats, counted: list[Mask] | None, searched: list[bool]) -> Limits | None:
    """Limits (N, H, W, 3) of pictures that were clipped from above; None where none was.

    Only the values that are `counted`, (H, W, 3) bool a picture or None = all, and finite tell, and
    only pictures that are `searched` have limits.
    """
    which = [i for i, one in enumerate(searched) if one]
    if not which:
        return None

    def samples(i: int, c: int) -> Floats:
        plane = images[i, ..., c]
        return np.asarray(plane.ravel() if counted is None else plane[counted[i][..., c]])

    found = None
    for c in range(3):
        largest = np.array([samples(i, c).max(initial=-np.inf) for i in which])
        top = largest.max()
        cut = np.full(len(which), np.inf)
        at_top = np.flatnonzero(largest == top)
        pooled = [samples(which[j], c) for j in at_top]
        if len(at_top) > 1 and _is_cut(pooled, float(top), shared=True):
            cut[at_top] = top
        for j, i in enumerate(which):
            if np.isinf(cut[j]) and _is_cut([samples(i, c)], largest[j], shared=False):
                cut[j] = largest[j]
        for i, least in zip(which, cut, strict=True):
            if np.isfinite(least):
                if found is None:
                    found = np.zeros(images.shape, dtype=np.uint8)
                found[i, ..., c][images[i, ..., c] >= least] = AT_LEAST
    return found


def _is_cut(planes: list[Floats], top: float, *, shared: bool) -> bool:
    """Whether the tail of these samples was cut off at their maximum."""
    count = sum(int(np.count_nonzero(plane == top)) for plane in planes)
    if count < _COUNT_MIN or not np.isfinite(top):
        return False
    rest = np.concatenate([plane[plane < top] for plane in planes]).astype(np.float64)
    keep = 4 * NEXT_VALUES
    while True:
        part = rest if keep >= len(rest) else np.partition(rest, len(rest) - keep)[-keep:]
        values, counts = np.unique(part, return_counts=True)
        # Of the smallest in a part some may have been left out of it.
        if len(values) > NEXT_VALUES or len(part) == len(rest):
            break
        keep *= 8
    if len(values) < NEXT_VALUES:
        return False
    from scipy.special import bdtrc

    # The next distinct values below the maximum, falling, and how often each is met.
    values, counts = values[: -NEXT_VALUES - 1 : -1], counts[: -NEXT_VALUES - 1 : -1]
    # Probability of `count` or more of all being in one of K + 1 equal cells.
    if bdtrc(count - 1, count + int(counts.sum()), 1 / (NEXT_VALUES + 1)) >= CHANCE:
        return False
    gap = float(values[0] - values[-1]) / (len(values) - 1)
    return shared or float(top - values[0]) <= -math.log(CHANCE) * gap
