"""What files hold, as part of a message: printable, in one line, and short."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable

LONGEST = 200
"""Letters of a text that are shown."""

MOST = 12
"""Names of a list that are shown."""

_short = reprlib.Repr()
_short.maxlevel, _short.maxstring, _short.maxlong, _short.maxother = 4, 60, 40, 60


def shown(text: object) -> str:
    """Text without quotation marks, such as another library's words about a file."""
    words = str(text)
    clean = "".join(
        letter if letter.isprintable() else repr(letter)[1:-1] for letter in words[:LONGEST]
    )
    return clean + "…" * (len(words) > LONGEST)


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
