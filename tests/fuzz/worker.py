"""A process that reads damaged files, one after the other, within limits.

It dies of what goes wrong beyond Python (a crash, 5 s of processor time in one case, memory beyond
the address space that it is given), and `watch` then knows which case it was.
"""

from __future__ import annotations

import logging
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from unittest import mock

from fuzz import declared
from fuzz.cases import Plan, place
from fuzz.readers import READERS
from fuzz.seeds import Seed
from pbrfit import ending
from pbrfit._core import InputError
from pbrfit.batch import process_memory

SECONDS = 5.0
"""Of processor time that a case may take."""

ADDRESS_SPACE = 2 << 30
"""Beyond what the process has when it begins."""

LONGEST_MESSAGE = 1000


@dataclass
class Tally:
    """What came of the cases of a reader."""

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    growth: int = 0
    share_of_bound: float = 0.0

    def add(self, other: Tally) -> None:
        """Take in another."""
        self.outcomes += other.outcomes
        self.slowest = max(self.slowest, other.slowest)
        self.growth = max(self.growth, other.growth)
        self.share_of_bound = max(self.share_of_bound, other.share_of_bound)


def main(connection: Connection, at: Any, plans: Mapping[str, Plan]) -> None:
    """Do blocks of cases that arrive as (reader, first, last); `at` tells which case is under way.

    Answers are ("failed", number, what) for cases that failed, ("done", Tally) at the end of a
    block, and ("broken", traceback) where the worker itself is at fault.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    room = Room()
    try:
        for reader, plan in plans.items():  # imports are no memory of a case
            for sound in plan.sound[:1]:
                room.problem(reader, sound, Tally())
        while (block := connection.recv()) is not None:
            reader, first, last = block
            plan = plans[reader]
            tally = Tally()
            for number in range(first, last):
                at.value = number
                case = plan.case(number)
                problem = room.problem(reader, case, tally)
                if problem is not None:
                    connection.send(("failed", number, problem))
            connection.send(("done", tally))
    except Exception:  # a fault in here, and not in what is tested
        connection.send(("broken", traceback.format_exc()))


@contextmanager
def fast_folder() -> Iterator[None]:
    """Have processes, which may be killed, put files into a folder, in memory where known how."""
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with (
        ending.unwinding_when_told(watched=False),
        tempfile.TemporaryDirectory(prefix="fuzz-", dir=memory) as folder,
        mock.patch.dict(os.environ, TMPDIR=folder),
    ):
        yield


class Room:
    """Where cases run: limits are set, output is caught, files lie in a folder of their own."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp())
        self._readers = {reader.name: reader for reader in READERS}
        self._placed: Mapping[str, bytes] = {}
        self._output = (self.folder / "output").open("w+b")
        os.dup2(self._output.fileno(), 1)
        os.dup2(self._output.fileno(), 2)
        warnings.simplefilter("always")
        self._log = _Kept()
        logging.getLogger("pbrfit").addHandler(self._log)
        logging.getLogger("pbrfit").propagate = False
        _limit_address_space()

    def problem(self, reader: str, case: Seed, tally: Tally) -> str | None:
        """Run a case; what is wrong with what came of it, or None."""
        folder = self.folder / "case"
        # Most cases differ from the last one by one file.
        if self._placed.keys() != case.files.keys():
            shutil.rmtree(folder, ignore_errors=True)
            self._placed = {}
        kept = {name for name, data in case.files.items() if self._placed.get(name) is data}
        changed = {name: data for name, data in case.files.items() if name not in kept}
        place(Seed(case.name, case.target, changed), folder)
        self._placed = {k: v for k, v in case.files.items() if k != case.target}
        file = folder / case.target
        self._log.records.clear()
        before = (process_memory.status_kib("VmRSS") or 0) if process_memory.forget_peak() else None
        began = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        kind, problem = outcome(lambda: self._readers[reader].read(folder, file), folder, file)
        signal.setitimer(signal.ITIMER_PROF, 0)
        seconds = time.process_time() - began
        growth = 0 if before is None else ((process_memory.status_kib("VmHWM") or 0) - before) << 10
        tally.outcomes[kind] += 1
        tally.slowest = max(tally.slowest, seconds)
        tally.growth = max(tally.growth, growth)
        bound = declared.bound(case.data, self._readers[reader].per_pixel)
        tally.share_of_bound = max(tally.share_of_bound, growth / bound)
        if problem is None and growth > bound:
            problem = f"memory: {growth >> 20} MiB, where {bound >> 20} MiB are allowed"
        return self._written() or self._log.problem() or problem

    def _written(self) -> str | None:
        sys.stdout.flush()
        sys.stderr.flush()
        if os.lseek(1, 0, os.SEEK_CUR) == 0:
            return None
        self._output.seek(0)
        text = self._output.read(4000).decode("utf-8", "backslashreplace")
        self._output.seek(0)
        self._output.truncate()
        return f"output: {text}"


class _Kept(logging.Handler):
    """Keeps warnings, to look at their words."""

    def __init__(self) -> None:
        super().__init__()
        self.records: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record.getMessage())

    def problem(self) -> str | None:
        for message in self.records:
            if (wrong := _wrong_with(message)) is not None:
                return f"log message {wrong}: {message[:500]!r}"
        return None


def outcome(read: Any, folder: Path, file: Path) -> tuple[str, str | None]:
    """What a reader came to, and what is wrong with that."""
    try:
        read()
    except (InputError, OSError) as error:
        message = str(error)
        wrong = _wrong_with(message)
        if wrong is None and file.name not in message and str(folder) not in message:
            wrong = "does not name the file"
        if wrong is None:
            return "refused", None
        return "refused", f"message {wrong}: {type(error).__name__}: {message[:500]!r}"
    except AssertionError as error:
        return "wrong answer", f"wrong answer: {error or _where(error)}"
    except BaseException as error:
        kind = type(error).__name__
        return kind, f"{kind} at {_where(error)}: {str(error)[:500]!r}"
    return "answer", None


def _wrong_with(message: str) -> str | None:
    if not message.isprintable():
        return "is not one printable line"
    if len(message) > LONGEST_MESSAGE:
        return f"has {len(message)} characters"
    return None


def _where(error: BaseException) -> str:
    """The last place in our code that an error went through."""
    place, trace = "?", error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        if "pbrfit" in code.co_filename or "fuzz/readers" in code.co_filename:
            place = f"{Path(code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _limit_address_space() -> None:
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + ADDRESS_SPACE
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
