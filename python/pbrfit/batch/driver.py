"""Tasks handed to workers, no more at a time than may run, until each of them has ended."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pbrfit import address_space
from pbrfit.batch import heartbeat
from pbrfit.batch.cluster import Cluster, threads_of_worker
from pbrfit.batch.executors import Processes, Workers
from pbrfit.errors import in_one_line
from pbrfit.threads import one_blas_thread

log = logging.getLogger("pbrfit")

T = TypeVar("T")
R = TypeVar("R")

LOOK_EVERY = 1.0
"""Seconds to wait for a task to end before looking around: whether there are more slots, and to
tell that work goes on."""


@dataclass(frozen=True)
class Attempt(Generic[R]):
    """What became of a task."""

    value: R | None
    """What its function returned; None if it failed."""
    error: str | None
    """In one line why it failed, else None."""
    raised: str | None = None
    """The type of what its function raised, by name."""
    seconds: float = 0.0
    said: tuple[tuple[int, str], ...] = ()
    """What it logged in another process: level and message."""


def workers(
    jobs: int | None, cluster: str | None, *, most: int, patience: float | None = None
) -> Workers | None:
    """Make the workers for so many tasks at the same time, of whom no more than `most` are of use.

    Without a cluster (see `pbrfit.batch.cluster.Cluster`) `jobs` of 1 or None need none, unless
    `patience` of `Processes` is given; on one, None is one job for each worker. Raises InputError
    if there is no such cluster.
    """
    jobs = None if jobs is None else min(jobs, most)
    if cluster is not None:
        return Cluster(cluster, jobs)
    if patience is not None:
        return Processes(jobs or 1, patience)
    return None if jobs in (None, 1) else Processes(jobs)


def drive(
    tasks: Sequence[T],
    work: Callable[[T, int], R],
    workers: Workers | None,
    *,
    ended: Callable[[T, Attempt[R]], None],
    meanwhile: Callable[[int], None] = lambda _: None,
    memory: Callable[[T], int] | None = None,
    available: int | None = None,
) -> None:
    """Do all tasks, whatever can be pickled, by workers that are stopped in the end.

    Without workers they are done in this process, one by one, with all processors.

    Whoever runs when a worker dies is suspected of it. Suspects are tried again in the end, one at
    a time, which shows whose process dies; the death may also have been another's doing, who took
    all memory. A task that makes no step has its process ended and fails at once; those that ran
    beside it are done again as if nothing had been.

    `work` is a function of a module, called with a task and the number of threads it may use (0 =
    one for each processor). What it raises fails its task alone. `ended` is called in this thread
    with each task as it ends, `meanwhile` with how many run, when that changes and while nothing
    ends. `memory` gives the bytes that a task will take, of so many `available`: a task waits while
    it and those running would take more; one runs always.
    """
    if workers is None:
        for task in tasks:
            ended(task, attempt(work, task, 0, False))
        return
    waiting, suspects = deque(tasks), deque[T]()
    sizes: dict[int, int] = {}  # by the identity of a task: its size is read from files, once

    def fit(some: Sequence[T]) -> bool:
        """Whether there is memory enough for some tasks at once, as far as it is known."""
        if memory is None or available is None:
            return True
        sizes.update({id(one): memory(one) for one in some if id(one) not in sizes})
        return sum(sizes[id(one)] for one in some) <= available

    try:
        while waiting or suspects:
            queue, others = (waiting, suspects) if waiting else (suspects, None)
            _one_pool(queue, work, workers, ended, meanwhile, fit, others)
    finally:
        workers.stop()


def _one_pool(
    queue: deque[T],
    work: Callable[[T, int], R],
    workers: Workers,
    ended: Callable[[T, Attempt[R]], None],
    meanwhile: Callable[[int], None],
    fit: Callable[[Sequence[T]], bool],
    suspects: deque[T] | None,
) -> None:
    """Hand over tasks until there are none, or the pool breaks; without `suspects` one by one."""
    executor, broken = workers.start(), False
    running: dict[Future[Attempt[R]], tuple[T, int | None]] = {}
    watch, stalled = workers.watch, set[int | None]()
    while running or (queue and not broken):
        at_once = workers.slots() if suspects is not None else 1
        while queue and not broken and len(running) < at_once:
            task = queue[0]
            if running and not fit([task, *(one for one, _ in running.values())]):
                break
            slot = None if watch is None else watch.begin()
            try:
                future = executor.submit(attempt, work, task, workers.threads, True, slot)
            except BrokenExecutor:
                broken = True  # it was not handed over
                if watch is not None and slot is not None:
                    watch.end(slot)
            else:
                running[future] = queue.popleft(), slot
        if not running:
            continue
        meanwhile(len(running))
        done, _ = wait(running, timeout=LOOK_EVERY, return_when=FIRST_COMPLETED)
        if workers.failure is not None:
            raise workers.failure
        if watch is not None and not stalled:
            stalled |= watch.kill_stalled()
        for future in sorted(done, key=lambda one: _failure(one) is not None):
            task, slot = running.pop(future)
            found, died = _outcome(future, workers.deaths)
            broken = broken or (died and isinstance(_failure(future), BrokenExecutor))
            if watch is not None and slot is not None:
                watch.end(slot)
            if died and watch is not None and slot in stalled:
                ended(task, Attempt(None, watch.words))
            elif died and stalled:
                queue.append(task)  # nobody suspects it: another one was at fault
            elif died and suspects is not None:
                suspects.append(task)
            else:
                ended(task, found)


def attempt(
    work: Callable[[T, int], R], task: T, threads: int | None, apart: bool, slot: int | None = None
) -> Attempt[R]:
    """Do a task where it runs; what it raises becomes a line. `slot` is of `heartbeat.Watch`."""
    if threads is None:
        threads = threads_of_worker()
    heartbeat.take(slot)
    began = time.perf_counter()
    value, error, raised = None, None, None
    with _listening(apart) as said:
        try:
            with one_blas_thread():  # of small matrices: more get into each other's way
                value = work(task, threads)
        except Exception as failure:  # whatever it is, the other tasks are no worse for it
            error, raised = in_one_line(failure), type(failure).__name__
            log.debug("%s", error, exc_info=True)
    return Attempt(value, error, raised, time.perf_counter() - began, tuple(said))


def repeat_log(said: Sequence[tuple[int, str]]) -> None:
    """Log here what was logged in another process."""
    for level, message in said:
        log.log(level, "%s", message)


def _failure(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _outcome(
    future: Future[Attempt[R]], deaths: tuple[type[BaseException], ...]
) -> tuple[Attempt[R], bool]:
    """The attempt, and whether its process died."""
    failure = _failure(future)
    if failure is None:
        return future.result(), False
    if isinstance(failure, (BrokenExecutor, CancelledError, *deaths)):
        # Where address space is limited the core may find none, which ends a process.
        limited = address_space.left() is not None
        why = "; memory may be too short (ulimit -v)" if limited else ""
        return Attempt(None, f"its process died{why}"), True
    if not isinstance(failure, Exception):
        raise failure
    return Attempt(None, in_one_line(failure)), False  # such as a value that cannot be pickled


@contextmanager
def _listening(apart: bool) -> Iterator[list[tuple[int, str]]]:
    """Collect warnings of another process, which nobody would see there."""
    said: list[tuple[int, str]] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append((record.levelno, record.getMessage()))

    collector = Collector(logging.WARNING)
    if apart:
        log.addHandler(collector)
    try:
        yield said
    finally:
        log.removeHandler(collector)
