"""Normals from a file that somebody has, in any of the usual conventions and sizes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.normal_files import MIN_NORMAL_LENGTH, Convention, read_normals
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.model.depth_normals import FACING

BEHIND_SHARE_MAX = 0.01
"""Share of the pixels of a tangent-space map above which normals that point behind its surface say
that it is of another space."""


def from_file(
    path: Path, size: tuple[int, int], convention: Convention
) -> tuple[NDArray[np.float64], NDArray[np.bool_], tuple[str, ...]]:
    """Normals of a file in camera space, at the size (height, width) of the pictures.

    The file is one that `read_normals` reads. The map has the pictures' size, or is larger in the
    same proportion; then normals are averaged. Returns normals, known, said: (H, W, 3) unit
    vectors; (H, W), where the file has one, which elsewhere faces the viewer; and how the file was
    read, in words. Raises InputError or OSError if the file holds no normals, those of another
    frame, or of another proportion.
    """
    read = read_normals(path)
    stored = read.vectors
    if stored.shape[:2] != size:
        check_reducible(path, stored.shape, size)  # before any work is done on it
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
    return *fit_to_size(np.where(known[..., None], unit, FACING), known, size, path), read.said


def fit_to_size(
    normals: NDArray[np.float64],
    known: NDArray[np.bool_],
    size: tuple[int, int],
    path: Path,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Average unit normals over the pixels of a smaller picture, and make them unit again.

    The map (H, W, 3), which means something where it is `known` (H, W), has the `size` (height,
    width), or is larger in the same proportion. Returns normals, known: of that size. What is not
    known, or cancels, faces the viewer. Raises InputError if the map is smaller, or of another
    proportion.
    """
    if normals.shape[:2] == size:
        return normals, known
    check_reducible(path, normals.shape, size)
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
