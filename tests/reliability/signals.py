"""Ctrl-C and SIGTERM at random times: how long until all processes are gone, and what is left.

    python tests/reliability/signals.py batches [--times 12] [--seed 0] [--only NAME] [--json FILE]
    python tests/reliability/signals.py commands [--times 5] [--size 1000] ...

`batches` is `pbrfit decompose SCENES --out OUT` with one job and with two, into an empty folder and
replacing results, told to end by either signal, sent to all its processes, as a terminal does, or
to the first alone. `commands` is every command on a large scene, told to end by Ctrl-C. Each way
runs once undisturbed, which tells how long it takes, and is then told to end `--times` times, each
time in another part of its run. Counted are the seconds until no process is left, the exit code,
and what is on disk then: whole results and nothing else, and of what was to be replaced none is
missing.
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
from collections.abc import Callable, Iterator
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
    tiled_scene,
)

SCENES, LIGHTS = 8, 8

LONGEST = 50.0
"""Seconds of a command's run in which it is told to end."""

ALLOWED = 1.0
"""Seconds."""

NOT_STARTED = "init_import_site"
"""What Python says, with exit code 1, where it is interrupted before it has started."""


@dataclass(frozen=True)
class Way:
    """A command that writes to `out` in a place of its own, and how it is told to end.

    `faults` says what is wrong with what is left in the place; `earlier` is there to be replaced.
    """

    name: str
    arguments: list[object]
    faults: Callable[[Path], list[str]] = lambda _: []
    number: signal.Signals = signal.SIGINT
    to: str = "all"
    earlier: Path | None = None


@dataclass(frozen=True)
class Shot:
    """A run that was told to end, or had ended before."""

    way: str
    at: float
    seconds: float
    latency: float
    code: int
    errors: str
    faults: list[str]


