"""How work goes on: a bar where stderr is a terminal, else a line every few seconds."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Self

from pbrfit.commands.messages import complain

LINE_EVERY = 5.0
"""Seconds between two lines: few enough for a log, often enough to see that it goes on."""


def progress_bar(
    total: int,
    *,
    quiet: bool,
    unit: str = "it",
    name: str | None = None,
    leave: bool = True,
    smoothing: float = 0.3,
) -> Any:
    """Make a `tqdm` bar on stderr, or what prints lines as it would where that is no terminal.

    Neither shows anything where `quiet` is asked for.
    """
    if not quiet and sys.stderr is not None and not sys.stderr.isatty():
        return ProgressLines(total, unit=unit, name=name)
    from tqdm import tqdm

    return tqdm(
        total=total,
        desc=name,
        unit=unit,
        leave=leave,
        smoothing=smoothing,
        disable=quiet or sys.stderr is None,
        dynamic_ncols=True,
    )


class ProgressLines:
    """A bar for logs, as far as `tqdm`'s is used here: a line on stderr every few seconds.

    What is done sooner prints none.
    """

    disable = False

    def __init__(self, total: int, *, unit: str, name: str | None) -> None:
        self.n = self.initial = 0
        self.total, self.unit, self._name = total, unit, name
        self._postfix = ""
        self._began = self._told = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def update(self, count: int = 1) -> None:
        """So many more are done."""
        self.n += count
        self._tell()

    def set_postfix_str(self, text: str, refresh: bool = True) -> None:
        """What to say beside the numbers."""
        self._postfix = text
        if refresh:
            self._tell()

    def reset(self, total: int) -> None:
        """Count anew, up to another total."""
        self.n, self.total = 0, total
        self._began = time.monotonic()

    def refresh(self) -> None:
        """Nothing: lines come when it is time."""

    def close(self) -> None:
        """Nothing: what comes of the work says more."""

    def external_write_mode(self) -> AbstractContextManager[None]:
        """Let others write: lines are in nobody's way."""
        return nullcontext()

    def _tell(self) -> None:
        now = time.monotonic()
        if now - self._told < LINE_EVERY:
            return
        self._told = now
        units, elapsed = f"{self.unit}s", now - self._began
        parts = [f"{self.n} of {self.total} {units}", _duration(elapsed)]
        if self.unit == "it":  # so many at most; the time left is not known
            parts[0] = f"{self.n} iteration{'s' * (self.n != 1)}"
        elif self.n > self.initial:
            left = elapsed / (self.n - self.initial) * (self.total - self.n)
            parts.append(f"about {_duration(left)} left")
        if self._postfix:
            parts.append(self._postfix)
        said = ", ".join(parts)
        complain(said if self._name in (None, units) else f"{self._name}: {said}")


def _duration(seconds: float) -> str:
    """About so long: 42 s, 3 min, 2 h 05 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
