"""Sheets: labelled pictures in a grid, and the key to their colours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pbrfit.display.tone import encoded
from pbrfit.result.verdict import Mark
from pbrfit.values.arrays import Codes, Floats

PANEL_SIDE = (192, 384)
"""Smallest and largest longer side of a panel in pixels."""

MARGIN = 12
PAPER = (255, 255, 255)
INK = (30, 30, 30)
OUTSIDE = 0.85
"""Grey of pixels outside the mask."""

FONT = (15, 24)
"""Smallest and largest size of the letters, which grow with the panels."""

BAR = (320, 18)
"""Width and height of a bar of colours in pixels, for the smallest letters."""

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


@dataclass(frozen=True)
class Panel:
    """One labelled picture: (H, W, 3) values in [0, 1] as they go to the screen."""

    caption: str
    """A line above it."""
    pixels: Floats
    note: str = ""
    """Below it, in as many lines as it needs."""
    mark: Mark | None = None
    """Before the note."""


@dataclass(frozen=True)
class Key:
    """What colours mean: a bar from the left, ticks at shares of its width, and patches."""

    caption: str
    """What the bar measures."""
    bar: Floats
    """(M, 3) colours, the lowest value first, as they go to the screen."""
    ticks: Mapping[float, str]
    """Labels by share of the bar's width."""
    patches: Mapping[str, Floats] = field(default_factory=dict)
    """Colours by label, for what is not on the bar."""


Row = list[Panel | None]
"""Side by side; None leaves a gap."""


