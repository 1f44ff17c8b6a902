"""How large pictures may be, so that a page stays one that can be sent by mail."""

from __future__ import annotations

from collections.abc import Callable, Sequence

LIMIT = 20_000_000
"""Bytes that a page has at most."""

VIEW_SHARE = 0.6
"""Share of the limit that the view may take; the rest of the page has what it leaves."""

FILM_SHARE = 0.15
"""Share of the limit that pictures to compare with may take; they are a part of the view."""

VIEW_SIDES = (4096, 3072, 2560, 2048, 1792, 1536, 1280, 1024, 896, 768, 640, 512, 384, 256, 128)
"""Longer sides that the maps of the view may have, in pixels."""

SIDES = (384, 256, 192, 128)
"""Longer sides of maps, and of pictures beside their reconstructions."""

Choice = tuple[int, int]
"""A longer side in pixels, and how many pictures have it."""


def choices(longer: int, sides: Sequence[int], pictures: int = 1) -> list[Choice]:
    """Sides that make sense for so many pictures, their own where it is smaller than the largest.

    Then, at the smallest, half as many pictures, and so on to none.
    """
    first = min(longer, sides[0])
    found = [(first, pictures), *((side, pictures) for side in sides[1:] if side < first)]
    while found[-1][1] > 0:
        found.append((found[-1][0], found[-1][1] // 2))
    return found


def largest_that_fits(
    make: Callable[[Choice], str], choices: Sequence[Choice], limit: float
) -> tuple[str, Choice]:
    """Make text by the first of falling choices at which it has at most `limit` bytes, or the last.

    Bytes grow about as the area of the pictures, so few are tried.
    """
    choice, *left = choices
    while True:
        made = make(choice)
        taken = len(made.encode("utf-8", "replace"))
        if taken <= limit or not left:
            return made, choice
        expected = _area(choice) * limit / taken
        choice, *left = [one for one in left if _area(one) <= expected] or left[-1:]


def _area(choice: Choice) -> int:
    side, pictures = choice
    return side * side * pictures
