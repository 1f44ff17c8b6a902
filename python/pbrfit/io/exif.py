"""EXIF data of picture files (EXIF 2.32)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from pbrfit.io.quoting import shown

_EXIF_IFD, _INTEROPERABILITY_IFD = 0x8769, 0xA005
_MAKE, _MODEL = 0x010F, 0x0110
_EXPOSURE_TIME, _F_NUMBER, _SENSITIVITY = 0x829A, 0x829D, 0x8827
_FOCAL_LENGTH, _FOCAL_LENGTH_35MM = 0x920A, 0xA405
_COLOR_SPACE, _UNCALIBRATED = 0xA001, 65535


@dataclass(frozen=True)
class Exif:
    """What a file says of how it was taken."""

    focal_length_35mm: float | None = None
    """Millimetres; None = unknown."""
    color_space: str | None = None
    """ "adobe-rgb", or "uncalibrated" (neither that nor sRGB); None = sRGB, or nothing is said."""
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

    tags = Image.Exif()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about damaged EXIF
        try:
            tags.load(exif)
            more = tags.get_ifd(_EXIF_IFD)
            index = str(tags.get_ifd(_INTEROPERABILITY_IFD).get(1, ""))
        except Exception:  # whatever a damaged block leads to
            return unknown

    def number(tag: int) -> float | None:
        try:
            value = float(more[tag])
        except (KeyError, TypeError, ValueError, ArithmeticError):
            return None
        return value if 0 < value < float("inf") else None

    equivalent = number(_FOCAL_LENGTH_35MM)
    length = number(_FOCAL_LENGTH) or equivalent
    forms = {_EXPOSURE_TIME: "{:.3g} s", _F_NUMBER: "f/{:g}", _SENSITIVITY: "ISO {:g}"}
    exposure = [form.format(value) for tag, form in forms.items() if (value := number(tag))]
    settings = {
        "camera": " ".join(shown(tags[i]).strip("\0 ") for i in (_MAKE, _MODEL) if i in tags),
        "focal length": f"{length:g} mm" if length else "",
        "exposure": " ".join(exposure),
        **unknown.settings,
    }
    stated = number(_COLOR_SPACE)
    color_space = "uncalibrated" if stated == _UNCALIBRATED else None
    # 2 is not of the standard: some cameras write it. R03 is the DCF's option file, Adobe RGB.
    if stated == 2 or (stated == _UNCALIBRATED and index.startswith("R03")):
        color_space = "adobe-rgb"
    return Exif(equivalent, color_space, {what: said for what, said in settings.items() if said})


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
