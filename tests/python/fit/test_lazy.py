"""Attributes that are computed when first asked for."""

from __future__ import annotations

import multiprocessing
import sys
import threading

import pytest

from pbrfit.lazy import lazy

PATIENCE = 30.0


class Slow:
    """Counts how often its value is computed, and may take its time."""

    def __init__(self, begun: threading.Event | None = None) -> None:
        self.count = 0
        self.begun, self.end = begun, threading.Event()

    @lazy
    def value(self) -> int:
        """What it is."""
        self.count += 1
        if self.begun is not None:
            self.begun.set()
            self.end.wait(PATIENCE)
        return 7


def test_a_value_is_computed_once_for_each_instance() -> None:
    one, other = Slow(), Slow()
    assert (one.value, one.value, one.count, other.count) == (7, 7, 1, 0)
    assert other.value == 7


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # from 3.12 on, of forks with threads
def test_a_fork_while_a_thread_computes_a_value_can_compute_its_own() -> None:
    busy = Slow(threading.Event())
    assert busy.begun is not None
    thread = threading.Thread(target=lambda: busy.value)
    thread.start()
    assert busy.begun.wait(PATIENCE)
    child = multiprocessing.get_context("fork").Process(target=lambda: Slow().value)
    child.start()
    child.join(PATIENCE)
    ended = child.exitcode
    child.kill()
    busy.end.set()
    thread.join()
    assert ended == 0
