"""Depth maps as files: found in a scene folder, and read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pbrfit.io import layers
from pbrfit.io.images import read_stored
from pbrfit.io.input_files import there, unexpected
from pbrfit.values.arrays import Array
from pbrfit.values.checks import finite
from pbrfit.values.quoting import listed, shown

DEPTH_FILES = ("depth.exr", "depth.npy", "depth.png")

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Units that the numbers of a depth map may count."""


def find_depth(folder: Path) -> Path | None:
    """The file with depth that a scene folder has; InputError if it has several."""
    found = [path for name in DEPTH_FILES if there(path := folder / name)]
    if len(found) > 1:
        raise unexpected(folder, "one file with depth", listed(path.name for path in found))
    return found[0] if found else None


def read_depth(path: Path, unit: float = 1.0, *, own: bool = False) -> tuple[Array, list[str]]:
    """(H, W) of an EXR file, another picture or .npy, and in words how it was read, if not plainly.

    Numbers are as stored, times a `unit` above 0, as of `METRES`. A scene folder's `own` file has
    more than 8 bits, and whole numbers where it has a unit: those that pbrfit wrote are metres by
    then. Raises InputError if there is no such depth in it, OSError if it cannot be read.
    """
    finite("unit", unit, f"{', '.join(METRES)} or a number above 0", np.finfo(float).tiny)
    said = [f"times {unit:g}"] * (unit != 1)
    stored = read_stored(path)
    if isinstance(stored, dict):
        names = list(stored)
        if len(names) > 1:
            expected = "depth in a channel Z, depth.Z, Y or R"
            _, names = layers.chosen(path, stored, layers.DEPTH, expected)
        said += [f"channel {shown(names[0])}"] * (names[0] != "Z")
        stored = np.stack([stored[name] for name in names], axis=-1)
    elif stored.ndim == 3 and len(stored) == 1:
        stored = stored[0]
    if stored.ndim == 3 and stored.shape[-1] <= 4:  # of a picture, maybe with alpha
        grey = np.broadcast_to(stored[..., :1], stored[..., :3].shape)
        if stored.shape[-1] > 2 and not np.array_equal(stored[..., :3], grey, equal_nan=True):
            found = "colours or vectors, which cannot be read back"
            raise unexpected(path, "depth in one channel", found)
        stored = stored[..., 0]
    if stored.ndim != 2:
        raise unexpected(path, "depth (H, W)", f"shape {stored.shape}")
    if own and stored.dtype == np.uint8:
        raise unexpected(path, "depth of 16 bits", "8: a picture to look at")
    if own and unit != 1 and np.fmod(stored[np.isfinite(stored)], 1).any():
        raise unexpected(path, "whole numbers beside a unit", "fractions")
    return np.multiply(stored, unit, dtype=np.float64), said
