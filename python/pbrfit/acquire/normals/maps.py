"""Maps of other tools: arrays in files, and normals brought to the size of the pictures."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.lib.format import MAGIC_PREFIX
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.quoting import shown
from pbrfit.io.resampling import averaged, reduced_size
from pbrfit.scene.arrays import MIN_NORMAL_LENGTH


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
    expected = "expected an array of real numbers in .npy"
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers of long ago
            if file.read(len(MAGIC_PREFIX)) != MAGIC_PREFIX:
                raise ValueError("a file of another kind")
            # Mapped instead of read: no memory is taken for more than the file holds.
            array = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # headers are Python expressions, and fail in all ways of these
        raise InputError(f"{path}: {expected}, found {shown(error)}") from None
    if array.dtype.kind not in "uif":
        raise InputError(f"{path}: {expected}, found {array.dtype}")
    if array.size == 0:
        raise InputError(f"{path}: {expected}, found an empty one, of shape {array.shape}")
    with np.errstate(all="ignore"):  # of more than 64 bits; infinity is no normal, and no depth
        return np.array(array, np.float64)
