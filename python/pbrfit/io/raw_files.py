"""Raw files of cameras, developed by LibRaw (the package rawpy) to linear light.

Pictures of one view must stay comparable, so nothing depends on what a picture shows: no automatic
brightness, and the sensor's white level is 65535. The white balance is the camera's, by picture.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io import exif
from pbrfit.io.color import REC709, rgb_to_xyz
from pbrfit.io.input_files import unexpected
from pbrfit.io.limits import AT_LEAST, Limits, converted
from pbrfit.values.arrays import Array, Mask
from pbrfit.values.quoting import shown

RAW_SUFFIXES = frozenset({
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".iiq", ".kdc", ".mef", ".mos",
    ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw",
    ".x3f",
})  # fmt: skip

SATURATED = 0.99
"""Share of a sensor's white level, above black, that is clipped: it is reached with some spread."""

REACH = 2
"""Pixels around a sensor's sample that its value gets to where colours are interpolated."""


def is_raw(path: Path, head: bytes, kind: str | None) -> bool:
    """Whether a file of this content (its first bytes) and format is a camera's raw file.

    Many raw files are TIFF files whose first page is a thumbnail, so there the name decides.
    """
    canon = (head[:4] == b"II*\0" and head[8:10] == b"CR") or head[4:12] == b"ftypcrx "
    return canon or (path.suffix.lower() in RAW_SUFFIXES and kind in ("TIFF", None))


def how_to_develop(path: Path) -> str:
    """What to do with a raw file elsewhere."""
    return (
        f"develop it first, for example with `darktable-cli {path.name} {path.stem}.exr`, or with "
        f"`dcraw -4 -T {path.name}` and then colour space linear"
    )


def develop(
    path: Path, data: bytes, turned: bool = True
) -> tuple[NDArray[np.uint16], Limits | None, str, exif.Exif]:
    """Develop the content of a raw file, `turned` as the camera was held.

    Returns linear Rec.709 times 65535, (H, W, 3); where clipped samples of the sensor bound it, or
    None; a sentence on its colour; and how it was taken. InputError without rawpy, or of LibRaw.
    """
    with _opened(path, data) as (rawpy, raw):
        orientation = {3: 3, 5: 8, 6: 6}.get(int(raw.sizes.flip), 1)  # by dcraw's flip
        samples: NDArray[np.uint16] = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,  # else the white level is what a picture's brightest pixel has
            use_camera_wb=True,
            output_bps=16,
            output_color=rawpy.ColorSpace.sRGB,
            **({} if turned else {"user_flip": 0}),
        )
        if samples.shape[2:] != (3,):
            raise unexpected(path, "three channels of 16 bits", samples.shape)
        clipped, limits = exif.turned(_clipped(raw), orientation if turned else 1), None
        if clipped.shape == samples.shape and clipped.any():
            limits = converted(np.where(clipped, AT_LEAST, 0).astype(np.uint8), _matrix(raw))
        red, green, blue = raw.camera_whitebalance[:3]
        # Some makers of files built like TIFF have other first bytes.
        start = {b"II": b"II*\0", b"MM": b"MM\0*"}.get(data[:2], data[:4])
        taken = exif.read(start + data[4:], orientation)
        if taken.focal_length_35mm is None:
            thumb = b""  # the JPEG that many raw files hold for a quick look
            with suppress(Exception):  # there is none, or of a form that rawpy does not know
                thumb = bytes(raw.extract_thumb().data[: 1 << 17])
            found = re.search(rb"Exif\0\0(II\*\0|MM\0\*).*", thumb, re.DOTALL)
            of_thumb = exif.read(found and found[0], orientation)
            taken = of_thumb if len(of_thumb.settings) > 1 else taken  # beside the orientation
    balance = "camera white balance"
    if green > 0:
        balance += f" {red / green:.3g}, 1, {blue / green:.3g}"
    color = f"linear Rec.709, {balance} (raw file, LibRaw)"
    return np.ascontiguousarray(samples), limits, color, taken


@contextmanager
def _opened(path: Path, data: bytes) -> Iterator[tuple[Any, Any]]:
    """Give rawpy, and the file as it reads it."""
    try:
        import rawpy  # here: an extra package
    except ImportError:
        found = f"a raw file without it: pip install 'pbrfit[raw]', or {how_to_develop(path)}"
        raise unexpected(path, "rawpy, which reads raw files", found) from None
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            yield rawpy, raw
    except rawpy.LibRawError as error:
        words = (error.args or [error])[0]
        said = shown(words.decode("utf-8", "replace") if isinstance(words, bytes) else words)
        raise unexpected(path, "a raw file that LibRaw reads", said) from None


def _clipped(raw: Any) -> Mask:
    """(H, W, 3): where a sensor's sample of a channel was clipped, before it is turned."""
    from scipy.ndimage import maximum_filter

    sensor = raw.raw_image_visible
    white = np.array(raw.camera_white_level_per_channel or [raw.white_level] * 4, np.float64)
    white[white <= 0] = raw.white_level
    black = np.array(raw.black_level_per_channel, np.float64)
    limit = black + SATURATED * (white - black)
    if sensor.ndim == 3:  # every channel at every pixel
        return np.asarray(sensor[..., :3] >= limit[:3])
    colors = raw.raw_colors_visible
    over = sensor >= limit[np.minimum(colors, 3)]
    channels = np.where(colors == 3, 1, colors)  # the second green
    planes = [maximum_filter(over & (channels == c), 2 * REACH + 1) for c in range(3)]
    return np.stack(planes, axis=-1)


def _matrix(raw: Any) -> Array | None:
    """(3, 3) from the camera's balanced channels to linear Rec.709; rows sum to 1.

    LibRaw has it, or it follows from that from XYZ, scaled so that white has equal ones; or None.
    """
    matrix = np.asarray(raw.color_matrix, np.float64)[:, :3]
    if not np.allclose(matrix.sum(axis=1), 1.0, atol=1e-2):
        to_camera = np.asarray(raw.rgb_xyz_matrix, np.float64)[:3] @ rgb_to_xyz(REC709)
        sums = to_camera.sum(axis=1)
        if not (sums > 0).all() or np.linalg.cond(to_camera) > 1e6:
            return None
        matrix = np.linalg.inv(to_camera / sums[:, None])
    return matrix
