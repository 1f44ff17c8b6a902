"""What files hold, as part of a message: printable, in one line, and short."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable

LONGEST = 200
"""Letters of a text that are shown."""

MOST = 12
"""Names of a list that are shown."""

FORMULAS = ("=", "+", "-", "@", "\t", "\r", "'")
"""Beginnings of cells that spreadsheets calculate; and of those that are marked as text."""

# Controls, which a terminal obeys, but for line ends and tabs; letters that turn the direction of
# writing, so that a text reads as another one; what stands for bytes of names that are no UTF-8.
_UNSEEN = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"
    r"\ud800-\udfff]"
)


class _Short(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        """Python writes no numbers of thousands of digits."""
        few = abs(x) < 10**LONGEST
        return super().repr_int(x, level) if few else f"a number of {x.bit_length()} bits"


_short = _Short()
_short.maxlevel, _short.maxstring, _short.maxlong, _short.maxother = 4, 60, 40, 60


def shown(text: object) -> str:
    """Text without quotation marks, such as another library's words about a file."""
    words = str(text)
    clean = (one if one.isprintable() else repr(one)[1:-1] for one in words[:LONGEST])
    return "".join(clean) + "…" * (len(words) > LONGEST)


def visible(text: str) -> str:
    """Whole text of any length with \ufffd for what a terminal obeys or no file can hold."""
    return _UNSEEN.sub("\ufffd", text)


def quoted(value: object) -> str:
    """A value as Python writes it, cut short in the middle."""
    words = " ".join(_short.repr(value).split())
    return words if len(words) <= LONGEST else words[:LONGEST] + "…"


def cell(text: str) -> str:
    """A text as a cell of a table, with ``'`` before what a spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(FORMULAS) else text


def listed(names: Iterable[str]) -> str:
    """Names in alphabetical order, with commas."""
    every = sorted(names)
    more = [f"{len(every) - MOST} more"] if len(every) > MOST else []
    return ", ".join([*map(shown, every[:MOST]), *more])
