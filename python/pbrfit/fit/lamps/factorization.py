"""Pseudo-normals and unknown lamps, up to a matrix: a robust factorisation of rank 3.

With P pixels in N pictures, the radiance of a diffuse surface under distant lamps is I = B Sᵀ, B
(P, 3) of pseudo-normals and S (N, 3) of lamps, wherever b·s > 0; any invertible A gives B A and
S A⁻ᵀ the same pictures (Hayakawa, "Photometric stereo under a light source with arbitrary motion",
Journal of the Optical Society of America A 11, 1994). Shadows, highlights and clipped samples do
not belong to the product. So instead of a singular value decomposition, which has no place for
missing entries, pixels and pictures take turns: b of each pixel by robust photometric stereo under
the lamps so far (`photometric`), then s of each picture by the same robust loss over pixels. The
loss has minima of its own, so its scale σ falls from wide to what the residuals say.

S is given with SᵀS/N = 1. The lengths of the principal directions are in `spread`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.photometric import (
    DARK,
    MEDIAN_TO_SIGMA,
    SCALE_MIN,
    PseudoNormals,
    brightness,
    pseudo_normals,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCALES = (0.3, 0.2, 0.14, 0.1, 0.07, 0.05)
"""σ of the first rounds, of a pixel's brightness: from all of shading's own spread, so that all
samples count, down to that of highlights and shadows."""

ROUNDS_MAX = 40
"""Rounds at most after the first ones."""

UNCHANGED = 1e-4
"""Sine of the largest angle between the lamps' spaces of two rounds below which they are found: a
hundredth of a degree."""

RANK_MIN = 3.0
"""Least size of the third direction of the factors, in standard deviations of the residuals' own
share of it, with which there are three."""


@dataclass(frozen=True, eq=False)
class Factors:
    """B Sᵀ.

    Attributes
    ----------
    lamps
        (N, 3) S.
    normals
        The pixels' b, their weights and covariances.
    rank
        3, or 2 or 1 if lamps lie in a plane or a line, as far as the samples show.
    spread
        (3,) root mean square size of the product's three directions, of the pixels' brightness.
    """

    lamps: Array
    normals: PseudoNormals
    rank: int
    spread: Array


def factors(samples: Array, usable: Mask) -> Factors:
    """Factors of samples (P, N), of those that are usable (P, N); N of 3 or more.

    Pixels with fewer than three usable samples that are not dark tell nothing of lamps.
    """
    bright = brightness(samples, usable)
    relative = samples / bright[:, None]
    lit = usable & (relative >= DARK)
    telling = lit.sum(axis=1) >= 3
    relative, usable, lit = relative[telling], usable[telling], lit[telling]
    lamps = _start(relative, lit)
    vectors: Array | None = None
    sigma = SCALES[0]
    for round_ in range(len(SCALES) + ROUNDS_MAX):
        first = round_ < len(SCALES)
        sigma = SCALES[round_] if first else sigma
        found = pseudo_normals(relative, usable, lamps, start=vectors, scale=sigma)
        before, lamps = lamps, _lamps_from(relative, usable, found.vectors, lamps, sigma)
        lamps, back = _whitened(lamps)
        vectors = found.vectors @ np.linalg.inv(back).T
        if not first:
            sigma = _scale_of(relative, usable, vectors @ lamps.T)
            if _largest_sine(before, lamps) < UNCHANGED:
                break
    return _ordered(relative, usable, lamps, vectors, sigma)
