"""Workers watched: cases handed out, deaths put down to the case that was under way."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any

from fuzz import worker
from fuzz.cases import Plan
from fuzz.worker import Tally

BLOCK = 200
"""Cases that are handed out at a time."""

SILENCE = 60.0
"""Seconds without a new case after which a worker is held to hang without computing."""

Failed = Callable[[str, int, str], None]


@dataclass
class _Worker:
    process: Any
    connection: Any
    at: Any
    block: tuple[str, int, int] | None = None
    seen: tuple[int, float] = (-1, 0.0)


def run(
    plans: Mapping[str, Plan], jobs: int, failed: Failed, ended: Callable[[int], object]
) -> dict[str, Tally]:
    """Run all cases in `jobs` processes; what came of them, by reader.

    `failed` is called with reader, number and what was wrong, `ended` with how many cases ended.
    """
    context = multiprocessing.get_context("spawn")
    blocks = [
        (name, first, min(first + BLOCK, plan.count))
        for name, plan in plans.items()
        for first in range(0, plan.count, BLOCK)
    ]
    blocks.reverse()
    tallies = {name: Tally() for name in plans}
    workers: list[_Worker] = []

    def start() -> _Worker:
        ours, theirs = context.Pipe()
        at = context.Value("q", -1, lock=False)
        process = context.Process(target=worker.main, args=(theirs, at, plans), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours, at)

    def give(one: _Worker) -> None:
        one.block = blocks.pop() if blocks else None
        one.at.value = -1
        one.seen = (-1, time.monotonic())
        one.connection.send(one.block)

    def died(one: _Worker) -> None:
        one.process.join()
        assert one.block is not None
        name, first, last = one.block
        number = one.at.value
        if number < first:
            raise RuntimeError(f"a worker died before its first case: {one.process.exitcode}")
        failed(name, number, _cause(one.process.exitcode))
        tallies[name].outcomes["death"] += 1
        ended(number + 1 - first)
        if number + 1 < last:
            blocks.append((name, number + 1, last))

    try:
        for _ in range(max(1, min(jobs, len(blocks)))):
            workers.append(start())
            give(workers[-1])
        while workers:
            ready = wait([one.connection for one in workers], timeout=1.0)
            for one in list(workers):
                if one.connection in ready:
                    try:
                        answer = one.connection.recv()
                    except (EOFError, ConnectionResetError):
                        died(one)
                        workers.remove(one)
                        if blocks:
                            workers.append(start())
                            give(workers[-1])
                        continue
                    assert one.block is not None
                    name, first, last = one.block
                    if answer[0] == "broken":
                        raise RuntimeError(answer[1])
                    if answer[0] == "failed":
                        failed(name, answer[1], answer[2])
                        continue
                    tallies[name].add(answer[1])
                    ended(last - first)
                    give(one)
                    if one.block is None:
                        one.process.join()
                        workers.remove(one)
                    continue
                number, since = one.seen
                if one.at.value != number:
                    one.seen = (one.at.value, time.monotonic())
                elif time.monotonic() - since > SILENCE:
                    one.process.kill()
    finally:
        for one in workers:
            one.process.kill()
    return tallies


def _cause(exitcode: int) -> str:
    if exitcode == -signal.SIGPROF:
        return f"hang: more than {worker.SECONDS:g} s of processor time"
    if exitcode == -signal.SIGKILL:
        return f"hang, or out of memory: killed, perhaps after {SILENCE:g} s of silence"
    if exitcode < 0:
        return f"crash: {signal.Signals(-exitcode).name}"
    return f"crash: exit code {exitcode}"
