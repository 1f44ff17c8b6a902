"""The race: every peer, at every number of threads, in a process of its own, checked, then timed.

All take turns in every round, so that a machine that slows down slows all of them.
"""

from __future__ import annotations

import multiprocessing
import os
import statistics
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from pbrfit import _core
from peers.case import Case
from peers.roster import Entry
from peers.worker import Assignment, Failed, Memory, Ready, Turn, work

LOSS_TOLERANCE = 1e-4
GRADIENT_TOLERANCE = 1e-3
READY_TIMEOUT_S = 1800.0
TURN_TIMEOUT_S = 600.0
LEAVE_TIMEOUT_S = 10.0

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NPROC",  # XLA's thread pool
    "NUMBA_NUM_THREADS",
)

KEEP_FREED_MEMORY = {
    "MALLOC_ARENA_MAX": "1",  # or memory of XLA's threads would still go back
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(2**62),
}
"""glibc: freed memory stays with the process instead of going back to the system page by page."""


@dataclass(frozen=True)
class Settings:
    """What is evaluated, and how often."""

    size: int
    pictures: int
    threads: tuple[int, ...]
    rounds: int
    seed: int = 0

    @property
    def pixels(self) -> int:
        """P."""
        return self.size * self.size


@dataclass(frozen=True)
class Times:
    """Of one peer over the rounds."""

    median_ms: float
    quartiles_ms: tuple[float, float]
    processors: float
    """Processor time by time, in the median round."""
    waiting_share: float
    """Share of one processor that the peer used while others were at work."""


@dataclass(frozen=True)
class Standing:
    """What came out for one peer. Status is "ok", or says why there are no times."""

    name: str
    package: str
    threads: int
    status: str = "ok"
    version: str | None = None
    libraries: tuple[str, ...] = ()
    loss_error: float | None = None
    """Relative, against the core called in this process."""
    gradient_error: float | None = None
    """Relative, in the Euclidean norm: the worst of albedo, roughness, metallic, lights."""
    times: Times | None = None
    peak_mib: float | None = None


Answer = TypeVar("Answer")


class WithdrawnError(Exception):
    """A peer cannot go on; the message says why."""


