"""Options, exit codes and manners that the commands share."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Subcommands = Any
"""What `argparse.ArgumentParser.add_subparsers` returns, which has no public name."""

DONE, SOME_FAILED, UNUSABLE, INTERRUPTED = 0, 1, 2, 130
"""Exit codes: done; some scenes failed; wrong usage or unusable input; Ctrl-C."""


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the scene folder that a command reads."""
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")


def add_result(parser: argparse.ArgumentParser, metavar: str, what: str) -> None:
    """Add a result folder, and `--out` and `--overwrite` for what is made of it."""
    parser.add_argument("result", metavar="RESULT", type=Path, help="result folder")
    parser.add_argument("--out", metavar=metavar, type=Path, required=True, help=what)
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier output")


def add_out(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--out` and `--overwrite`."""
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help=what)
    parser.add_argument("--overwrite", action="store_true", help="replace existing results")


def add_quiet(
    parser: argparse.ArgumentParser, what: str = "no progress bar, no table, no warnings"
) -> None:
    """Add `--quiet`."""
    parser.add_argument("--quiet", action="store_true", help=what)


def add_jobs(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--jobs`."""
    parser.add_argument("--jobs", metavar="J", type=positive, help=what)


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Add `--cluster`."""
    parser.add_argument(
        "--cluster",
        metavar="local|ADDRESS",
        help="hand scenes to the workers of a dask scheduler, which share storage with this "
        "machine, or to a cluster on this machine alone; --jobs limits how many at the same time; "
        "needs pip install 'pbrfit[cluster]'",
    )


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add `--threads`."""
    parser.add_argument(
        "--threads",
        metavar="T",
        type=whole_number,
        default=0,
        help="0 = one for each processor; results do not depend on it",
    )


def whole_number(text: str) -> int:
    """Read a number for `argparse` that fits everywhere."""
    value = int(text)
    if not 0 <= value < 2**31:
        raise argparse.ArgumentTypeError(f"expected 0 or more, found {text}")
    return value


def positive(text: str) -> int:
    """Read a whole number above 0 for `argparse`."""
    value = whole_number(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected 1 or more, found {text}")
    return value


def code_range(text: str) -> tuple[int, int]:
    """Read LOW,HIGH for `argparse`."""
    parts = text.split(",")
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(f"expected LOW,HIGH, found {text}")
    return whole_number(parts[0]), whole_number(parts[1])


SIGNED = ("--light", "--rotate", "--exposure", "--color")
"""Options whose value may begin with a minus sign."""


def with_signed_values(arguments: Sequence[str]) -> list[str]:
    """Tie values such as ``-40,30`` to their options: ``--light=-40,30``.

    `argparse` takes an argument that begins with a minus sign for an option, unless it is a plain
    number; a list of numbers is none.
    """
    tied: list[str] = []
    for i, argument in enumerate(arguments):
        if argument == "--":  # what follows is no option
            return [*tied, *arguments[i:]]
        if tied and tied[-1] in SIGNED and re.match(r"-\.?\d", argument):
            tied[-1] += f"={argument}"
        else:
            tied.append(argument)
    return tied


def numbers(count: int, form: str) -> Callable[[str], tuple[float, ...]]:
    """Reader for `argparse` of so many finite numbers with commas between them, such as `form`."""

    def read(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count or not all(math.isfinite(value) for value in values):
            raise argparse.ArgumentTypeError(f"expected {form}, finite numbers, found {text!r}")
        return values

    return read


def number(text: str) -> float:
    """Read a finite number for `argparse`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a finite number, found {text!r}")
    return value


def progress_bar(
    total: int,
    *,
    quiet: bool,
    unit: str = "it",
    name: str | None = None,
    leave: bool = True,
    smoothing: float = 0.3,
) -> Any:
    """Make a `tqdm` bar on stderr; none where that is no terminal, or `quiet` is asked for."""
    from tqdm import tqdm

    return tqdm(
        total=total,
        desc=name,
        unit=unit,
        leave=leave,
        smoothing=smoothing,
        disable=True if quiet else None,  # None: only where stderr is a terminal
        dynamic_ncols=True,
    )


@contextmanager
def unread_is_no_failure() -> Iterator[None]:
    """For telling about an output that is there, whether or not anybody can read about it."""
    try:
        yield
        sys.stdout.flush()
    except OSError:
        # What is still in the buffer goes nowhere, or Python would fail on it when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def complain(message: str) -> None:
    """Say what is wrong, in one line on stderr; where nobody can be told, work goes on."""
    if sys.stderr is None:
        return  # it was closed by whoever called
    try:
        print(f"pbrfit: {message}", file=sys.stderr, flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())  # as above


def message_of(error: Exception) -> str:
    """One line that names the file."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())
