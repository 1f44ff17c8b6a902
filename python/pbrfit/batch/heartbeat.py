"""Signs of life: each worker of this machine counts the steps of its task where its parent sees."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

PATIENCE = 3600.0
"""Seconds without a step after which a scene is given up. The longest that a healthy fit was silent
is 75 s, at 1.5 MP with 25 pictures on two busy cores; larger pictures are fitted in tiles, each a
step, but are read and aligned in one, which takes half an hour at 16 MP with 64 pictures."""

LOOK_MAX = 10.0
"""Seconds between two looks, at most, that count: after more this process had been stopped, with
Ctrl-Z or a sleeping machine, and its workers with it."""

_row: memoryview | None = None
"""Of this process's task: its process's number, and steps so far."""
_rows: Any = None


class Watch:
    """What a parent knows of its workers: whose task has made no step for `patience` seconds."""

    def __init__(self, jobs: int, patience: float) -> None:
        self.patience = patience
        self.rows = get_context("spawn").RawArray("q", 2 * jobs)
        self._seen: dict[int, tuple[int, float]] = {}
        """By slot the steps that were seen last, and for how many seconds."""
        self._looked = time.monotonic()

    def begin(self) -> int:
        """Give the slot of a task that is handed over."""
        slot = next(i for i in range(len(self.rows) // 2) if i not in self._seen)
        self.rows[2 * slot : 2 * slot + 2] = [0, 0]
        self._seen[slot] = 0, 0.0
        return slot

    def end(self, slot: int) -> None:
        """Take the slot of a task that has ended."""
        del self._seen[slot]

    def kill_stalled(self) -> set[int | None]:
        """End the processes that make no step; their slots."""
        now, stalled = time.monotonic(), set[int | None]()
        passed, self._looked = min(now - self._looked, LOOK_MAX), now
        for slot, (steps, silent) in self._seen.items():
            process, found = self.rows[2 * slot : 2 * slot + 2]
            silent = 0.0 if process == 0 or found != steps else silent + passed
            self._seen[slot] = found, silent
            if silent > self.patience:
                stalled.add(slot)
                with suppress(OSError):  # it has just died
                    os.kill(process, getattr(signal, "SIGKILL", signal.SIGTERM))
        return stalled

    @property
    def words(self) -> str:
        """Why a task was given up."""
        return f"expected a step within {self.patience:g} s, found none; its process was ended"


def share(rows: Any) -> None:
    """Take what `Watch.rows` of the parent is, in a new worker."""
    global _rows
    _rows = rows


def take(slot: int | None) -> None:
    """Begin the task of a slot."""
    global _row
    _row = None
    if slot is not None and _rows is not None:
        _row = memoryview(_rows).cast("B").cast("q")[2 * slot : 2 * slot + 2]
        _row[1] = 1
        _row[0] = os.getpid()


def step() -> None:
    """Say that the task of this process has come further."""
    if _row is not None:
        _row[1] += 1
