"""Normals of a scene folder as files: found, read, turned into camera space, written.

Camera space has X right, Y up and Z towards the viewer. A file's `Convention` says what it means.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images, layers
from pbrfit.io.color import encode_srgb
from pbrfit.io.images import read_stored
from pbrfit.io.input_files import there, unexpected
from pbrfit.values.arrays import Array, Floats, Mask

NORMAL_FILES = ("normals.exr", "normals.png")

UNCERTAINTY = "uncertainty.Y"
"""Channel of `normals.exr`: how far off each normal may be, as `Scene.normal_sigma`."""

MIN_NORMAL_LENGTH = 0.1
"""Length below which a vector has no direction worth normalising."""

LENGTH_TOLERANCE = 0.25
"""Excess of a length over 1 from which on a vector is no normal. Means of unit vectors are shorter;
rounding to 8 bits adds 0.007, and a JPEG file's or a filter's ringing 0.1 and more."""

MEDIAN_TOLERANCE = 0.1
"""Median distance of lengths from 1 up to which a map holds normals: the mean of unit vectors that
scatter by θ (RMS) has a length of about 1 − θ²/2, which is 0.9 at 26 degrees."""

ROUNDING = 3**0.5 / 255
"""Change of a vector's length by rounding to 8 bits, at most."""

JUDGED_MAX = 1 << 20
"""Pixels whose lengths tell how a file is to be read: of larger maps every few."""


@dataclass(frozen=True)
class Convention:
    """How normals are written down."""

    axes: str = "opengl"
    """Either "opengl" (Y up) or "directx" (Y down)."""
    frame: str = "camera"
    """One of "camera", "world" and "tangent", that of a flat card which is parallel to the picture:
    its X and Y run along the picture's sides, and (0, 0, 1) faces the viewer."""
    world_to_camera: Array | None = None
    """(3, 3) rotation, needed when the frame is "world": n_camera = R n_world."""

    def to_camera(self, normals: Floats) -> Array:
        """(..., 3) normals of this convention in camera space."""
        return np.asarray(np.asarray(normals, np.float64) @ self._matrix().T)

    def from_camera(self, normals: Floats) -> Array:
        """(..., 3) normals of camera space in this convention: undoes `to_camera`."""
        return np.asarray(np.asarray(normals, np.float64) @ self._matrix())

    def _matrix(self) -> Array:
        """(3, 3), orthogonal: n_camera = M n."""
        turn = self.world_to_camera if self.frame == "world" else np.eye(3)
        if turn is None:
            beside = 'beside normals_frame = "world"'
            raise InputError(f"expected world_to_camera, a 3 × 3 rotation, {beside}; found none")
        return turn * [1.0, -1.0 if self.axes == "directx" else 1.0, 1.0]

    def __str__(self) -> str:
        return f"{self.axes} axes, {self.frame} space"


def find_normals(folder: Path) -> list[Path]:
    """The files with normals that a scene folder has."""
    return [path for name in NORMAL_FILES if there(path := folder / name)]


@dataclass(frozen=True, eq=False)
class StoredNormals:
    """Normals that a file holds, decoded."""

    vectors: Array
    """(H, W, 3) in the frame of the file, of any length; NaN where the file has no normal."""
    uncertainty: NDArray[np.float32] | None
    """(H, W): `UNCERTAINTY` as it is stored; None if the file has none."""
    said: tuple[str, ...]
    """What was read otherwise than the kind of file suggests, in words."""


def read_normals(path: Path, mask: Mask | None = None) -> StoredNormals:
    """Read a normal map: an EXR file, another picture, or .npy of shape (H, W, 3) or (3, H, W).

    Integers of a picture are codes, n = 2v - 1 with v from 0 to 1, and floats are components,
    unless lengths inside the `mask` (H, W) say otherwise. Two channels are x and y. A pixel has no
    normal where its vector is NaN, shorter than `MIN_NORMAL_LENGTH`, or too long, as that of black
    codes is, or its alpha is 0. Raises InputError if there are other channels, or no normals
    however they are read.
    """
    stored = read_stored(path)
    uncertainty, said, hidden = None, [], np.False_
    if isinstance(stored, dict):
        uncertainty = stored.get(UNCERTAINTY)
        expected = "normals in channels X, Y, Z or R, G, B"
        _, names = layers.chosen(path, stored, layers.NORMALS, expected)
        if "".join(names) not in ("XYZ", "RGB", "xyz"):
            said.append(f"channels {', '.join(names)}")
        values: NDArray[Any] = np.stack([stored[name] for name in names], axis=-1)
    else:
        values = stored[0] if stored.ndim == 4 and len(stored) == 1 else stored
        if values.ndim == 3 and values.shape[-1] not in (2, 3, 4) and len(values) in (2, 3):
            values = np.moveaxis(values, 0, -1)
        if values.ndim != 3 or values.shape[-1] not in (2, 3, 4):
            raise unexpected(path, "normals (H, W, 3)", f"shape {values.shape}")
        if values.shape[-1] == 4 and values[..., 3].any():
            hidden = values[..., 3] == 0
        values = values[..., :3]
    with np.errstate(all="ignore"):  # too long to have a length: no normal
        vectors, how = _decoded(path, values, mask)
        length = np.linalg.norm(vectors, axis=-1)
        long = ~(length <= 1 + LENGTH_TOLERANCE)
        none = hidden | long | (length < MIN_NORMAL_LENGTH)
    if long.any():
        from scipy.ndimage import maximum_filter

        # Between a normal and a background that is none lie mixtures of both, with other lengths.
        mixed = np.abs(length - 1) > LENGTH_TOLERANCE
        none |= mixed & maximum_filter(long & np.isfinite(length), 3)
    vectors[none] = np.nan
    return StoredNormals(vectors, uncertainty, (*said, *how))


