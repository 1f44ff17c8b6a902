"""What files hold, as part of a message: printable, in one line, and short."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable

LONGEST = 200
"""Letters of a text that are shown."""

MOST = 12
"""Names of a list that are shown."""

TURNING = (0x61C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
"""Letters that turn the direction of writing, so that a text reads as another one."""

CONTROLS = (*range(9), *range(11, 13), *range(14, 32), *range(0x7F, 0xA0))
"""Letters that a terminal obeys, but for line ends and tabs."""

_UNSEEN = re.compile(f"[{re.escape(''.join(map(chr, (*TURNING, *CONTROLS))))}]")
_short = reprlib.Repr()
_short.maxlevel, _short.maxstring, _short.maxlong, _short.maxother = 4, 60, 40, 60


def shown(text: object) -> str:
    """Text without quotation marks, such as another library's words about a file."""
    words = str(text)
    clean = "".join(
        letter if letter.isprintable() else repr(letter)[1:-1] for letter in words[:LONGEST]
    )
    return clean + "…" * (len(words) > LONGEST)


def visible(text: str) -> str:
    """Whole text of any length with \ufffd for each of `TURNING` and `CONTROLS`."""
    return _UNSEEN.sub("\ufffd", text)


def quoted(value: object) -> str:
    """A value as Python writes it, cut short in the middle."""
    words = _short.repr(value)
    return words if len(words) <= LONGEST else words[:LONGEST] + "…"


def listed(names: Iterable[str]) -> str:
    """Names in alphabetical order, with commas."""
    every = sorted(names)
    some = [shown(name) for name in every[:MOST]]
    more = [f"{len(every) - MOST} more"] if len(every) > MOST else []
    return ", ".join(some + more)
