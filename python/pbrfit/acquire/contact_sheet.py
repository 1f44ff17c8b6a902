"""`review.png`: all pictures of a run beside the photo, and what was refused, with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.sheet import OUTSIDE, Panel, Row, sheet

COLUMNS = 5
"""Pictures side by side, so that two dozen of them are five rows."""

LONGEST = 32
"""Letters of a caption: all captions are as small as the longest one needs."""


@dataclass(frozen=True, eq=False)
class Shown:
    """One picture on the sheet.

    Attributes
    ----------
    caption
        Its name, and what tells it from others of that name.
    pixels
        (H, W, 3) uint8, sRGB; None where a refusal left none.
    reason
        Why it was refused; empty for one that was accepted.
    """

    caption: str
    pixels: NDArray[np.uint8] | None
    reason: str = ""


def contact_sheet(
    photo: NDArray[np.uint8], pictures: Sequence[Shown], *, title: str
) -> NDArray[np.uint8]:
    """The photo, then accepted pictures, then a part of its own for those that were refused.

    Parameters
    ----------
    photo
        (H, W, 3) uint8, sRGB, as all pictures are.
    pictures
        In any order; within each part it is kept.
    title
        A line above all.

    Returns
    -------
    ndarray
        (H, W, 3) uint8.
    """
    accepted = [Panel("the photo", _on_screen(photo))]
    refused = []
    for picture in pictures:
        caption = _shortened(picture.caption)
        if picture.reason:
            empty = np.full(photo.shape, OUTSIDE)
            pixels = empty if picture.pixels is None else _on_screen(picture.pixels)
            refused.append(Panel(caption, pixels, note=picture.reason, crossed=True))
        elif picture.pixels is not None:
            accepted.append(Panel(caption, _on_screen(picture.pixels)))
    columns = min(COLUMNS, max(len(accepted), len(refused)))
    parts = [sheet(_rows(accepted, columns), title=title)]
    if refused:
        parts.append(sheet(_rows(refused, columns), title=f"Refused: {len(refused)}"))
    return np.concatenate(parts)


def _rows(panels: Sequence[Panel], columns: int) -> list[Row]:
    """Full rows, so that both parts are equally wide."""
    filled = [*panels, *[None] * (-len(panels) % columns)]
    return [filled[i : i + columns] for i in range(0, len(filled), columns)]


def _shortened(caption: str) -> str:
    """Without its middle: the ends tell pictures apart, and the seed is at one of them."""
    if len(caption) <= LONGEST:
        return caption
    half = (LONGEST - 1) // 2
    return f"{caption[:half]}…{caption[-half:]}"


def _on_screen(pixels: NDArray[np.uint8]) -> NDArray[np.floating[Any]]:
    return pixels / 255.0
