"""Lines on stderr, and what to do where nobody can read."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from pbrfit.values.quoting import visible

OPTIONS = ("color_space", "fov", "iterations", "orientation", "time_limit", "white")
"""Options that the library speaks of, as Python names them."""


@contextmanager
def unread_is_no_failure() -> Iterator[None]:
    """For telling about an output that is there, whether or not anybody can read about it."""
    try:
        yield
        sys.stdout.flush()
    except OSError:
        unread()


def unread() -> None:
    """Let what nobody reads go nowhere, if stdout fails: or Python would fail when it ends."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def complain(message: str) -> None:
    """Say what is wrong, in one line on stderr; where nobody can be told, work goes on.

    What the library says of its options is said in flags, and no name in it steers the terminal.
    """
    try:
        print(f"pbrfit: {visible(in_flags(message))}", file=sys.stderr, flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())  # as above


def in_flags(message: str) -> str:
    """What the library says of its options, in the words of the command line.

    "option fov" and "overwrite=True" become flags. Others than `OPTIONS` stay, as in file names.
    """
    message = re.sub(r"\boverwrite=True\b", "--overwrite", message)
    message = re.sub(r"\bcode_range=\((\d+), (\d+)\)", r"--code-range \1,\2", message)
    return re.sub(
        rf"\boption ({'|'.join(OPTIONS)})\b", lambda m: f"--{m[1].replace('_', '-')}", message
    )
