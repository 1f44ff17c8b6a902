"""Normals from a file that somebody has: of normals in any of the usual conventions, or of depth.

Depth up to an unknown factor is enough, because scaling a scene about the camera turns no surface.
Depth up to an unknown offset, as some estimators give it ("relative depth"), is not.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.depth_files import read_depth
from pbrfit.io.normal_files import MIN_NORMAL_LENGTH, Convention, read_normals
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.model.depth_normals import FACING, DepthKind, from_depth
from pbrfit.scene.depth import without_holes

log = logging.getLogger("pbrfit")

Array = NDArray[np.float64]

BEHIND_SHARE_MAX = 0.01
"""Share of the pixels of a tangent-space map above which normals that point behind its surface say
that it is of another space."""

DIFFERENT_DEPTHS_MIN = 1024
"""Different depths in a map below which normals show steps, which is warned of."""


def from_normals(
    path: Path, size: tuple[int, int], convention: Convention
) -> tuple[Array, NDArray[np.bool_], tuple[str, ...]]:
    """Normals of a file in camera space, at the size (height, width) of the pictures.

    The file is one that `read_normals` reads. The map has the pictures' size, or is larger in the
    same proportion; then normals are averaged. Returns normals, known, said: (H, W, 3) unit
    vectors; (H, W), where the file has one, which elsewhere faces the viewer; and how the file was
    read, in words. Raises InputError or OSError if the file holds no normals, those of another
    frame, or of another proportion.
    """
    read = read_normals(path)
    stored = read.vectors
    check_reducible(path, stored.shape, size)
    length = np.linalg.norm(stored, axis=-1)
    known = np.isfinite(length)
    if not known.any():
        raise InputError(f"{path}: expected unit vectors, found no vector of a length near 1")
    if convention.frame == "tangent":
        behind = float(np.mean(stored[known][:, 2] < 0))
        if behind > BEHIND_SHARE_MAX:
            raise InputError(
                f"{path}: expected tangent space, where Z is above 0, found {100 * behind:.0f} % "
                "below; is it camera space (--frame camera)?"
            )
    try:
        turned = convention.to_camera(np.where(known[..., None], stored, 0.0))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    unit = turned / np.where(known, length, 1.0)[..., None]
    return *_at_size(np.where(known[..., None], unit, FACING), known, size), read.said


def of_depth(
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
    check_reducible(path, depth.shape, size)
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
    return _at_size(normals, known, size)


def _at_size(
    normals: Array, known: NDArray[np.bool_], size: tuple[int, int]
) -> tuple[Array, NDArray[np.bool_]]:
    """Unit normals averaged over the pixels of a smaller picture, and made unit again.

    What is not known, or cancels, faces the viewer. Also returns what is known at that size.
    """
    if known.shape == size:
        return normals, known
    small = averaged_channels(np.where(known[..., None], normals, 0.0), size)
    length = np.linalg.norm(small, axis=-1)
    # A pixel of which a part is known has a normal, if only that of the part.
    share = averaged(known, size)
    told = (share > 0.5) & (length >= MIN_NORMAL_LENGTH)
    length[~told] = 1.0
    return np.where(told[..., None], small / length[..., None], FACING), told


def check_reducible(path: Path, shape: tuple[int, ...], size: tuple[int, int]) -> None:
    """Check that a map of this shape becomes one of (height, width) by averaging.

    Raises InputError if it is smaller, or of another proportion; it names `path`.
    """
    height, width = size
    larger = shape[0] >= height and shape[1] >= width
    if not larger or reduced_size(shape, max(size)) != size:
        raise InputError(
            f"{path}: expected the pictures' size, {width} × {height} pixels, or a larger one in "
            f"the same proportion, found {shape[1]} × {shape[0]}"
        )


def check_source(what: str, source: str, sources: str) -> None:
    """Check that a source that is taken for a file may be one, as a misspelt name may not.

    Raises InputError that names the `sources` there are.
    """
    path = Path(source)
    if not path.exists() and path.name == source and not path.suffix:
        raise InputError(f"{what}: expected {sources}, found {source!r}")
