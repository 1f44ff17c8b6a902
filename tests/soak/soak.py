"""Thousands of small scenes, one after the other: what a process gathers that it should not.

    python tests/soak/soak.py [--scenes 2000] [--jobs 0]

Each scene is a folder of files: read, fitted, written, read back. `--jobs 0` does all in this
process; `--jobs J` in the J processes of the pool that `pbrfit evaluate` uses, whose parent and
workers are watched alike. Watched are resident memory, open files, threads, and what is left in
temporary and output folders. After a warm-up memory grows by at most `SLOPE` a scene, else nothing.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import os
import re
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit import Result, Scene, decompose
from pbrfit.batch import process_memory
from pbrfit.synthetic import make_scene

SIZE, LIGHTS = 8, 3
DIFFERENT = 8
"""Scenes, which take turns."""

WARM_UP = 100
"""Scenes after which a process has all that it needs; of fewer than twice as many, half of them."""

SLOPE = 10e3
"""Bytes a scene."""

FILES_SLACK = 2
"""Open files of a watched process at its end, more than after the warm-up; threads may be none."""


@dataclass(frozen=True)
class State:
    """A process after so many scenes."""

    process: int
    scenes: int
    resident: int
    files: int
    threads: int


def state(scenes: int) -> State:
    """This process, as Linux tells it."""
    [threads] = re.findall(r"Threads:\s+(\d+)", Path("/proc/self/status").read_text())
    files = len(list(Path("/proc/self/fd").iterdir()))
    resident = (process_memory.status_kib("VmRSS") or 0) << 10
    return State(os.getpid(), scenes, resident, files, int(threads))


@dataclass(frozen=True)
class Task:
    """A scene to be done, for the pool."""

    number: int
    folder: str

    @property
    def key(self) -> str:
        return f"{self.number:05d}"


def do(task: Task, threads: int) -> dict[str, Any]:
    """Read, fit, write and read back; the state of this process."""
    folder = Path(task.folder)
    scene = Scene.load(folder / "scenes" / str(task.number % DIFFERENT))
    result = decompose(scene, iterations=10, threads=threads)
    out = folder / "out" / str(os.getpid())
    result.save(out, scene=scene, overwrite=True)
    again = Result.load(out)
    assert np.array_equal(again.lighting, result.lighting)
    del scene, result, again
    gc.collect()
    return asdict(state(task.number))


def faults(states: Sequence[State]) -> list[str]:
    """What one process gathered, after its warm-up."""
    later = states[min(WARM_UP, len(states) // 2) :]
    grown = np.polyfit(np.arange(len(later)), [s.resident for s in later], 1)[0]
    first, last = later[0], later[-1]
    print(
        f"process {last.process}: {len(states)} scenes, memory {first.resident / 2**20:.1f} MiB "
        f"after the warm-up, {last.resident / 2**20:.1f} MiB at the end, at most "
        f"{max(s.resident for s in later) / 2**20:.1f} MiB, slope {grown:+.0f} bytes a scene; "
        f"files {first.files} to {last.files}, threads {first.threads} to {last.threads}"
    )
    found = [] if grown <= SLOPE else [f"memory grows by {grown:.0f} bytes a scene"]
    if last.files > first.files + FILES_SLACK:
        found.append(f"open files grow from {first.files} to {last.files}")
    if last.threads > first.threads:
        found.append(f"threads grow from {first.threads} to {last.threads}")
    return found


def temporaries() -> set[str]:
    """What is in the system's folder for temporary files, of ours and of Python's pools."""
    names = ("pbrfit", "pymp-", "tmp")
    return {p.name for p in Path(tempfile.gettempdir()).iterdir() if p.name.startswith(names)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=0, help="0: in this process")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        folder = Path(name)
        for number in range(DIFFERENT):
            scene = make_scene("furnished", size=SIZE, lights=LIGHTS, seed=number, noise=0.01)
            scene.save(folder / "scenes" / str(number))
        tasks = [Task(number, name) for number in range(options.scenes)]
        before = temporaries()
        states: list[State] = []
        if options.jobs:
            from pbrfit_evaluation import jobs

            parent: list[State] = []

            def watch(record: jobs.Record) -> None:
                assert record.error is None, record.error
                parent.append(state(len(parent)))

            for record in jobs.run(tasks, do, folder, jobs=options.jobs, progress=watch):
                assert record.values is not None
                states.append(State(**record.values))
            states += parent
        else:
            states = [State(**do(task, 0)) for task in tasks]
        found = []
        for process in sorted({s.process for s in states}):
            found += faults([s for s in states if s.process == process])
        left = temporaries() - before
        ours = {path.name for path in folder.rglob(".pbrfit*")}
        found += [f"left behind: {name}" for name in sorted(left | ours)]
        found += [f"still there: {child}" for child in multiprocessing.active_children()]
    print("; ".join(found) or "nothing gathered, nothing left behind")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
