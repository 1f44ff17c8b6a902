"""Sheets: labelled pictures in a grid, and the keys to their colours."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pbrfit import metrics

PANEL_SIDE = (192, 384)
"""Smallest and largest longer side of a panel in pixels."""

MARGIN = 12
CAPTION = 24
PAPER = (255, 255, 255)
INK = (30, 30, 30)
OUTSIDE = 0.85
"""Grey of pixels outside the mask."""

BAR = 20
"""Width of a bar of colours, in pixels."""


@dataclass(frozen=True)
class Panel:
    """One labelled picture: (H, W, 3) values in [0, 1] as they go to the screen."""

    caption: str
    pixels: NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Key:
    """What colours mean: a bar from the bottom up, ticks at shares of its height, and patches.

    Attributes
    ----------
    caption
        What the bar measures.
    bar
        (M, 3) colours, the lowest value first, as they go to the screen.
    ticks
        Labels by share of the bar's height.
    patches
        Colours by label, for what is not on the bar.
    """

    caption: str
    bar: NDArray[np.floating[Any]]
    ticks: Mapping[float, str]
    patches: Mapping[str, tuple[float, float, float]]


Row = list[Panel | Key | None]
"""Side by side; None leaves a gap."""


def sheet(rows: list[Row]) -> NDArray[np.uint8]:
    """Panels in a grid, captions above: (H, W, 3) uint8."""
    first = next(panel for row in rows for panel in row if isinstance(panel, Panel))
    height, width = first.pixels.shape[:2]
    longer = max(height, width)
    low, high = PANEL_SIDE
    factor = -(-low // longer) if longer < low else min(1.0, high / longer)
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    step = (max(size[0], low) + MARGIN, size[1] + CAPTION + MARGIN)
    columns = max(len(row) for row in rows)
    canvas = Image.new(
        "RGB", (columns * step[0] + MARGIN, len(rows) * step[1] + MARGIN), color=PAPER
    )
    draw = ImageDraw.Draw(canvas)
    captions = [panel.caption for row in rows for panel in row if panel is not None]
    font = _font(captions, step[0] - MARGIN)
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            if panel is None:
                continue
            x, y = MARGIN + j * step[0], MARGIN + i * step[1]
            draw.text((x, y), panel.caption, fill=INK, font=font)
            if isinstance(panel, Key):
                _draw_key(draw, panel, (x, y + CAPTION), size[1], font)
                continue
            pixels = (255 * np.clip(panel.pixels, 0, 1) + 0.5).astype(np.uint8)
            # Whole factors repeat pixels; smaller ones average them.
            scaling = Image.Resampling.NEAREST if factor >= 1 else Image.Resampling.BOX
            canvas.paste(Image.fromarray(pixels).resize(size, scaling), (x, y + CAPTION))
    return np.asarray(canvas)


def as_png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode a sheet."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _draw_key(
    draw: ImageDraw.ImageDraw,
    key: Key,
    corner: tuple[int, int],
    height: int,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
) -> None:
    """Bar, ticks and patches, from the corner at the upper left down over `height`."""
    left, top = corner[0], corner[1] + CAPTION // 3  # half a tick's label stands above the bar
    patch_top = corner[1] + height - len(key.patches) * CAPTION
    bar_height = patch_top - CAPTION - top
    for i in range(bar_height):
        color = key.bar[round((1 - i / max(1, bar_height - 1)) * (len(key.bar) - 1))]
        draw.line([(left, top + i), (left + BAR - 1, top + i)], fill=_ink(color))
    for share, label in key.ticks.items():
        y = top + round((1 - share) * (bar_height - 1))
        draw.line([(left + BAR, y), (left + BAR + 4, y)], fill=INK)
        draw.text((left + BAR + 8, y), label, fill=INK, font=font, anchor="lm")
    for i, (label, patch) in enumerate(key.patches.items()):
        y = patch_top + i * CAPTION
        box = (left, y, left + BAR - 1, y + BAR - 1)
        draw.rectangle(box, fill=_ink(patch), outline=INK)
        draw.text((left + BAR + 8, y + BAR // 2), label, fill=INK, font=font, anchor="lm")


def _ink(color: NDArray[np.floating[Any]] | tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (int(255 * float(part) + 0.5) for part in color)
    return red, green, blue


def displayed(linear: NDArray[np.floating[Any]], white: float = 1.0) -> NDArray[np.floating[Any]]:
    """Linear radiance (H, W, 3) as it goes to the screen; NaN becomes grey."""
    return outside_grey(metrics.display(linear, white))


def outside_grey(values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Values (H, W) or (H, W, 3) as (H, W, 3), grey where they are NaN."""
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=-1)
    return np.where(np.isfinite(values), values, OUTSIDE)


def _font(captions: list[str], width: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Find the largest built-in font, from 15 points down, in which all captions fit."""
    for size in range(15, 8, -1):
        font = ImageFont.load_default(size)
        if all(font.getlength(caption) <= width for caption in captions):
            return font
    return ImageFont.load_default(8)
