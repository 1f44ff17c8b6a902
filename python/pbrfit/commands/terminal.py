"""What is printed for people: colours where a terminal shows them, verdicts, held-out errors."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence

from pbrfit.commands.messages import in_flags
from pbrfit.result.held_out import HeldOut
from pbrfit.result.verdict import MARKS, Level, Verdict

ASCII_SIGNS: Mapping[Level, str] = {"usable": "+", "rough guide": "~", "not determined": "-"}
"""What stands for the discs where a terminal has no such letters."""

CUBE = (0, 95, 135, 175, 215, 255)
"""Codes that a channel of a terminal's 216 colours has, of 255."""

DIM = "2"

LEADS = ("next:", "also:")
"""Before the first step and before others."""


def verdict_lines(verdicts: Mapping[str, Verdict], steps: Sequence[str]) -> list[str]:
    """A line a map, with a disc, and what to do next; none without verdicts.

    Lines are coloured, and long ones wrapped, where stdout is a terminal.
    """
    lines = []
    width = max((len(name) for name in verdicts), default=0) + 1
    longest = max(map(len, MARKS))
    for name, one in verdicts.items():
        sign, level = marked(one.level, f"{one.level:<{longest}}")
        lines.append(f"{sign} {f'{name}:':<{width}} {level}  expected error {one.error_in_words}")
    lines += [_after(LEADS[min(i, 1)], in_flags(step)) for i, step in enumerate(steps)]
    return lines


def held_out_lines(held_out: HeldOut | None) -> list[str]:
    """How well left-out pictures are explained, and what was chosen; none where none were."""
    if held_out is None:
        return []
    lead, said = held_out.decision().split(" ", 1)
    return [_wrapped(held_out.in_words(), "  "), _after(lead, said)]


def _after(lead: str, said: str) -> str:
    """What is said, behind a word that leads to it."""
    return f"{painted(lead, DIM)} {_wrapped(said, ' ' * (len(lead) + 1))}"


def _wrapped(said: str, indent: str) -> str:
    """A text in as many lines as it needs in a terminal, all but the first indented."""
    columns = columns_of_stdout()
    if columns is None:
        return said
    return f"\n{indent}".join(textwrap.wrap(said, max(columns - len(indent) - 1, 30)))


def marked(level: Level, text: str) -> tuple[str, str]:
    """The disc of a level and a text, both in its colour."""
    red, green, blue = map(CUBE.index, MARKS[level].ink)
    code, sign = f"38;5;{16 + 36 * red + 6 * green + blue}", MARKS[level].sign
    try:
        sign.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        sign = ASCII_SIGNS[level]
    return painted(sign, code), painted(text, code)


def columns_of_stdout() -> int | None:
    """Letters in a line of a terminal; None where it is none, and lines may have any length."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def painted(text: str, code: str) -> str:
    """A text in the colour of a code, on a terminal whose user wants colours (no-color.org)."""
    none = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return text if none or not sys.stdout.isatty() else f"\x1b[{code}m{text}\x1b[0m"
