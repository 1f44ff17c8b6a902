"""Files of data, such as normals and depth, as they are stored: told by content, not by suffix."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import MAGIC_PREFIX, open_memmap
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.io.images import _load, upright
from pbrfit.io.input_files import names_file, open_file
from pbrfit.io.quoting import shown

Channels = dict[str, NDArray[np.float32]]
"""Planes (H, W) of an EXR file by full name."""


@names_file
def read_stored(path: Path) -> NDArray[Any] | Channels:
    """Read the channels of an EXR file, or an array: (H, W, C) of another picture, or of .npy.

    Samples of a picture have the type and the values that the file has; .npy is float64. Raises
    InputError if the content cannot be used; OSError if the file cannot be read.
    """
    with open_file(path) as file:
        of_numpy = file.read(len(MAGIC_PREFIX)) == MAGIC_PREFIX
    if of_numpy or path.suffix.lower() == ".npy":
        return _read_npy(path)
    path, data, kind = _load(path)
    if kind == "EXR":
        return _core.decode_exr(data, path)[0]
    return upright(path, data)


def _read_npy(path: Path) -> NDArray[np.float64]:
    """Read an array of numpy's own format, without anything that could be code."""
    expected = "expected an array of real numbers in .npy"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers of long ago
            # Mapped instead of read: no memory is taken for more than the file holds.
            array = open_memmap(path, mode="r")
    except (OSError, MemoryError):
        raise
    except Exception as error:  # headers are Python expressions, and fail in all ways of these
        raise InputError(f"{path}: {expected}, found {shown(error)}") from None
    if array.dtype.kind not in "uif" or array.size == 0:
        raise InputError(f"{path}: {expected}, found {array.dtype} of shape {array.shape}")
    with np.errstate(all="ignore"):  # of more than 64 bits; infinity is no normal, and no depth
        return np.array(array, np.float64)
