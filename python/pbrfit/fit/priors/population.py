"""What surfaces there are: the weak prior that everything else in `fit.priors` begins from.

Roughness and metallic of public material sets, one draw each (`tools/material_population.py`; the
sets and their licences are in docs/fit.md): fourteen sets have a roughness of 0.44 ± 0.23, of
which 7 % is below 0.1, and 17 % of their surface is metal; between both is 3 %. So few sets cannot
tell their mean roughness from the middle of the range, which this prior has; and their shares are
taken by Laplace's rule of succession, (14 share + 1) / (14 + 3) for three kinds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.values.arrays import Floats

METAL_SHARE, MIXED_SHARE = 0.2, 0.08
"""Share of surfaces of bare metal, and between it and dielectric: rust, dust, edges in a pixel."""

ROUGHNESS_DEVIATION, METALLIC_DEVIATION = 0.22, 0.41
"""Standard deviations of this prior."""

LOG_ALBEDO_DEVIATION = 0.45
"""Standard deviation of the logarithm of a picture's mean albedo, of which two lie between 0.15 and
0.8. Single sets have 0.7, and pictures hold several."""


def population(roughness: Floats, metallic: Floats) -> NDArray[np.float32]:
    """Probabilities of nodes (K,) of a grid with these values; their sum is 1."""
    inside = np.clip(roughness, 0.02, 0.98)
    density = inside * (1 - inside)  # of mean 0.5 and deviation 0.22, 3 % of it below 0.1
    levels = np.unique(metallic[(metallic != 0) & (metallic != 1)])
    of_pure = [1 - METAL_SHARE - MIXED_SHARE, METAL_SHARE]
    of_level = MIXED_SHARE / max(len(levels), 1)
    found = density * np.select([metallic == 0, metallic == 1], of_pure, of_level)
    return np.asarray(found / found.sum(), np.float32)
