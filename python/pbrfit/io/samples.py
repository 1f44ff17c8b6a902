"""Files of data, such as normals and depth, as they are stored: told by content, not by suffix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import MAGIC_PREFIX
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.io.images import _load, _oriented
from pbrfit.io.input_files import names_file, open_file
from pbrfit.io.npy_files import read_npy

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
        return read_npy(path)
    path, data, kind = _load(path)
    if kind == "EXR":
        return _core.decode_exr(data, path)[0]
    return _oriented(_core.decode_raster(data, path, indices=False))
