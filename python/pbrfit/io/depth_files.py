"""Depth maps as files: found in a scene folder, read, written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.input_files import there
from pbrfit.io.npy_files import read_npy
from pbrfit.io.quoting import listed

DEPTH_FILES = ("depth.exr", "depth.npy")

CHANNELS = ("Z", "depth.Z", "Depth.Z", "depth.V", "Depth.V", "depth.Y", "Y", "R")
"""Channels that may hold depth in an EXR file, in the order in which they are looked for."""


def find_depth(folder: Path) -> Path | None:
    """The file with depth that a scene folder has; InputError if it has both."""
    found = [path for name in DEPTH_FILES if there(path := folder / name)]
    if len(found) > 1:
        raise InputError(f"{folder}: expected {' or '.join(DEPTH_FILES)}, found both")
    return found[0] if found else None


def read_depth(path: Path) -> NDArray[np.float64]:
    """(H, W) as stored; integers are divided by the maximum of their type."""
    if path.suffix.lower() == ".npy":
        depth = read_npy(path)
        if depth.ndim == 3 and 1 in (depth.shape[0], depth.shape[-1]):
            depth = depth.reshape(depth.shape[1:] if depth.shape[0] == 1 else depth.shape[:2])
        if depth.ndim != 2:
            raise InputError(f"{path}: expected depth (H, W), found shape {depth.shape}")
        return depth
    if path.suffix.lower() == ".exr":
        channels = images.read_channels(path)
        name = next((name for name in CHANNELS if name in channels), None)
        if name is None and len(channels) == 1:
            [name] = channels
        if name is None:
            raise InputError(
                f"{path}: expected one of the channels {', '.join(CHANNELS)}, "
                f"found {listed(channels)}"
            )
        return channels[name].astype(np.float64)
    data = images.read_data(path)
    colors = data[..., : 3 if data.shape[-1] >= 3 else 1]
    if not (colors == colors[..., :1]).all():
        raise InputError(
            f"{path}: expected depth in one channel, found colours; a coloured picture of depth "
            "cannot be read back"
        )
    return np.ascontiguousarray(colors[..., 0])


def write_depth(path: Path, depth: NDArray[np.floating[Any]]) -> None:
    """Write depth (H, W) as float32 EXR, channel Z; NaN where it is unknown."""
    images.write_exr(path, {"Z": depth})
