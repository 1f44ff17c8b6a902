"""Normals from a depth map.

A map up to an unknown factor is enough, because scaling a scene about the camera turns no surface.
A map up to an unknown offset, as some estimators give it ("relative depth"), is not.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire.normals.maps import check_reducible, fit_to_size
from pbrfit.io.depth_files import read_depth
from pbrfit.model.depth_normals import DepthKind, from_depth
from pbrfit.scene.depth import without_holes

log = logging.getLogger("pbrfit")

Array = NDArray[np.float64]

DIFFERENT_DEPTHS_MIN = 1024
"""Different depths in a map below which normals show steps, which is warned of."""


def from_file(
    path: Path,
    size: tuple[int, int],
    *,
    fov: float,
    kind: DepthKind = "z",
    view_width: float | None = None,
) -> tuple[Array, NDArray[np.bool_]]:
    """Normals of a depth map in a file, at the size (height, width) of the pictures.

    The file is one that `read_depth` reads, of the pictures' size or larger in the same proportion;
    then normals are averaged. All else, and what is returned, is as for `from_depth`. Raises
    InputError or OSError if the file holds no depth, or of another proportion.
    """
    depth, _ = read_depth(path)
    if depth.shape != size:
        check_reducible(path, depth.shape, size)  # before any work is done on it
    try:
        if kind != "disparity":
            depth = np.where(np.isnan(without_holes(depth)[0]), np.nan, depth)
        normals, known = from_depth(depth, fov=fov, kind=kind, view_width=view_width)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if not known.any():
        raise InputError(
            f"{path}: expected depths above 0, found none beside another; 0, infinite and NaN "
            "say that nothing was hit"
        )
    different = len(np.unique(depth[known]))
    if 1 < different < min(DIFFERENT_DEPTHS_MIN, depth.size // 8):
        log.warning(
            "%s: only %d different depths: normals will show steps; a float or 16-bit map that "
            "uses its range is better",
            path,
            different,
        )
    return fit_to_size(normals, known, size, path)
