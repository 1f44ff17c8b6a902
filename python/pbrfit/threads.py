"""Work on all processors, with results that do not depend on how many there are."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

AT_ONCE_MAX = 4
"""Pieces of work at once, at most: each has arrays of its own, and a copy of x."""

T = TypeVar("T")
R = TypeVar("R")


def processors() -> int:
    """That this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_pieces(threads: int, work: Callable[[T], R], pieces: Sequence[T]) -> list[R]:
    """What `work` makes of each piece, all of it; as `in_turn`."""
    return list(in_turn(threads, work, pieces))


def in_turn(threads: int, work: Callable[[T], R], pieces: Sequence[T]) -> Iterator[R]:
    """What `work` makes of each piece, in their order; 0 threads = one for each processor.

    For work that numpy and the core do with the interpreter unlocked, and that may be done twice:
    where the system gives no thread, this one does all. Pieces are begun in their order. An
    exception, or Ctrl-C, ends it after those that have begun.
    """
    threads = min(threads or processors(), AT_ONCE_MAX, len(pieces))
    if threads < 2:
        yield from map(work, pieces)
        return
    executor = ThreadPoolExecutor(threads)
    try:
        try:
            results = executor.map(work, pieces)
        except RuntimeError:  # of `Thread.start`; what `work` raises comes with its result
            executor.shutdown(cancel_futures=True)
            results = map(work, pieces)
        yield from results
    finally:
        executor.shutdown(cancel_futures=True)


_changing = threading.Lock()
if hasattr(os, "register_at_fork"):  # a child forked meanwhile would wait for it forever
    free = _changing.release
    os.register_at_fork(before=_changing.acquire, after_in_parent=free, after_in_child=free)
_limits: list[Any] = []
"""What blocks of `one_blas_thread` have changed, to be undone."""
_blocks = 0
"""Of it that run, in all threads."""


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Sums split over threads would round differently on a machine with more processors.

    The limit is the whole process's: it is undone when the last block of all threads ends.
    """
    global _blocks
    import threadpoolctl

    # From version 3.8 on a thread changes no limits while another one that has done so lives.
    controller = getattr(threadpoolctl, "OpenBLASController", None)
    take_over = getattr(controller, "clear_controlling_thread", lambda **_: None)
    with _changing:
        take_over(force=True)
        limit = threadpoolctl.threadpool_limits(1, user_api="blas")
        _limits.append(limit)  # of libraries that were loaded since the last, too
        _blocks += 1
    try:
        yield
    finally:
        with _changing:
            _blocks -= 1
            take_over(force=True)
            while not _blocks and _limits:
                _limits.pop().restore_original_limits()
