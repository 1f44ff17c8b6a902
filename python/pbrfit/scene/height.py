"""Height of a surface as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io import images
from pbrfit.model.materials import nearest_inside

HEIGHT_FILE = "height.exr"
"""Channels Y, in pixels towards the viewer, and mask.Y, 1 = known."""


def write_height(path: Path, height: NDArray[np.floating[Any]]) -> None:
    """Write a height (H, W), NaN where unknown; there the file has what the nearest pixel has."""
    known = np.isfinite(height)
    filled = np.where(known, height, 0.0)[nearest_inside(known)]
    channels = {"Y": filled.astype(np.float32), "mask.Y": known.astype(np.float32)}
    images.write_exr(path, channels)
