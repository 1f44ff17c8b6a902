"""The height of a surface as a texture: picture widths in EXR, a share of a stated range in PNG.

The height is that which the fit found, else that which the normals integrate to
(`scene.integration`), with the depth where there is one. It is the distance out of the card of
`view_mesh` to the viewer, along the axis of the camera: a pixel of depth z lies on its ray at

    h = (z_m − z) / w,      w = 2 z_m tan(fov/2), orthographic w = 2,

z_m the median depth, at which the picture is w wide. So h and the camera of `view_mesh` are the
shape, but for its size; where the camera is orthographic, or the relief low beside its distance,
that is a card displaced along its normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.export.maps import Bits, codes
from pbrfit.model.materials import nearest_inside
from pbrfit.result.result import Result
from pbrfit.scene.integration import depth_from_normals
from pbrfit.values.arrays import Array

FLAT = 1e-6
"""Picture widths between lowest and highest below which there is nothing to displace."""


@dataclass(frozen=True)
class Displacement:
    """Height towards the viewer; where it is unknown, that of the nearest pixel."""

    height: Array
    """(H, W), picture widths."""
    low: float
    high: float
    """The lowest and the highest, which integer files have as 0 and as their largest code."""
    source: Literal["fit", "normals"]
    """Whether the fit found it, or it is what the normals integrate to."""

    @classmethod
    def of(cls, result: Result) -> Displacement | None:
        """Of a result; None where it is flat."""
        if result.height is not None:
            found = np.asarray(result.height, np.float64) / result.mask.shape[1]
        elif result.mask.size > 1:
            depth = None if result.depth is None else np.where(result.mask, result.depth, np.nan)
            if depth is not None and not np.isfinite(depth).any():
                depth = None
            given = result.normals, result.fov, result.mask, result.segments, depth
            distances = depth_from_normals(*given).astype(np.float64)
            middle = float(np.nanmedian(distances))
            tangent = math.tan(math.radians(result.fov) / 2)
            found = (middle - distances) / (2.0 if result.fov == 0 else 2 * middle * tangent)
        else:
            return None
        known = np.isfinite(found)
        if not known.any() or np.ptp(found[known]) < FLAT:
            return None
        height = found[nearest_inside(known)]
        source: Literal["fit", "normals"] = "normals" if result.height is None else "fit"
        return cls(height, float(height.min()), float(height.max()), source)

    def integers(self, bits: Bits) -> NDArray[Any]:
        """(H, W, 1) uint8 or uint16."""
        return codes((self.height - self.low) / (self.high - self.low), bits)[..., None]

    def as_json(self) -> dict[str, Any]:
        """What `export.json` holds under `displacement`."""
        facts = {name: getattr(self, name) for name in ("source", "low", "high")}
        return {"unit": "picture widths", **facts}
