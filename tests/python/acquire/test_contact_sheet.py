"""The contact sheet of a run: what is on it, and where."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire import generation_report
from pbrfit.result.sheet import MARGIN, Panel

Pixels = NDArray[np.uint8]

GREY = np.full((128, 192, 3), 128, dtype=np.uint8)


def shown(caption: str, pixels: Pixels, reason: str = "") -> Panel:
    return Panel(caption, pixels / 255.0, note=reason)


def contact_sheet(photo: Pixels, pictures: list[Panel], *, title: str = "") -> Pixels:
    return generation_report.contact_sheet(photo / 255.0, pictures, title=title)


def plain(*color: int) -> Pixels:
    return np.full((128, 192, 3), color, dtype=np.uint8)


def rows_of(sheet: Pixels, *color: int) -> Pixels:
    """Numbers of the rows that hold a colour."""
    return np.flatnonzero((sheet == color).all(axis=-1).any(axis=-1)).astype(np.uint16)


def test_refused_pictures_come_last() -> None:
    accepted = [shown("accepted", plain(0, 255, 255))]
    refused = shown("refused", plain(255, 0, 255), "moved")
    sheet = contact_sheet(GREY, [refused, *accepted], title="all")
    picture = rows_of(sheet, 255, 0, 255)
    assert rows_of(sheet, 128, 128, 128).min() < picture.min()
    assert rows_of(sheet, 0, 255, 255).max() < picture.min()


def test_a_long_reason_is_wrapped_and_stays_in_its_column() -> None:
    reason = "edges do not lie where the photograph has them, " * 4 + "x" * 300
    pictures = [shown("a", GREY), shown("b", GREY, reason), shown("c", GREY)]
    sheet = contact_sheet(GREY, pictures)
    short = contact_sheet(GREY, [*pictures[:1], shown("b", GREY, "moved"), pictures[2]])
    assert len(sheet) > len(short) + 100
    assert sheet.shape[1] == short.shape[1]
    # The panel is 192 pixels wide, and so is its column.
    below = rows_of(sheet, 128, 128, 128).max() + 1
    written = np.flatnonzero((sheet[below:] < 128).any(axis=(0, 2)))
    assert written.min() >= MARGIN
    assert written.max() < MARGIN + 192
