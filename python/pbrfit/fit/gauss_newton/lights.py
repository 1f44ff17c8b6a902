"""What the core has to know, beside x and pixels, to solve for the pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.pixels import Pixels, Towards, taken
from pbrfit.fit.objective import Objective

Array = NDArray[np.float64]


def options(
    objective: Objective, x: Array, pixels: Pixels, towards: Towards | None
) -> dict[str, Any]:
    """Of mono lights and pulls."""
    layout = objective.layout
    found: dict[str, Any] = {"mono": layout.light_channels < layout.channels}
    if towards is not None:
        finish = taken(objective, x, pixels)[:, layout.channels :]
        found |= {
            "precision": towards.precision,
            "deviation": finish - towards.centre,
        }
    return found
