"""How the lights of a fit may move when noise, and what pictures share, pull at them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.light_spectrum import of_objective
from pbrfit.fit.normal_equations import held_at_bounds
from pbrfit.fit.objective import Objective
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.fit.settings import (
    LIGHT_INFORMATION_MIN,
    LIGHT_PIXELS_MAX,
    OMITTED_VARIANCE_SHARE_MAX,
)

Array = NDArray[np.float64]


def light_modes(
    objective: Objective,
    x: Array,
    light_pixels: int = LIGHT_PIXELS_MAX,
    of_pixels: int | None = None,
) -> Array:
    """(R, N, K, C): the lights' covariance, of noise 1, as independent modes of deviation 1.

    From their spectrum over some pixels of a fit; those modes that matter to materials. None, R is
    0, where they are known. `of_pixels` is how many pixels saw them, if not those of the
    objective alone.

    The mode of λ adds (1 − λ)/λ to the sum over pixels of their variances in units of A⁻¹. That
    ranks the modes and bounds what those left out would add. A direction that materials can make up
    for completely has the least λ that is not rounding.
    """
    if objective.lighting is None:
        return np.zeros((0, objective.layout.pictures, objective.layout.coefficients, 1))
    held = held_at_bounds(x, objective.layout)
    layout = objective.layout
    pixels = evenly_spaced(layout.pixels, light_pixels)
    own_held = held[pixels]
    known = of_objective(objective, x, pixels, own_held)
    left, vectors = known.left, known.vectors
    light_channels, k = layout.light_channels, layout.coefficients
    blocks = layout.pictures * light_channels

    def in_x(of_units: Array) -> Array:
        """(modes, N, K, C) from modes in the columns."""
        modes = np.einsum("aki,aim->mak", known.from_units, of_units.reshape(blocks, k, -1))
        modes = modes.reshape(-1, layout.pictures, light_channels, k).transpose(0, 1, 3, 2)
        return np.ascontiguousarray(np.repeat(modes, layout.channels // light_channels, axis=-1))

    # What the other pixels know of the lights is taken to be like what these know.
    more = (of_pixels or layout.pixels) / len(pixels)
    left = np.maximum(left, LIGHT_INFORMATION_MIN)
    deviation = 1 / np.sqrt(more * left)
    adds = (1 - left) / left
    remaining = np.cumsum(adds[::-1])[::-1] + known.rest / left[-1]  # λ rises
    remaining /= more * max(1, int(np.count_nonzero(~own_held)))
    used = int(np.count_nonzero(remaining > OMITTED_VARIANCE_SHARE_MAX))
    return in_x((vectors * deviation)[:, :used])
