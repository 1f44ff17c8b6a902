"""The process of one peer: makes it, then evaluates when told to."""

from __future__ import annotations

import gc
import re
import time
import traceback
from dataclasses import dataclass
from importlib import metadata
from multiprocessing.connection import Connection

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_info

from pbrfit.batch import process_memory
from peers.case import Case
from peers.roster import Entry, Peer

REHEARSAL_PIXELS = 16 * 16
PAUSE_S = 0.1
"""After each turn, for thread pools that spin a while before they sleep."""


TIMED = 5
"""Evaluations that are timed in a turn, one after the other as in a solver; the median counts."""


@dataclass(frozen=True)
class Assignment:
    """What a worker is to do."""

    entry: Entry
    pixels: int
    pictures: int
    seed: int
    threads: int


@dataclass(frozen=True)
class Ready:
    """The peer is made, compiled and warm."""

    loss: float
    gradient: NDArray[np.float64]
    version: str
    libraries: tuple[str, ...]
    """BLAS and OpenMP libraries that were loaded."""


@dataclass(frozen=True)
class Failed:
    """The peer could not be made."""

    reason: str


@dataclass(frozen=True)
class Turn:
    """The median of the timed evaluations of a turn."""

    seconds: float
    cpu_seconds: float
    """Processor time of all threads meanwhile."""
    waiting_seconds: float
    """Time since the last turn ended, when others were at work."""
    waiting_cpu_seconds: float
    """Processor time meanwhile: of thread pools that do not sleep."""


@dataclass(frozen=True)
class Memory:
    """Peak memory while evaluating over what the process held before it had any data."""

    peak_kib: int | None


def work(connection: Connection, assignment: Assignment) -> None:
    """Answer each message ("turn", "memory") until the other side is gone."""
    try:
        peer, ready, baseline = _prepare(assignment)
        connection.send(ready)
        peak_is_fresh = process_memory.forget_peak()
        mark = _Clocks.now()
        while True:
            if connection.recv() == "turn":
                waited = _Clocks.now().since(mark)
                peer.evaluate()  # its threads and caches come back
                times = sorted((_timed(peer) for _ in range(TIMED)), key=lambda t: t.wall)
                took = times[TIMED // 2]
                time.sleep(PAUSE_S)
                connection.send(Turn(took.wall, took.cpu, waited.wall, waited.cpu))
                mark = _Clocks.now()
            else:
                peak = process_memory.status_kib("VmHWM") if peak_is_fresh else None
                if peak is None or baseline is None:
                    connection.send(Memory(None))
                else:
                    connection.send(Memory(peak - baseline))
    except (EOFError, BrokenPipeError):
        return
    except Exception as error:
        if not isinstance(error, ImportError):  # not installed: its one line says it all
            traceback.print_exc()
        connection.send(Failed(_one_line(error)))


@dataclass(frozen=True)
class _Clocks:
    wall: float
    cpu: float

    @classmethod
    def now(cls) -> _Clocks:
        return cls(time.perf_counter(), time.process_time())

    def since(self, earlier: _Clocks) -> _Clocks:
        return _Clocks(self.wall - earlier.wall, self.cpu - earlier.cpu)


def _timed(peer: Peer) -> _Clocks:
    start = _Clocks.now()
    peer.evaluate()
    return _Clocks.now().since(start)


def _prepare(assignment: Assignment) -> tuple[Peer, Ready, int | None]:
    """The peer, made and warm, and the resident memory before it had its data."""
    maker = assignment.entry.load()
    # Libraries load much when first used: not to be counted as memory of the peer.
    rehearsal = maker(Case.make(REHEARSAL_PIXELS, assignment.pictures), assignment.threads)
    rehearsal.evaluate()
    rehearsal.evaluate()
    del rehearsal
    gc.collect()
    baseline = process_memory.status_kib("VmRSS")
    case = Case.make(assignment.pixels, assignment.pictures, assignment.seed)
    peer = maker(case, assignment.threads)
    del case  # the peer keeps what it needs
    gc.collect()
    loss = peer.evaluate()
    ready = Ready(loss, peer.gradient(), metadata.version(assignment.entry.package), _libraries())
    peer.evaluate()
    return peer, ready, baseline


def _libraries() -> tuple[str, ...]:
    names = {(info["internal_api"], info["version"] or "") for info in threadpool_info()}
    return tuple(sorted(f"{name} {version}".strip() for name, version in names))


def _one_line(error: Exception) -> str:
    """Type and first line, without the folders that things happened in."""
    lines = str(error).strip().splitlines()
    reason = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    return re.sub(r"(?:[A-Za-z]:)?(?:[\\/][\w.+@-]+)+[\\/](?=[\w.+@-])", "", reason)
