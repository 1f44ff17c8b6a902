"""Ctrl-C and SIGTERM at random times of a batch: how long until all its processes are gone.

    python tests/reliability/signals.py [--times 12] [--scenes 8] [--seed 0] [--json FILE]

`pbrfit decompose SCENES --out OUT` with one job and with two, into an empty folder and replacing
results, told to end by either signal, sent to all its processes, as a terminal does, or to the
first alone: `--times` each of these 16 ways, each time in another part of its run. Counted are the
seconds until no process is left, the exit code, and what is on disk then: whole results and
nothing else, and of results that were to be replaced none is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

from batches import (
    PATIENCE,
    ended,
    environment,
    faults_of,
    make_versions,
    of_session,
    seconds_until,
    started,
)

OPTIONS = ("--iterations", "150", "--json", "--quiet")

ALLOWED = 1.0
"""Seconds."""

NOT_STARTED = "init_import_site"
"""What Python says, with exit code 1, where it is interrupted before it has started."""


@dataclass(frozen=True)
class Shot:
    """One signal."""

    signal: str
    to: str
    jobs: int
    replacing: bool
    at: float
    latency: float
    code: int
    errors: str
    faults: list[str]


def one(
    folder: Path, number: signal.Signals, to: str, jobs: int, at: float, *, replacing: bool
) -> Shot:
    """Start a batch, tell it to end, and look."""
    out, temporary = folder / "out", folder / "tmp"
    for path in (out, temporary):
        shutil.rmtree(path, ignore_errors=True)
    temporary.mkdir()
    arguments = ["decompose", folder / "scenes", "--out", out, *OPTIONS, "--jobs", jobs]
    if replacing:
        shutil.copytree(folder / "results", out)
        arguments.append("--overwrite")
    batch = started(
        arguments,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=environment(temporary),
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        batch.wait(at)
    except subprocess.TimeoutExpired:
        sent = time.monotonic()
        if to == "all":
            os.killpg(batch.pid, number)
        else:
            batch.send_signal(number)
        batch.wait(PATIENCE)
        seconds_until(lambda: not of_session(batch.pid))
        latency = time.monotonic() - sent
    else:
        latency = 0.0
    _, errors = batch.communicate(timeout=PATIENCE)
    faults = [] if latency < ALLOWED else [f"{latency:.2f} s"]
    early = batch.returncode == -number or NOT_STARTED in errors  # by Python, not yet by us
    if batch.returncode not in (0, 128 + number) and not early:
        faults.append(f"exit code {batch.returncode}: {errors}")
    if len(errors.splitlines()) != 1 and batch.returncode == 128 + number:
        faults.append(f"more than a line: {errors}")
    names = {path.name for path in (folder / "scenes").iterdir()}
    found = {path.name for path in out.iterdir()} if out.exists() else set()
    if out.exists() and not found:
        faults.append("an empty folder")
    faults += [f"left behind: {name}" for name in sorted(found - names)]
    faults += [f"left behind: {path}" for path in temporary.iterdir()]
    for name in sorted(found & names):
        faults += faults_of(out / name)
    if replacing:
        faults += [f"lost: {name}" for name in sorted(names - found)]
    return Shot(
        number.name, to, jobs, replacing, at, latency, batch.returncode, errors.strip(), faults
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=12)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    shots: list[Shot] = []
    with tempfile.TemporaryDirectory(prefix="signals-") as name:
        folder = Path(name)
        make_versions(folder / "scenes", options.scenes, 1)
        seconds = {}
        for jobs in (1, 2):
            shutil.rmtree(folder / "results", ignore_errors=True)
            began = time.monotonic()
            out = folder / "results"
            code, _, errors = ended(
                ["decompose", folder / "scenes", "--out", out, *OPTIONS, "--jobs", jobs]
            )
            assert code == 0, errors
            seconds[jobs] = time.monotonic() - began
        ways = product((signal.SIGINT, signal.SIGTERM), ("all", "first"), (1, 2), (False, True))
        for number, to, jobs, replacing in ways:
            for time_of_run in range(options.times):
                at = seconds[jobs] * (time_of_run + chance.random()) / options.times
                shot = one(folder, number, to, jobs, at, replacing=replacing)
                shots.append(shot)
                print(
                    f"{shot.signal:7} to {to:5}  {jobs} jobs  {at:5.2f} s  {shot.latency:5.2f} s  "
                    f"{shot.code:4}: {'; '.join(shot.faults) or 'ok'}",
                    flush=True,
                )
    told = [shot for shot in shots if shot.code != 0]
    for key in sorted({(shot.signal, shot.jobs) for shot in told}):
        these = [shot for shot in told if (shot.signal, shot.jobs) == key]
        latencies = sorted(shot.latency for shot in these)
        codes = Counter(shot.code for shot in these)
        print(
            f"{key[0]}, {key[1]} jobs: {len(these)}, latency median "
            f"{latencies[len(these) // 2]:.2f} s, at most {latencies[-1]:.2f} s, exit codes "
            + ", ".join(f"{code} ({n})" for code, n in codes.most_common())
        )
    bad = [shot for shot in shots if shot.faults]
    print(f"{len(bad)} not as they should be")
    if options.json:
        options.json.write_text(json.dumps([asdict(shot) for shot in shots], indent=1))
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
