"""Pictures that somebody else made: readers by name, and any damage is one error."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pbrfit.io.exif import without_warnings
from pbrfit.io.quoting import shown

FORMATS = ("PNG", "JPEG", "WEBP")
"""What services send, by Pillow's names; its other readers are not asked."""


def read_srgb8(data: bytes) -> NDArray[np.uint8]:
    """Pixels (H, W, 3), uint8, of the bytes of a picture file; ValueError if they are none."""
    try:
        with without_warnings(), Image.open(io.BytesIO(data), formats=FORMATS) as picture:
            return np.asarray(picture.convert("RGB"))
    except UnidentifiedImageError:
        raise ValueError(f"no {', '.join(FORMATS)}") from None
    except Exception as error:  # whatever damage leads Pillow to, such as SyntaxError
        raise ValueError(f"{type(error).__name__}: {shown(error)}") from None
