"""How work goes on: steps of a fit as they end; a bar where stderr is a terminal, else lines."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any

from pbrfit.commands.messages import complain
from pbrfit.steps import log

if TYPE_CHECKING:
    from pbrfit.fit.run import Progress

LINE_EVERY = 5.0
"""Seconds between two lines: few enough for a log, often enough to see that it goes on."""

TICK = 1.0
"""Seconds between two views of the running step in a terminal."""

CLEAR = "\r\x1b[K"
"""Begins the line of a terminal anew."""


def progress_bar(
    total: int, *, quiet: bool, unit: str = "it", name: str | None = None, smoothing: float = 0.3
) -> Any:
    """Make a `tqdm` bar on stderr; where that is no terminal it prints a line now and then.

    Neither shows anything where `quiet` is asked for.
    """
    from tqdm import tqdm

    options: dict[str, Any] = {"dynamic_ncols": True}
    if not sys.stderr.isatty():
        options = {"file": _Lines(), "ncols": 0, "leave": False}
    return tqdm(total=total, desc=name, unit=unit, smoothing=smoothing, disable=quiet, **options)


class _Lines:
    """Makes lines for a log, some seconds apart, of what `tqdm` writes over one another."""

    def __init__(self) -> None:
        self._told = time.monotonic()

    def write(self, text: str) -> None:
        now, text = time.monotonic(), text.strip()
        if text and now - self._told >= LINE_EVERY:
            self._told = now
            complain(text)

    def flush(self) -> None:
        """Nothing: lines are there at once."""


@contextmanager
def fit_steps(*, quiet: bool) -> Iterator[Callable[[Progress], None] | None]:
    """Show the steps of a fit on stderr; what is given is for `decompose(progress=...)`."""
    if quiet:
        yield None
        return
    shown, ended = _Steps(), threading.Event()

    def tick() -> None:
        while not ended.wait(TICK):
            shown.tick()

    log.addHandler(shown)
    log.setLevel(logging.INFO)
    threading.Thread(target=tick, daemon=True).start()
    try:
        yield shown.progress
    finally:
        ended.set()
        log.removeHandler(shown)
        log.setLevel(logging.NOTSET)
        if shown.live:
            _write(CLEAR)


class _Steps(logging.Handler):
    """A line a step as it ends; in a terminal one of the running step, in a log what takes long."""

    def __init__(self) -> None:
        super().__init__()
        self.live = sys.stderr.isatty()
        self._running, self._tiles = "", ""
        self._began = self._told = 0.0

    def emit(self, record: logging.LogRecord) -> None:
        name, seconds = record.getMessage(), record.__dict__["seconds"]
        if seconds is None:
            self._running, self._tiles = name, ""
            self._began = self._told = time.monotonic()
            if self.live:
                _write(f"{CLEAR}… {name}\r")
            return
        self._running = ""
        if self.live:
            _write(f"{CLEAR}✓ {name:<28}{seconds:6.1f} s\n")
        elif seconds >= LINE_EVERY:
            complain(f"{name}: done in {seconds:.1f} s")

    def progress(self, now: Progress) -> None:
        """Note which tile is done, and tell."""
        if now.tiles is not None:
            self._tiles = f"tile {now.tiles[0]} of {now.tiles[1]}, "
        self.tick()

    def tick(self) -> None:
        """Say how long the running step has taken so far."""
        with self.lock or nullcontext():
            now = time.monotonic()
            if not self._running or now - self._told < (TICK if self.live else LINE_EVERY):
                return
            self._told = now
            said = f"{self._running}: {self._tiles}{now - self._began:.0f} s"
            if self.live:
                _write(f"{CLEAR}… {said}\r")
            else:
                complain(said)


def _write(text: str) -> None:
    with suppress(OSError, UnicodeEncodeError):
        print(text, end="", file=sys.stderr, flush=True)