def sheet(
    rows: Sequence[Row],
    *,
    title: str = "",
    labels: Sequence[str] = (),
    keys: Sequence[Key] = (),
) -> Codes:
    """Panels in a grid, captions above: (H, W, 3) uint8.

    All pictures are of one size. A row without any caption has no room for one; labels stand at the
    left of the rows, keys at the bottom, one below the other.
    """
    first = next(panel for row in rows for panel in row if panel is not None)
    height, width = first.pixels.shape[:2]
    longer = max(height, width)
    low, high = PANEL_SIDE
    factor = -(-low // longer) if longer < low else min(1.0, high / longer)
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    column = max(size[0], low)
    captions = [panel.caption for row in rows for panel in row if panel is not None]
    letters = min(max(column // 13, FONT[0]), FONT[1])  # still readable when a sheet shrinks
    font = _font(captions, column, letters)
    label_font = ImageFont.load_default(letters)
    line = round(1.6 * letters)
    gutter = max((round(label_font.getlength(label)) + MARGIN for label in labels), default=0)
    note_font = ImageFont.load_default(round(0.8 * letters))
    note_line = round(1.1 * letters)
    notes = [[_wrapped(panel, column, note_font, note_line) for panel in row] for row in rows]
    of_captions = [line * any(panel and panel.caption for panel in row) for row in rows]
    heights = [
        above + size[1] + MARGIN + note_line * max(map(len, below))
        for above, below in zip(of_captions, notes, strict=True)
    ]
    columns = max(len(row) for row in rows)
    top = MARGIN + (round(1.5 * line) if title else 0)
    whole = gutter + columns * (column + MARGIN) + MARGIN
    below = round(4.6 * letters) + MARGIN  # caption, bar and ticks of a key
    canvas = Image.new("RGB", (whole, top + sum(heights) + below * len(keys)), color=PAPER)
    draw = ImageDraw.Draw(canvas)
    if title:
        large = _font([title], whole - 2 * MARGIN, round(1.25 * letters))
        draw.text((MARGIN, MARGIN), title, fill=INK, font=large)
    y = top
    for i, row in enumerate(rows):
        below_caption = y + of_captions[i]
        if i < len(labels):
            middle = below_caption + size[1] // 2
            draw.text((MARGIN, middle), labels[i], fill=INK, font=label_font, anchor="lm")
        for j, panel in enumerate(row):
            if panel is None:
                continue
            x = MARGIN + gutter + j * (column + MARGIN)
            draw.text((x, y), panel.caption, fill=INK, font=font)
            pixels = (255 * np.clip(panel.pixels, 0, 1) + 0.5).astype(np.uint8)
            # Whole factors repeat pixels; smaller ones average them.
            scaling = Image.Resampling.NEAREST if factor >= 1 else Image.Resampling.BOX
            canvas.paste(Image.fromarray(pixels).resize(size, scaling), (x, below_caption))
            note_top = below_caption + size[1] + 4
            if panel.mark is not None:
                _disc(draw, panel.mark, (x, note_top + round(0.05 * letters)), round(0.8 * letters))
                x += note_line
            for k, text in enumerate(notes[i][j]):
                at = (x, note_top + k * note_line)
                draw.text(at, text, fill=INK, font=note_font)
        y += heights[i]
    for i, key in enumerate(keys):
        _draw_key(draw, key, (MARGIN + gutter, y + i * below), letters)
    return np.asarray(canvas)


def _wrapped(panel: Panel | None, width: int, font: Font, indent: int) -> list[str]:
    """The lines of a panel's note, indented by its mark; a word longer than a line is cut."""
    lines: list[str] = []
    if panel is not None and panel.mark is not None:
        width -= indent
    for word in panel.note.split() if panel is not None else ():
        if lines and font.getlength(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
            continue
        while font.getlength(word) > width:
            fits = next(n for n in range(len(word), 0, -1) if font.getlength(word[:n]) <= width)
            lines.append(word[:fits])
            word = word[fits:]
        lines.append(word)
    return lines


def _disc(draw: ImageDraw.ImageDraw, mark: Mark, corner: tuple[int, int], side: int) -> None:
    """Draw a mark: a ring, filled from the left."""
    (left, top), color = corner, _ink(mark.color)
    for x in range(round(mark.filled * side)):
        half = math.sqrt((side / 2) ** 2 - (x + 0.5 - side / 2) ** 2)
        draw.line([(left + x, top + side / 2 - half), (left + x, top + side / 2 + half)], color)
    draw.ellipse((left, top, left + side - 1, top + side - 1), outline=color, width=side // 10)


def _draw_key(draw: ImageDraw.ImageDraw, key: Key, corner: tuple[int, int], letters: int) -> None:
    """Caption above a bar with ticks below it; patches to the right."""
    font = ImageFont.load_default(letters)
    left, top = corner[0], corner[1] + round(1.5 * letters)
    width, height = (side * letters // FONT[0] for side in BAR)
    draw.text(corner, key.caption, fill=INK, font=font)
    for i in range(width):
        color = _ink(key.bar[round(i / (width - 1) * (len(key.bar) - 1))])
        draw.line([(left + i, top), (left + i, top + height - 1)], fill=color)
    for share, label in key.ticks.items():
        x = left + round(share * (width - 1))
        draw.line([(x, top + height), (x, top + height + 4)], fill=INK)
        # The first label starts with the bar, so that it does not stick out.
        anchor = "la" if share == 0 else "ma"
        draw.text((x, top + height + 5), label, fill=INK, font=font, anchor=anchor)
    x = left + width + 3 * MARGIN
    for label, patch in key.patches.items():
        draw.rectangle((x, top, x + height, top + height - 1), fill=_ink(patch), outline=INK)
        x += height + 6
        draw.text((x, top + height // 2), label, fill=INK, font=font, anchor="lm")
        x += round(font.getlength(label)) + 2 * MARGIN


def _ink(color: Floats | tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (int(255 * float(part) + 0.5) for part in color)
    return red, green, blue


def displayed(linear: Floats, white: float = 1.0) -> Floats:
    """Linear radiance (H, W, 3) as it goes to the screen; NaN becomes grey."""
    return outside_grey(encoded(linear / white))


def outside_grey(values: Floats) -> Floats:
    """Values (H, W) or (H, W, 3) as (H, W, 3), grey where they are NaN."""
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=-1)
    return np.where(np.isfinite(values), values, OUTSIDE)


def _font(texts: Sequence[str], width: int, largest: int) -> Font:
    """Find the largest built-in font, from `largest` down, in which all texts fit."""
    for size in range(largest, 8, -1):
        font = ImageFont.load_default(size)
        if all(font.getlength(text) <= width for text in texts):
            return font
    return ImageFont.load_default(8)
