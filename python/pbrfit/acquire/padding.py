"""Sizes that a network takes: a picture padded or scaled to one, and read and cut exactly back.

Networks take whole blocks of pixels, and pipelines cut off or stretch what does not fit, which
moves every pixel. Here nothing is cut: a picture is padded on all sides with its own mirror image
until it is whole blocks, and the same frame is cut off from what comes back. Only where it is too
large (or too small) for the network it is scaled before, each axis by itself:

    pixel centres  (x' + 1/2) / width' = (x + 1/2) / width

in both directions, so the way there and back moves nothing, whatever the sizes round to.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pbrfit._core import InputError
from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.io.exif import without_warnings
from pbrfit.io.resampling import averaged
from pbrfit.values.arrays import Codes, Floats
from pbrfit.values.quoting import shown

FORMATS = ("PNG", "JPEG", "WEBP")
"""What services send, by Pillow's names; its other readers are not asked."""


@dataclass(frozen=True)
class Limits:
    """Sizes that a network takes, in pixels."""

    multiple: int = 16
    """Both sides are whole multiples of this."""
    least_side: int = 16
    most_side: int = 1 << 20
    """Of either side."""
    least_area: int = 1
    most_area: int = 1 << 40
    """Of both together."""
    most_aspect: float = 1e9
    """Longer over shorter side."""


FLUX2_KLEIN = Limits(multiple=16, least_side=64, most_area=1024 * 1024, most_aspect=8)
"""`diffusers.Flux2KleinPipeline` 0.42: smaller or longer is refused, larger is scaled down, and
what is no multiple of 16 is cut off, half on each side."""

GPT_IMAGE_2 = Limits(most_side=3840, least_area=655_360, most_area=2560 * 1440, most_aspect=3)
"""OpenAI's `images.edit`: multiples of 16, 1:3 to 3:1, at most 3840 × 2160, experimental above
2560 × 1440 (openai client 3.54). Of the "current pixel limits" that it leaves to the service, the
least area is as those who resell it document it."""


@dataclass(frozen=True)
class Frame:
    """How pictures of one size go to a network and come back."""

    size: tuple[int, int]
    """(height, width) of the picture."""
    scaled: tuple[int, int]
    """(height, width) that it is scaled to; mostly `size`."""
    padded: tuple[int, int]
    """(height, width) that the network gets and gives."""

    @property
    def offset(self) -> tuple[int, int]:
        """(rows above, columns to the left) that are padding."""
        return (self.padded[0] - self.scaled[0]) // 2, (self.padded[1] - self.scaled[1]) // 2

    def to_model(self, picture: Codes) -> Codes:
        """Picture (H, W, 3) of `size`, sRGB, at the size that the network takes."""
        if self.scaled != self.size:
            picture = resized_srgb8(picture, self.scaled)
        around = [
            (before, whole - inner - before)
            for before, whole, inner in zip(self.offset, self.padded, self.scaled, strict=True)
        ]
        return np.pad(picture, [*around, (0, 0)], mode="symmetric")

    def from_model(self, picture: Codes) -> Codes:
        """What came back, sRGB, at the picture's size: the inverse of `to_model`.

        Raises InputError if it is not of the size that was asked for, so that nobody knows what
        became of the pixels.
        """
        if picture.shape != (*self.padded, 3):
            raise InputError(
                f"generated picture: expected {self.padded[1]} × {self.padded[0]} pixels in 3 "
                f"channels, found an array of shape {picture.shape}"
            )
        top, left = self.offset
        inner = picture[top : top + self.scaled[0], left : left + self.scaled[1]]
        return resized_srgb8(inner, self.size) if self.scaled != self.size else inner.copy()


def frame(size: tuple[int, int], limits: Limits) -> Frame:
    """Find the largest form of a picture, up to its own size, that a network takes.

    A picture of `size` (height, width) below the least area is scaled up, one that is too long is
    padded until it is not. Raises InputError if no form of it is in the limits.
    """
    longer, shorter = max(size), min(size)
    own = _padded(longer, shorter, limits)
    candidates = range(longer, 0, -1)
    if own is not None and own[0] * own[1] < limits.least_area:
        candidates = range(longer, limits.most_side + 1)
    for side in candidates:
        other = max(1, math.floor(shorter * side / longer + 0.5))
        whole = _padded(side, other, limits)
        if whole is not None and limits.least_area <= whole[0] * whole[1] <= limits.most_area:
            turn = 1 if size[0] >= size[1] else -1
            scaled, padded = (side, other)[::turn], whole[::turn]
            return Frame(size, (scaled[0], scaled[1]), (padded[0], padded[1]))
    raise InputError(
        f"photo: expected a size that the network can be given, found {size[1]} × {size[0]} pixels"
    )


def _padded(longer: int, shorter: int, limits: Limits) -> tuple[int, int] | None:
    """Both sides up to whole blocks, long and short enough; None if one is too long."""

    def whole(side: float) -> int:
        return math.ceil(side / limits.multiple) * limits.multiple

    padded = whole(max(longer, limits.least_side))
    if padded > limits.most_side:
        return None
    return padded, whole(max(shorter, limits.least_side, padded / limits.most_aspect))


def resized_srgb8(picture: Codes, size: tuple[int, int]) -> Codes:
    """Picture (H, W, 3), sRGB, scaled in linear light to (height, width)."""
    linear = resized(decode_srgb(picture / 255.0), size)
    return np.asarray(np.rint(255 * encode_srgb(np.clip(linear, 0, 1))), dtype=np.uint8)


def resized(pixels: Floats, size: tuple[int, int]) -> NDArray[np.float32]:
    """Linear pixels (H, W, C) at (height, width), borders on borders.

    An axis that shrinks is averaged over areas; one that grows is interpolated by cubics, without
    leaving the range of the values.
    """
    height, width = pixels.shape[:2]
    smaller = min(height, size[0]), min(width, size[1])
    result = np.empty((*size, pixels.shape[-1]), dtype=np.float32)
    for k in range(pixels.shape[-1]):
        plane = pixels[..., k]
        if smaller != (height, width):
            plane = averaged(plane, smaller)
        if smaller != size:
            low, high = plane.min(), plane.max()
            grown = Image.fromarray(np.ascontiguousarray(plane, dtype=np.float32))
            plane = np.clip(
                np.asarray(grown.resize(size[::-1], Image.Resampling.BICUBIC)), low, high
            )
        result[..., k] = plane
    return result


def read_srgb8(data: bytes) -> Codes:
    """Pixels (H, W, 3), uint8, of the bytes of a picture file; ValueError if they are none."""
    try:
        with without_warnings(), Image.open(io.BytesIO(data), formats=FORMATS) as picture:
            return np.asarray(picture.convert("RGB"))
    except UnidentifiedImageError:
        raise ValueError(f"no {', '.join(FORMATS)}") from None
    except Exception as error:  # whatever damage leads Pillow to, such as SyntaxError
        raise ValueError(f"{type(error).__name__}: {shown(error)}") from None
