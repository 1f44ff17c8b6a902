"""Depth as a network would give it: the true one, disturbed.

Networks see outlines a little blurred, misjudge size and distance differently in different parts of
the picture, and are rough on surfaces. The model has three parts, in this order:

1. outlines are washed out: a Gaussian blur of inverse depth, `BLUR` wide, which leaves planes as
   they are;
2. scale and shift: depth z becomes s z + t, where ln s and t, in units of the median depth, vary
   smoothly over `WHOLE` of the width;
3. surfaces are rough: relative noise that is alike over `NOISE_LENGTH`.

`SCALE` and `SHIFT` are set for a relative error of about 5 % in the mean after the best common
factor; networks of metric depth publish 4 to 8 % on NYUv2. With a noise of 1 % the
normals of such depth are off by some 15 degrees in the median, as those of networks are. With
5 %, `ROUGH`, they say next to nothing (over 40 degrees): worse than networks are.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from pbrfit_evaluation.arrays import Array, Floats, Mask
from pbrfit_evaluation.normal_errors import smooth

BLUR = 0.75
"""Standard deviation in pixels: a step takes 2 pixels from a tenth to nine tenths."""

WHOLE = 0.4
"""Length over which scale and shift are alike, in shares of the picture's width."""

SCALE, SHIFT = 0.06, 0.04
"""Standard deviations of ln s and of t."""

NOISE, ROUGH = 0.01, 0.05
"""Standard deviations of the relative noise: of a network, and of something worse."""

NOISE_LENGTH = 3.0
"""Pixels over which noise is alike."""

LEAST = 0.05
"""Share of the true depth that is left at least."""


def disturbed(depth: Floats, rng: Generator, *, noise: float = NOISE) -> Array:
    """True depth (H, W) along the camera's axis with the errors of a network, in its unit.

    `noise` is the standard deviation of the relative noise. NaN, unknown, stays NaN.
    """
    known = np.isfinite(depth)
    true = np.where(known, depth, 1.0).astype(np.float64)
    scale, shift = (smooth(depth.shape, WHOLE, rng) for _ in range(2))
    rough = smooth(depth.shape, NOISE_LENGTH / depth.shape[1], rng)
    blurred = 1.0 / _blurred(1.0 / true, known, BLUR)
    moved = np.exp(SCALE * scale) * blurred
    moved += SHIFT * np.median(true[known]) * shift
    found = np.exp(noise * rough) * moved
    return np.where(known, np.maximum(found, LEAST * true), np.nan)


def _blurred(values: Array, known: Mask, width: float) -> Array:
    """Gaussian means over known pixels."""
    from scipy.ndimage import gaussian_filter

    total, weight = (
        gaussian_filter(of, width, mode="constant") for of in (values * known, known.astype(float))
    )
    return np.asarray(np.where(known, total, 1.0) / np.where(known, weight, 1.0))


def estimated(depth: Floats, seed: int, *, noise: float = NOISE) -> Array:
    """Depth of a synthetic scene as a network would give it, by the scene's seed."""
    # A stream of its own, apart from those of the scene and of its normals.
    return disturbed(depth, np.random.default_rng([seed, 3]), noise=noise)
