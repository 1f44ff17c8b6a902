"""Where tasks run: in several processes; `cluster` has those on other machines."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from pbrfit import ending
from pbrfit.batch import heartbeat
from pbrfit.batch.heartbeat import Watch
from pbrfit.threads import processors


class Workers(ABC):
    """Those who do tasks in other processes."""

    threads: int | None = None
    """That a task may use: 0 = one for each processor; None = as many as its worker has."""
    deaths: tuple[type[BaseException], ...] = ()
    """What a future raises when the process of its task died, beside `BrokenExecutor`."""
    watch: Watch | None = None
    """Of tasks that make no step; None = nobody looks."""
    failure: BaseException | None = None
    """Of the thread that hands out tasks, after which none ends."""

    @abstractmethod
    def start(self) -> Executor:
        """Give an executor that works: a new one where the last one broke."""

    @abstractmethod
    def slots(self) -> int:
        """How many tasks may run now."""

    @abstractmethod
    def stop(self) -> None:
        """Let go of everything; what still runs is ended at once."""


class Processes(Workers):
    """Processes of this machine, started afresh (spawn).

    So nothing is inherited from a process whose threads may hold locks. Processors are shared out
    among them. A process whose task makes no step for `patience` seconds is ended; 0 = none is.
    """

    def __init__(self, jobs: int, patience: float = heartbeat.PATIENCE) -> None:
        self._jobs = jobs
        self.watch = Watch(jobs, patience) if patience else None
        self._pool: ProcessPoolExecutor | None = None
        self._others: set[BaseProcess] = set()
        self.threads = share(jobs)

    def start(self) -> Executor:
        """Give a pool; the one before is let go."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self._others = set(multiprocessing.active_children())
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no task has more, see `attempt`
        threading.excepthook = self._thread_failed
        with _unbroken():
            self._pool = _Spawning(
                self._jobs,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_begin_worker,
                initargs=(None if self.watch is None else self.watch.rows,),
            )
        return self._pool

    def _thread_failed(self, told: threading.ExceptHookArgs) -> None:
        if "start new thread" in str(told.exc_value):
            self.failure = told.exc_value  # of a pool's thread, which needs one more
        else:
            threading.__excepthook__(told)

    def slots(self) -> int:
        """As many as there are processes."""
        return self._jobs

    def stop(self) -> None:
        """Kill the processes: a worker would go on with its task, and Python waits for it."""
        if self._pool is None:
            return
        threading.excepthook = threading.__excepthook__
        for worker in set(multiprocessing.active_children()) - self._others:
            worker.kill()
        with suppress(RuntimeError):  # it could start no thread, which is what to tell
            self._pool.shutdown(cancel_futures=True)
        self._pool = None


def share(jobs: int) -> int:
    """Threads of a task where so many run on this machine."""
    return max(1, processors() // max(1, jobs))


class _Spawning(ProcessPoolExecutor):
    """Whose processes never hear Ctrl-C, not even while they start: the parent is told too."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        with _unbroken(), _deaf():  # processes are started in here, and inherit deafness
            return super().submit(fn, *args, **kwargs)


@contextmanager
def _unbroken() -> Iterator[None]:
    """Let what a signal would raise come after the block.

    A process that is half started is known to nobody who could end it. It is not enough to block
    signals here: another thread hears of them, and Python raises in this one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[tuple[int, FrameType | None]] = []
    before = {}
    for number in ending.SIGNALS:
        handler = signal.getsignal(number)
        if callable(handler):
            before[number] = handler
            signal.signal(number, lambda *what: heard.append(what))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for told, frame in heard[:1]:
            before[signal.Signals(told)](told, frame)


@contextmanager
def _deaf() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(rows: Any) -> None:
    heartbeat.share(rows)
    logging.captureWarnings(True)  # as in the parent
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it could not be blocked
    parent = multiprocessing.parent_process()
    if parent is not None:
        try:
            threading.Thread(target=_end_with, args=[parent], daemon=True).start()
        except RuntimeError:  # the parent hears of it, and tries with fewer at once
            os._exit(1)


def _end_with(parent: BaseProcess) -> None:
    """End this process when its parent has died without a word: nobody else would end it."""
    parent.join()
    os._exit(1)
