"""Maps of other tools: arrays in files, and normals brought to the size of the pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.resampling import averaged, reduced_size
from pbrfit.scene import MIN_NORMAL_LENGTH


def fit_to_size(
    normals: NDArray[np.float64],
    known: NDArray[np.bool_],
    size: tuple[int, int],
    path: Path,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Average unit normals over the pixels of a smaller picture, and make them unit again.

    Parameters
    ----------
    normals, known
        (H, W, 3), and (H, W): where they mean anything.
    size
        (height, width); the map has this size, or is larger in the same proportion.
    path
        For messages.

    Returns
    -------
    normals, known
        Of that size. What is not known, or cancels, faces the viewer.

    Raises
    ------
    InputError
        If the map is smaller, or of another proportion.
    """
    if normals.shape[:2] == size:
        return normals, known
    check_reducible(path, normals.shape, size)
    planes = [averaged(np.where(known, normals[..., i], 0.0), size) for i in range(3)]
    small = np.stack(planes, axis=-1)
    length = np.linalg.norm(small, axis=-1)
    # A pixel of which a part is known has a normal, if only that of the part.
    share = averaged(known, size)
    told = (share > 0.5) & (length >= MIN_NORMAL_LENGTH)
    length[~told] = 1.0
    facing = np.array([0.0, 0.0, 1.0])
    return np.where(told[..., None], small / length[..., None], facing), told


def check_reducible(path: Path, shape: tuple[int, ...], size: tuple[int, int]) -> None:
    """Check that a map of this shape becomes one of (height, width) by averaging.

    Raises
    ------
    InputError
        If it is smaller, or of another proportion; it names `path`.
    """
    height, width = size
    larger = shape[0] >= height and shape[1] >= width
    if not larger or reduced_size(shape, max(size)) != size:
        raise InputError(
            f"{path}: expected the pictures' size, {width} × {height} pixels, or a larger one in "
            f"the same proportion, found {shape[1]} × {shape[0]}"
        )


def read_npy(path: Path) -> NDArray[np.float64]:
    """Read an array of numpy's own format, without anything that could be code.

    Raises
    ------
    InputError
        If the file is no array of real numbers.
    """
    try:
        array = np.load(path, allow_pickle=False)
    except ValueError as error:
        raise InputError(f"{path}: expected an array of numbers in .npy, found {error}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "uif":
        raise InputError(f"{path}: expected an array of real numbers in .npy")
    return array.astype(np.float64)
