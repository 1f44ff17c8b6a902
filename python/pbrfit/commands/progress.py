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
        from tqdm import tqdm

        now = time.monotonic()
        if now - self._told < LINE_EVERY:
            return
        self._told = now
        said = tqdm.format_meter(
            self.n,
            0 if self.unit == "it" else self.total,  # 0 = unknown: so many iterations at most
            now - self._began,
            ncols=0,  # no bar
            prefix=self._name or "",
            unit=self.unit,
            postfix=self._postfix,
            initial=self.initial,
        )
        complain(said)
