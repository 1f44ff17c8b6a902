"""Pictures of results on a dark ground with captions, as the gallery and README.md show them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pbrfit import Result
from pbrfit.display.tone import encoded
from pbrfit.result import metrics

GROUND = (27, 29, 32)
INK = (200, 197, 191)
GAP = 12
CAPTION = 30
"""Height of the line below a panel."""

Pixels = NDArray[np.floating[Any]]
Captioned = tuple[str, Image.Image]


def box_of(mask: NDArray[np.bool_], border: int = 6) -> tuple[slice, slice]:
    """Rows and columns that the mask fills, with a border."""
    spans = []
    for axis in (1, 0):
        at = np.flatnonzero(mask.any(axis=axis))
        spans.append(slice(max(0, at[0] - border), at[-1] + 1 + border))
    return spans[0], spans[1]


def shown(values: Pixels, mask: NDArray[np.bool_], *, height: int) -> Image.Image:
    """Values in [0, 1] as they go to the screen, (H, W) or (H, W, 3), cut to the mask."""
    rgb = np.broadcast_to(values[..., None] if values.ndim == 2 else values, (*mask.shape, 3))
    codes = np.where(mask[..., None], np.nan_to_num(rgb).clip(0, 1) * 255, GROUND)
    picture = Image.fromarray(np.round(codes[box_of(mask)]).astype(np.uint8))
    width = round(picture.width * height / picture.height)
    return picture.resize((width, height), Image.Resampling.LANCZOS)


def radiance(linear: Pixels, white: float) -> Pixels:
    """Linear radiance as it goes to the screen; `white` is nearly white there, and none clips."""
    return encoded(0.8 * np.nan_to_num(linear) / white, tone_map="neutral")


def maps_of(result: Result, *, height: int) -> list[Captioned]:
    """Albedo, roughness, metallic, normals."""
    maps = {
        "albedo": encoded(np.nan_to_num(result.albedo)),
        "roughness": result.roughness,
        "metallic": result.metallic,
        "normals": result.normals / 2 + 0.5,
    }
    return [(name, shown(values, result.mask, height=height)) for name, values in maps.items()]


def white_of(picture: Pixels) -> float:
    """Radiance that is to be shown as white."""
    return metrics.white_of(picture)


def card(rows: Sequence[Sequence[Captioned]]) -> Image.Image:
    """Rows of panels of one size, captions below."""
    wide, high = rows[0][0][1].size
    line = high + CAPTION + GAP
    width = max(map(len, rows)) * (wide + GAP) + GAP
    canvas = Image.new("RGB", (width, len(rows) * line), GROUND)
    for y, row in enumerate(rows):
        for x, (caption, picture) in enumerate(row):
            left, top = GAP + x * (wide + GAP), GAP + y * line
            canvas.paste(picture, (left, top))
            write(canvas, caption, (left + wide / 2, top + high + CAPTION / 2))
    return canvas


def write(canvas: Image.Image, text: str, middle: tuple[float, float], size: int = 15) -> None:
    """A caption about a point."""
    font = ImageFont.load_default(size)
    ImageDraw.Draw(canvas).text(middle, text, fill=INK, font=font, anchor="mm")


def save(picture: Image.Image, path: Path) -> None:
    """As WebP, with the folder it needs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.save(path, quality=85, method=6)
