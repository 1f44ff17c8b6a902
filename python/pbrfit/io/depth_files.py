"""Depth maps as files: found in a scene folder, read, written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.images import read_stored
from pbrfit.io.input_files import there
from pbrfit.io.quoting import listed

DEPTH_FILES = ("depth.exr", "depth.npy")

CHANNELS = ("Z", r"(.+\.)?depth(\.[RVXYZ])?", "Y", "R")
"""Patterns of channels that may hold depth in an EXR file, in the order in which they are tried."""


def find_depth(folder: Path) -> Path | None:
    """The file with depth that a scene folder has; InputError if it has both."""
    found = [path for name in DEPTH_FILES if there(path := folder / name)]
    if len(found) > 1:
        raise InputError(f"{folder}: expected {' or '.join(DEPTH_FILES)}, found both")
    return found[0] if found else None


def read_depth(path: Path) -> NDArray[np.float64]:
    """(H, W) as stored: of an EXR file, another picture or .npy."""
    stored = read_stored(path)
    if isinstance(stored, dict):
        found = [name for one in CHANNELS for name in stored if re.fullmatch(one, name, re.I)]
        if not found and len(stored) > 1:
            raise InputError(
                f"{path}: expected one of the channels Z, depth.Z, Y, R, found {listed(stored)}"
            )
        return stored[(*found, *stored)[0]].astype(np.float64)
    if stored.ndim == 3 and len(stored) == 1:
        stored = stored[0]
    elif stored.ndim == 3 and stored.shape[-1] <= 4:  # of a picture, maybe with alpha
        if stored.shape[-1] > 2 and (stored[..., 1:3] != stored[..., :1]).any():
            raise InputError(
                f"{path}: expected depth in one channel, found colours; a coloured picture of "
                "depth cannot be read back"
            )
        stored = stored[..., 0]
    if stored.ndim != 2:
        raise InputError(f"{path}: expected depth (H, W), found shape {stored.shape}")
    return np.ascontiguousarray(stored, dtype=np.float64)


def write_depth(path: Path, depth: NDArray[np.floating[Any]]) -> None:
    """Write depth (H, W) as float32 EXR, channel Z; NaN where it is unknown."""
    images.write_exr(path, {"Z": depth})
