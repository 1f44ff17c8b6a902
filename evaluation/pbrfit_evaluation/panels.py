"""Panels of a report that records keep: pictures of one size side by side, as one PNG."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.result.sheet import as_png


def packed(panels: Mapping[str, NDArray[np.floating[Any]]]) -> dict[str, Any]:
    """(H, W, 3) values in [0, 1] by name, for JSON; `unpacked` undoes it, to 8 bits."""
    side_by_side = np.concatenate([np.clip(of, 0, 1) for of in panels.values()], axis=1)
    png = as_png((255 * side_by_side + 0.5).astype(np.uint8))
    return {"names": list(panels), "png": base64.b64encode(png).decode("ascii")}


def unpacked(kept: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """(H, W, 3) values in [0, 1] by name."""
    with Image.open(io.BytesIO(base64.b64decode(kept["png"]))) as image:
        pixels = np.asarray(image.convert("RGB")) / 255
    return dict(zip(kept["names"], np.split(pixels, len(kept["names"]), axis=1), strict=True))
