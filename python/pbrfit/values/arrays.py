"""Types of arrays that signatures name; shapes stand in docstrings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Floats = NDArray[np.floating[Any]]
"""Of either precision."""

Mask = NDArray[np.bool_]

Codes = NDArray[np.uint8]
"""Of pictures as a screen or a network is given them, mostly sRGB; or kinds of samples."""
