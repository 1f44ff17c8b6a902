"""The offset of relative depth, found by normals.

Some networks give depth, or its inverse, up to an unknown factor and an unknown offset:
z = s (d + b), or 1/z = s (d + b). The factor changes no direction of a surface, but the offset
does: the larger it is, beside the range of d, the flatter is the relief. So the offset is the one
by which the normals of the depth come nearest to given ones: the least median angle, over offsets
that make the smallest value from 1/100 to 100 times the range.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.scene.depth import COMPARED_MAX, every_few, median_angle

RATIOS = (0.01, 100.0)
"""Least and largest ratio of the smallest value, with its offset, to the range of the values."""

STEPS = 33
"""Offsets that are tried, evenly by their logarithm, before the best is refined."""


def with_offset(
    relative: NDArray[np.floating[Any]],
    normals: NDArray[np.float64],
    fov: float,
    *,
    disparity: bool = False,
) -> tuple[NDArray[np.float32], str]:
    """Depth (H, W) with the offset by which its normals are nearest to given ones (H, W, 3).

    `relative` (H, W) is depth up to factor and offset, or with `disparity` its inverse. Normals are
    in camera space, NaN where unknown. Returns depth of median 1, NaN where `relative` is; and in
    words how well it is known. Raises InputError without perspective, where no normals tell an
    offset, or if no pixel has both.
    """
    from scipy.optimize import minimize_scalar

    if fov == 0:
        raise InputError(
            "relative depth: expected a field of view above 0, found an orthographic camera"
        )
    values = np.asarray(relative, np.float64)
    values = np.where(np.isfinite(values), values, np.nan)
    some = every_few(values.shape, COMPARED_MAX)
    few, wanted = values[some], normals[some]
    low, span = float(np.nanmin(values)), float(np.nanmax(values) - np.nanmin(values))
    if not span > 0:
        raise InputError("relative depth: expected different depths, found all equal")

    def distances(of: NDArray[np.float64], log_ratio: float) -> NDArray[np.float64]:
        moved = of - low + span * np.exp(log_ratio)
        return np.asarray(1.0 / moved if disparity else moved)

    def angle(log_ratio: float) -> float:
        return median_angle(distances(few, log_ratio), wanted, fov)

    first, last = np.log(RATIOS).tolist()
    ratios = np.linspace(first, last, STEPS)
    with np.errstate(invalid="ignore"):
        tried = [angle(ratio) for ratio in ratios]
    if not np.isfinite(tried).all():
        raise InputError("relative depth: expected normals beside it, found none")
    best = int(np.argmin(tried))
    around = ratios[max(best - 1, 0)], ratios[min(best + 1, STEPS - 1)]
    refined = minimize_scalar(angle, bounds=around, method="bounded", options={"xatol": 1e-3})
    log_ratio = float(refined.x) if refined.fun < tried[best] else float(ratios[best])
    depth = distances(values, log_ratio)
    what = "inverse depth" if disparity else "depth"
    said = (
        f"the network gives {what} up to factor and offset: offset by the normals, factor unknown"
    )
    if best in (0, STEPS - 1):
        said += "; the offset is at the end of its range, so the normals hardly tell it"
    return (depth / np.nanmedian(depth)).astype(np.float32), said