def content(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def shot(way: Way, place: Path, at: float) -> Shot:
    """Start it afresh in the place, tell it to end, and look."""
    shutil.rmtree(place, ignore_errors=True)
    temporary = place / "tmp"
    temporary.mkdir(parents=True)
    if way.earlier is not None:
        shutil.copytree(way.earlier, place / "out")
    began, latency = time.monotonic(), 0.0
    process = started(
        way.arguments,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=environment(temporary),
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        process.wait(at)
    except subprocess.TimeoutExpired:
        sent = time.monotonic()
        (os.killpg if way.to == "all" else os.kill)(process.pid, way.number)
        process.wait(PATIENCE)
        seconds_until(lambda: not of_session(process.pid))
        latency = time.monotonic() - sent
    seconds = time.monotonic() - began - latency
    errors, code = process.communicate(timeout=PATIENCE)[1].strip(), process.returncode
    faults = [] if latency < ALLOWED else [f"{latency:.2f} s"]
    early = code == -way.number or NOT_STARTED in errors  # by Python, not yet by us
    if code not in (0, 128 + way.number) and not early:
        faults.append(f"exit code {code}: {errors}")
    if code == 128 + way.number and len(errors.splitlines()) != 1:
        faults.append(f"more than a line: {errors}")
    faults += [f"left behind: {path}" for path in temporary.iterdir()]
    return Shot(way.name, at, seconds, latency, code, errors, faults + way.faults(place))


def batches(folder: Path, _size: int) -> Iterator[Way]:
    """All ways of a batch of small scenes."""
    scenes, results, out = folder / "scenes", folder / "results", folder / "place" / "out"
    make_versions(scenes, SCENES, 1)
    options = ["--iterations", "150", "--json", "--quiet"]
    code, _, errors = ended(["decompose", scenes, "--out", results, *options])
    assert code == 0, errors
    names = {path.name for path in scenes.iterdir()}

    def faults(_place: Path, replacing: bool) -> list[str]:
        found = {path.name for path in out.iterdir()} if out.exists() else set()
        wrong = ["an empty folder"] if out.exists() and not found else []
        wrong += [f"left behind: {name}" for name in sorted(found - names)]
        wrong += [fault for name in sorted(found & names) for fault in faults_of(out / name)]
        return wrong + [f"lost: {name}" for name in sorted(names - found) if replacing]

    ways = product((signal.SIGINT, signal.SIGTERM), ("all", "first"), (1, 2), (False, True))
    for number, to, jobs, replacing in ways:
        yield Way(
            f"{number.name} to {to}, {jobs} jobs{', replacing' if replacing else ''}",
            ["decompose", scenes, "--out", out, *options, "--jobs", jobs]
            + ["--overwrite"] * replacing,
            lambda place, replacing=replacing: faults(place, replacing),  # type: ignore[misc]
            number,
            to,
            results if replacing else None,
        )


def commands(folder: Path, size: int) -> Iterator[Way]:
    """Every command on a scene of `size`², which ends with all or nothing new in its place."""
    scene = tiled_scene(folder / "scene", size, LIGHTS)
    result, out = folder / "result", folder / "place" / "out"
    few = ["--iterations", 2, "--solver", "lbfgsb", "--quiet"]
    code, _, errors = ended(["decompose", scene, "--out", result, *few])
    assert code == 0, errors
    fit = ["decompose", scene, "--out", out]
    short = [*fit, "--time-limit", 15]  # with what comes before and after the fit
    relight = ["relight", result, "--light", "30,20"]
    for name, arguments in {
        "decompose": fit,
        "decompose, short": short,
        "decompose, replacing": [*short, "--overwrite"],
        "decompose lbfgsb": [*short, "--solver", "lbfgsb"],
        "decompose gauss-newton": [*short, "--solver", "gauss-newton"],
        "decompose, normals": [*short, "--refine-normals", "on"],
        "inspect": ["inspect", scene],
        "synth": ["synth", out, "--size", size, "--lights", LIGHTS],
        "export": ["export", result, "--out", out],
        "report": ["report", result, "--out", f"{out}.html"],
        "relight": [*relight, "--out", f"{out}.exr"],
        "turntable": [*relight, "--turntable", 8, "--out", f"{out}.gif"],
        "check-gradients": ["check-gradients", scene],
        "demo": ["demo", out, "--size", size // 4],
        "evaluate": ["evaluate", "ablation", "--out", out, "--jobs", 2],
    }.items():
        earlier = result if "--overwrite" in arguments else None
        before = set() if earlier is None else {"out", *(f"out/{p}" for p in content(result))}
        whole: list[set[str]] = []  # what is there when it ends undisturbed

        def faults(
            place: Path,
            before: set[str] = before,
            whole: list[set[str]] = whole,
            keeps: bool = name == "evaluate",  # what is done, to go on from
        ) -> list[str]:
            found = content(place) - {"tmp"}
            whole.append(found)
            left = [] if found in (before, whole[0]) else sorted(found ^ before)
            return [path for path in left if not keeps or ".pbrfit" in path or ".part" in path]

        yield Way(name, arguments, faults, earlier=earlier)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["batches", "commands"])
    parser.add_argument("--times", type=int, default=12, help="of each way")
    parser.add_argument("--size", type=int, default=1000, help="of the large scene")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="ways whose name holds this")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    shots: list[Shot] = []
    with tempfile.TemporaryDirectory(prefix="signals-") as name:
        folder = Path(name)
        ways = (batches if options.what == "batches" else commands)(folder, options.size)
        for way in ways:
            if options.only not in way.name:
                continue
            seconds = shot(way, folder / "place", LONGEST).seconds
            for number in range(options.times):
                at = seconds * (number + chance.random()) / options.times
                one = shot(way, folder / "place", at)
                shots.append(one)
                said = "; ".join(one.faults) or "ok"
                print(f"{way.name:36} {at:6.2f} s  {one.latency:5.2f} s  {one.code:4}: {said}")
                sys.stdout.flush()
    told = sorted((one for one in shots if one.code != 0), key=lambda one: one.latency)
    bad = [one for one in shots if one.faults]
    codes = ", ".join(
        f"{code} ({n})" for code, n in Counter(one.code for one in told).most_common()
    )
    print(
        f"{len(told)} told to end, latency median {told[len(told) // 2].latency:.2f} s, at most "
        f"{told[-1].latency:.2f} s ({told[-1].way} at {told[-1].at:.1f} s), exit codes {codes}; "
        f"{len(bad)} not as they should be"
    )
    if options.json:
        options.json.write_text(json.dumps([asdict(one) for one in shots], indent=1))
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
