"""EXIF data of picture files."""

from __future__ import annotations

import warnings

_EXIF_IFD = 0x8769
_FOCAL_LENGTH_35MM = 0xA405


def focal_length_35mm(exif: bytes | None) -> float | None:
    """Tag FocalLengthIn35mmFilm of a block or of a TIFF file; None = unknown, as 0 is there."""
    if exif is None:
        return None
    from PIL import Image  # here: it takes longer to import than most of this package

    tags = Image.Exif()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about damaged EXIF, which is then not used
        try:
            tags.load(exif)
            value = float(tags.get_ifd(_EXIF_IFD)[_FOCAL_LENGTH_35MM])
        except Exception:  # no such tag, or whatever a damaged block leads to
            return None
    return value if 0 < value < float("inf") else None