def _decoded(path: Path, stored: NDArray[Any], mask: Mask | None) -> tuple[Array, list[str]]:
    """Vectors (H, W, 3) of what is stored, (H, W, 2 or 3), and how they were read, if otherwise.

    The reading is the one in which lengths are nearest to 1, in the median: that of the number type
    unless another halves the distance. Grey pixels, which are backgrounds, do not count.
    """
    step = math.ceil(math.sqrt(stored.shape[0] * stored.shape[1] / JUDGED_MAX))
    some = stored[::step, ::step].astype(np.float64)
    judged = np.isfinite(some).all(axis=-1)
    if mask is not None and mask.shape == stored.shape[:2]:
        judged &= mask[::step, ::step]
    some = some[judged]
    low, high = some.min(initial=0.0), some.max(initial=0.0)
    whole = stored.dtype.kind == "u"
    plain = partial(_of_codes, np.iinfo(stored.dtype).max if whole else 1, not whole)
    readings: dict[str, Callable[[NDArray[Any]], Array]] = {"": plain}
    if not whole and low >= -ROUNDING and high <= 1 + ROUNDING:
        readings["0 to 1 read as 2v − 1"] = partial(_of_codes, 1, False)
        said = "0 to 1, decoded as if colours of sRGB, encoded again and read as 2v − 1"
        readings[said] = lambda values: 2 * encode_srgb(values) - 1
    if stored.shape[-1] == 2:  # lengths tell nothing, but numbers below 0 tell components
        *_, (how, read) = [*readings.items()][:2]
        return _with_z(read(stored)), ["z = √(1 − x² − y²)", *filter(None, [how])]
    for largest in (127, 32767) if low < 0 else (255, 65535):
        if 1 + ROUNDING < max(high, -low) <= largest + 1:
            readings[f"codes up to {largest}"] = partial(_of_codes, largest, bool(low < 0))
    spans = np.ptp(some, axis=0) if len(some) else np.ones(3)
    some = some[np.ptp(some, axis=-1) > 0]
    if not len(some):
        return plain(stored), []
    flat = "z = √(1 − x² − y²), as the third channel is the same everywhere"
    if spans[2] == 0 < spans[:2].min():
        readings[flat] = lambda values: _with_z(plain(values))
    lengths = {how: np.linalg.norm(read(some), axis=-1) for how, read in readings.items()}
    off = {how: float(np.median(np.abs(of - 1))) for how, of in lengths.items()}
    best = min(off, key=lambda how: off[how])
    behind = best == flat and plain(some[0])[2] <= 0
    if off[""] <= max(2 * off[best], ROUNDING) and not behind:
        best = ""
    if off[best] > MEDIAN_TOLERANCE:
        few, many = np.percentile(lengths[""], [5, 95])
        found = f"lengths of {few:.2g} to {many:.2g} (5 to 95 % of the pixels)"
        raise unexpected(path, "normals, vectors of length 1 or codes of such", found)
    return readings[best](stored), [best] if best else []


def _of_codes(largest: int, signed: bool, values: NDArray[Any]) -> Array:
    shares: Array = values / np.float64(largest)
    return shares if signed else 2.0 * shares - 1.0


def _with_z(vectors: Array) -> Array:
    """Unit vectors that face the viewer, of their x and y; longer where there are none."""
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)


def write_normals(path: Path, normals: Floats, uncertainty: Floats | None = None) -> None:
    """Write `normals.exr`: channels X, Y, Z, and `UNCERTAINTY` if there is one.

    Normals (H, W, 3) stand in the file as they are, uncertainty (H, W) is in degrees.
    """
    channels = {name: normals[..., i] for i, name in enumerate("XYZ")}
    if uncertainty is not None:
        channels[UNCERTAINTY] = uncertainty
    images.write_exr(path, channels)
