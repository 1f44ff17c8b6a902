"""Pictures that somebody else made: readers by name, bounded, and any damage is one error."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pbrfit.io.quoting import shown

FORMATS = ("PNG", "JPEG", "WEBP")
"""What services send, by Pillow's names; its other readers are not asked."""

MOST_PIXELS = 2**25
"""Pixels of a picture that is decoded: four times the largest that a service makes."""


@contextmanager
def opened(data: bytes, formats: tuple[str, ...] = FORMATS) -> Iterator[Image.Image]:
    """Open the bytes of a picture file.

    Raises ValueError, in words, if they are of no such format or of more than `MOST_PIXELS`, or if
    anything fails while the picture is open.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about what is an error here
            with Image.open(io.BytesIO(data), formats=formats) as picture:
                if picture.width * picture.height > MOST_PIXELS:
                    raise ValueError(f"{picture.width} × {picture.height} pixels")
                yield picture
    except UnidentifiedImageError:
        raise ValueError(f"no {' or '.join(', '.join(formats).rsplit(', ', 1))}") from None
    except Exception as error:  # whatever damage leads Pillow to, such as SyntaxError
        raise ValueError(f"{type(error).__name__}: {shown(error)}") from None


def read_srgb8(data: bytes, formats: tuple[str, ...] = FORMATS) -> NDArray[np.uint8]:
    """Pixels (H, W, 3), uint8, of the bytes of a picture file; raises as `opened` does."""
    with opened(data, formats) as picture:
        return np.asarray(picture.convert("RGB"))
