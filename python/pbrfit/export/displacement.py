"""The height of a result as a texture: pixels in EXR, a share of a stated range in PNG."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.export.maps import Bits
from pbrfit.model.materials import nearest_inside
from pbrfit.result.result import Result


@dataclass(frozen=True)
class Displacement:
    """Height towards the viewer; where it is unknown, that of the nearest pixel."""

    height: NDArray[np.float64]
    """(H, W), pixels."""
    low: float
    high: float
    """The lowest and the highest, which integer files have as 0 and as their largest code."""

    @classmethod
    def of(cls, result: Result) -> Displacement | None:
        """Of a result; None where it has no height."""
        if result.height is None:
            return None
        known = np.isfinite(result.height)
        if not known.any():
            return None
        height = np.asarray(result.height, np.float64)[nearest_inside(known)]
        return cls(height, float(height.min()), float(height.max()))

    def integers(self, bits: Bits) -> NDArray[Any]:
        """(H, W, 1) uint8 or uint16."""
        largest = (1 << bits) - 1
        shares = (self.height - self.low) / ((self.high - self.low) or 1.0)
        codes = np.floor(shares * largest + 0.5)[..., None]
        return codes.astype(np.uint8 if bits == 8 else np.uint16)

    def as_json(self) -> dict[str, Any]:
        """What `export.json` holds under `displacement`."""
        return {
            "unit": "pixels",
            "width": self.height.shape[1],
            "low": self.low,
            "high": self.high,
        }