class Seat:
    """A peer's process, seen from here."""

    def __init__(self, entry: Entry, settings: Settings, threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.entry = entry
        self._connection, theirs = context.Pipe()
        assignment = Assignment(entry, settings.pixels, settings.pictures, settings.seed, threads)
        self._process = context.Process(target=work, args=(theirs, assignment), daemon=True)
        self._process.start()
        theirs.close()

    def ready(self) -> Ready:
        """Wait until the peer is made, compiled and warm."""
        return self._answer(Ready, READY_TIMEOUT_S)

    def turn(self) -> Turn:
        """Have it evaluate once."""
        self._tell("turn")
        return self._answer(Turn, TURN_TIMEOUT_S)

    def peak_kib(self) -> int | None:
        """Its peak memory over the turns."""
        self._tell("memory")
        return self._answer(Memory, TURN_TIMEOUT_S).peak_kib

    def leave(self) -> None:
        """End the process."""
        self._connection.close()
        self._process.join(LEAVE_TIMEOUT_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _tell(self, what: str) -> None:
        try:
            self._connection.send(what)
        except OSError:
            raise self._ended() from None

    def _answer(self, kind: type[Answer], timeout: float) -> Answer:
        try:
            if not self._connection.poll(timeout):
                raise WithdrawnError(f"no answer within {timeout:g} s")
            message = self._connection.recv()
        except (EOFError, OSError):
            raise self._ended() from None
        if isinstance(message, Failed):
            raise WithdrawnError(message.reason)
        assert isinstance(message, kind)
        return message

    def _ended(self) -> WithdrawnError:
        self._process.join(LEAVE_TIMEOUT_S)
        return WithdrawnError(f"its process ended with code {self._process.exitcode}")


def race(entries: Sequence[Entry], settings: Settings) -> list[Standing]:
    """All peers against each other: one works while the others wait.

    Where there is glibc, freed memory stays with the processes, which helps most peers.
    """
    case = Case.make(settings.pixels, settings.pictures, settings.seed)
    problem = _core.Problem(case.images, case.normals, case.views, model="paper")
    loss, gradient = problem.value_and_grad(case.x)
    del problem

    standings: dict[tuple[str, int], Standing] = {}
    seats: dict[tuple[str, int], Seat] = {}
    turns: dict[tuple[str, int], list[Turn]] = {}

    def withdraw(key: tuple[str, int], reason: str) -> None:
        standings[key] = replace(standings[key], status=reason)
        seats.pop(key).leave()

    runners = [(entry, threads) for entry in entries for threads in settings.threads]
    try:
        for entry, threads in tqdm(runners, desc="start and check", disable=None):
            key = entry.name, threads
            standings[key] = Standing(entry.name, entry.package, threads)
            with _environment(threads):
                seats[key] = Seat(entry, settings, threads)
            try:
                ready = seats[key].ready()
            except WithdrawnError as reason:
                withdraw(key, str(reason))
                continue
            standings[key] = checked(standings[key], ready, loss, gradient, case.pixels)
            if standings[key].status != "ok":
                withdraw(key, standings[key].status)
        for _ in tqdm(range(settings.rounds), desc="rounds", disable=None):
            for key in list(seats):
                try:
                    turns.setdefault(key, []).append(seats[key].turn())
                except WithdrawnError as reason:
                    withdraw(key, str(reason))
        for key in list(seats):
            try:
                peak = seats[key].peak_kib()
            except WithdrawnError as reason:
                withdraw(key, str(reason))
                continue
            standings[key] = replace(
                standings[key],
                times=_times(turns[key]),
                peak_mib=None if peak is None else peak / 1024,
            )
    finally:
        for seat in seats.values():
            seat.leave()
    return list(standings.values())


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    """For processes started meanwhile: so many threads, and freed memory kept."""
    before = dict(os.environ)
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))
    os.environ.update(KEEP_FREED_MEMORY)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def checked(
    standing: Standing, ready: Ready, loss: float, gradient: NDArray[np.float64], pixels: int
) -> Standing:
    """With the errors of a peer, and out if they are too large."""
    standing = replace(standing, version=ready.version, libraries=ready.libraries)
    if ready.gradient.shape != gradient.shape:
        return replace(
            standing,
            status=f"disagrees: gradient of shape {ready.gradient.shape}, not {gradient.shape}",
        )
    loss_error = abs(ready.loss - loss) / loss
    borders = [3 * pixels, 4 * pixels, 5 * pixels]
    errors = [
        float(np.linalg.norm(theirs - ours) / np.linalg.norm(ours))
        for theirs, ours in zip(
            np.split(ready.gradient, borders), np.split(gradient, borders), strict=True
        )
    ]
    worst = float(np.max(errors))  # NaN if one is
    standing = replace(standing, loss_error=loss_error, gradient_error=worst)
    if not (loss_error <= LOSS_TOLERANCE and worst <= GRADIENT_TOLERANCE):
        parts = ("albedo", "roughness", "metallic", "lights")
        found = ", ".join(f"{part} {e:.1e}" for part, e in zip(parts, errors, strict=True))
        status = f"disagrees: relative error of the loss {loss_error:.1e}, of gradients {found}"
        return replace(standing, status=status)
    return standing


def _times(turns: Sequence[Turn]) -> Times:
    seconds = [turn.seconds for turn in turns]
    lower, median, upper = 1e3 * np.quantile(seconds, (0.25, 0.5, 0.75))
    waited = sum(turn.waiting_seconds for turn in turns)
    return Times(
        median_ms=float(median),
        quartiles_ms=(float(lower), float(upper)),
        processors=statistics.median(turn.cpu_seconds / turn.seconds for turn in turns),
        waiting_share=sum(turn.waiting_cpu_seconds for turn in turns) / waited if waited else 0.0,
    )
