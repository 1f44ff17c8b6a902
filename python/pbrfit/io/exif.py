"""EXIF data of picture files (EXIF 2.32)."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.values.quoting import shown

_ALONE = threading.Lock()


@dataclass(frozen=True)
class Exif:
    """What a file says of how it was taken."""

    focal_length_35mm: float | None = None
    """Millimetres; None = unknown."""
    color_space: str | None = None
    """ "adobe-rgb", or "uncalibrated" (neither that nor sRGB); None = sRGB, or nothing is said."""
    premultiplied: bool = False
    """Whether colours of a TIFF file are multiplied by its alpha."""
    settings: Mapping[str, str] = field(default_factory=dict)
    """Camera, focal length, exposure, orientation and colour profile in words, where known."""


def read(exif: bytes | None, orientation: int) -> Exif:
    """Read a block that begins with a TIFF header, or a TIFF file; what is damaged is not used.

    The orientation is the one that the reader of the format found.
    """
    unknown = Exif(settings={"orientation": str(orientation)})
    if exif is None:
        return unknown
    from PIL import Image  # here: it takes longer to import than most of this package
    from PIL.ExifTags import IFD
    from PIL.ExifTags import Base as Tag

    tags = Image.Exif()
    try:
        with without_warnings():  # about damaged EXIF
            tags.load(exif)
            more = tags.get_ifd(IFD.Exif)
            index = str(tags.get_ifd(IFD.Interop).get(1, ""))
    except Exception:  # whatever a damaged block leads to
        return unknown

    def number(tag: int, least: float = 1e-9, most: float = float("inf")) -> float | None:
        try:
            value = float(more[tag])
        except (KeyError, TypeError, ValueError, ArithmeticError):
            return None
        return value if least <= value < most else None

    equivalent = number(Tag.FocalLengthIn35mmFilm, 1, 2**16)  # a SHORT
    length = number(Tag.FocalLength) or equivalent
    forms = {Tag.ExposureTime: "{:.3g} s", Tag.FNumber: "f/{:g}", Tag.ISOSpeedRatings: "ISO {:g}"}
    exposure = [form.format(value) for tag, form in forms.items() if (value := number(tag))]
    settings = {
        "camera": " ".join(shown(tags[i]).strip("\0 ") for i in (Tag.Make, Tag.Model) if i in tags),
        "focal length": f"{length:g} mm" if length else "",
        "exposure": " ".join(exposure),
        **unknown.settings,
    }
    stated = number(Tag.ColorSpace)
    color_space = "uncalibrated" if stated == 65535 else None
    # 2 is not of the standard: some cameras write it. R03 is the DCF's option file, Adobe RGB.
    if stated == 2 or (color_space and index.startswith("R03")):
        color_space = "adobe-rgb"
    premultiplied = tags.get(Tag.ExtraSamples) in (1, (1,))
    known = {what: said for what, said in settings.items() if said}
    return Exif(equivalent, color_space, premultiplied, known)


@contextmanager
def without_warnings() -> Iterator[None]:
    """Ignore warnings, in one thread at a time: Python keeps what it ignores for all of them."""
    with _ALONE, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def as_stored(
    size: tuple[int, ...], orientation: int, used: tuple[slice, slice]
) -> tuple[slice, slice]:
    """Rows and columns of samples of a size (H, W) that are those `used` once they are `turned`."""

    def part(places: NDArray[np.intp]) -> slice:
        seen = turned(np.broadcast_to(places, size), orientation)[used]
        first, last = sorted((int(seen[0, 0]), int(seen[-1, -1])))
        return slice(first, last + 1)

    return part(np.arange(size[0])[:, None]), part(np.arange(size[1]))


def turned(samples: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Turn samples (H, W, ...) to how they are to be seen: EXIF 2.32, table 6 (tag Orientation)."""
    if orientation >= 5:
        samples = samples.swapaxes(0, 1)
    # After the swap 5 is done, 6 lacks a left-right flip, 7 both flips, 8 an up-down flip.
    if orientation in (2, 3, 6, 7):
        samples = samples[:, ::-1]
    if orientation in (3, 4, 7, 8):
        samples = samples[::-1]
    return samples
