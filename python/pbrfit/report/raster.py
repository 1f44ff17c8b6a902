"""Pictures inside a page: reduced to a size, and encoded as small PNG."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from pbrfit.display.tone import codes
from pbrfit.io.resampling import averaged, averaged_channels, averaged_where, reduced_size
from pbrfit.result.differences import OUTSIDE, PALETTE, Difference
from pbrfit.values.arrays import Array, Floats, Mask

SMALL = 1 << 13
"""Pixels up to which the slowest and strongest compression is worth its time."""

LOSSLESS_SIDE = 256
"""Longer side of a photograph up to which it is a PNG, whose pixels may be looked at."""

QUALITY = 90
"""Of photographs in JPEG and WebP, at which a block's border is not seen."""


def reduced(values: Floats, side: int) -> Array:
    """Average (H, W) or (H, W, C) down; NaN where most of what is averaged is NaN."""
    size = reduced_size(values.shape, side)
    if size == values.shape[:2]:
        return np.asarray(values, dtype=np.float64)
    planes = values.reshape(*values.shape[:2], -1)
    inside = np.isfinite(planes[..., 0])
    if inside.all():
        return averaged_channels(planes, size).reshape(*size, *values.shape[2:])
    found, share = averaged_where(values, inside, size)
    found[share < 0.5] = np.nan
    return found


def reduced_difference(difference: Difference, side: int) -> Difference:
    """Average a map of differences down; a mark stays where most pixels have it."""
    size = reduced_size(difference.values.shape, side)
    if size == difference.values.shape:
        return difference
    values = np.array(difference.values, dtype=np.float64)
    marked = np.zeros(values.shape, bool)
    small: list[Mask | None] = []
    for mark in (difference.white, difference.vermillion):
        small.append(None if mark is None else averaged(mark, size) >= 0.5)
        marked |= False if mark is None else mark
    outside = averaged(np.isnan(values), size) > 0.5
    # What is marked has a colour of its own and is no number to be averaged with others.
    found, _ = averaged_where(values, np.isfinite(values) & ~marked, size)
    found[outside] = np.nan
    return Difference(found, *small)


def picture_png(encoded: Floats) -> bytes:
    """(H, W) or (H, W, 3) as it goes to the screen; transparent where it is NaN."""
    return _png(_shown(encoded))


def _shown(encoded: Floats) -> Image.Image:
    found = codes(encoded)
    return Image.fromarray(found[..., 0] if found.shape[-1] == 1 else found)


def photograph(encoded: Floats, kind: str = "WEBP", **options: int) -> bytes:
    """As `picture_png`; large ones as WebP: a tenth of the bytes in a fifth of the time.

    Or as another kind of Pillow's, with its options.
    """
    if max(encoded.shape) <= LOSSLESS_SIDE:
        return picture_png(encoded)
    buffer = io.BytesIO()
    _shown(encoded).save(buffer, kind, quality=QUALITY, **(options or {"method": 0}))
    return buffer.getvalue()


def difference_png(difference: Difference) -> bytes:
    """Encode a map of differences with its palette, transparent outside the mask."""
    image = Image.fromarray(difference.indices(), mode="P")
    image.putpalette(np.rint(255 * PALETTE).astype(np.uint8).tobytes())
    if np.isnan(difference.values).any():
        image.info["transparency"] = OUTSIDE
    return _png(image)


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    small = image.width * image.height <= SMALL
    image.save(buffer, "PNG", optimize=small, compress_level=4)  # half the time of 6, 4 % more
    return buffer.getvalue()
