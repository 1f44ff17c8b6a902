"""Ctrl-C at random times, of every command on a large scene: how long it takes, what is left.

    python tests/limits/interrupts.py [--times 5] [--size 1000] [--seed 0] [--only NAME] [--json F]

Each command runs once undisturbed, which tells how long it takes. Then it is started again and
again and told to end at a random time: of each `--times` equal parts of its run, one. Counted are
the seconds from the signal to the end of the process, its exit code, and what is left on disk.
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
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pbrfit.cli import main as command
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene

LIGHTS = 8
TILE = 250
"""Pixels of the room that is repeated."""

LONGEST = 50.0
"""Seconds of a command's run in which it is interrupted."""

ALLOWED = 1.0
"""Seconds."""

NOT_STARTED = "init_import_site"
"""What Python says, with exit code 1, where it is interrupted before it has started."""

ENDED = {128 + signal.SIGINT: "130", -signal.SIGINT: "by the signal", 0: "done before"}
"""Python ends itself by the signal while the command's modules are not loaded yet."""


@dataclass(frozen=True)
class Shot:
    """One interruption."""

    command: str
    at: float
    latency: float
    code: int
    stderr: str
    left: list[str]

    @property
    def faults(self) -> list[str]:
        """What is not as it has to be."""
        found = [] if self.latency < ALLOWED else [f"{self.latency:.2f} s"]
        if self.code not in ENDED and NOT_STARTED not in self.stderr:
            found.append(f"exit code {self.code}: {self.stderr}")
        return found + self.left


def large_scene(folder: Path, size: int) -> Path:
    """A scene of `size`², the same room again and again."""
    room = make_scene("furnished", size=TILE, lights=LIGHTS, held_out=1)
    times = -(-size // TILE)

    def tiled(plane: np.ndarray) -> np.ndarray:
        return np.tile(plane, (times, times, 1))[:size, :size]

    assert room.segments is not None
    scene = Scene(
        images=np.stack([tiled(image) for image in room.images]).astype(np.float32),
        normals=tiled(room.normals),
        segments=tiled(room.segments[..., None])[..., 0],
        fov=room.fov,
    )
    scene.save(folder / "scene")
    return folder / "scene"


def commands(scene: Path, result: Path, size: int, out: Path) -> dict[str, list[str]]:
    """Arguments by name; all write to `out` if they write."""
    s, r, o = str(scene), str(result), str(out)
    fit = ["decompose", s, "--out", o]
    short = [*fit, "--time-limit", "15"]  # with what comes before and after the fit
    return {
        "decompose": fit,
        "decompose, short": short,
        "decompose, replacing": [*short, "--overwrite"],
        "decompose lbfgsb": [*short, "--solver", "lbfgsb"],
        "decompose gauss-newton": [*short, "--solver", "gauss-newton"],
        "decompose, normals": [*short, "--refine-normals", "on"],
        "decompose, huber": [*short, "--robust", "huber"],
        "inspect": ["inspect", s],
        "synth": ["synth", o, "--size", str(size), "--lights", str(LIGHTS)],
        "export": ["export", r, "--out", o],
        "report": ["report", r, "--out", f"{o}.html"],
        "relight": ["relight", r, "--light", "30,20", "--out", f"{o}.exr"],
        "turntable": ["relight", r, "--light", "30,20", "--turntable", "8", "--out", f"{o}.gif"],
        "check-gradients": ["check-gradients", s],
        "demo": ["demo", o, "--size", str(size // 4)],
        "evaluate": ["evaluate", "ablation", "--out", o, "--jobs", "2"],
    }


def started(arguments: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pbrfit", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def content(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def interrupted(name: str, arguments: list[str], at: float, place: Path, whole: set[str]) -> Shot:
    """Run a command whose output goes to a folder of its own, and tell it to end.

    `whole` is what is there when it ends undisturbed: all of that may be there, or nothing new.
    """
    before = content(place)
    process = started(arguments)
    try:
        process.wait(at)
        latency, stderr = 0.0, process.communicate()[1]
    except subprocess.TimeoutExpired:
        sent = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        process.wait(60)
        latency = time.monotonic() - sent
        # Workers share the pipe: read by now or never.
        stderr = process.communicate(timeout=60)[1]
    found = content(place)
    left = [] if found in (before, whole) else sorted(found ^ before)
    if arguments[0] == "evaluate":  # keeps what is done, to go on from
        left = [path for path in left if ".pbrfit" in path or path.endswith(".part")]
    return Shot(name, at, latency, process.returncode, stderr.strip(), left)


def shots(options: argparse.Namespace, folder: Path) -> Iterator[Shot]:
    """All interruptions, one after the other."""
    chance = random.Random(options.seed)
    scene = large_scene(folder, options.size)
    result = folder / "result"
    few = ["--iterations", "2", "--solver", "lbfgsb", "--quiet"]
    assert command(["decompose", str(scene), "--out", str(result), *few]) == 0
    for name, arguments in commands(scene, result, options.size, folder / "place" / "out").items():
        if options.only and options.only not in name:
            continue
        place = folder / "place"
        fresh(place, result, name)
        began = time.monotonic()
        process = started(arguments)
        try:
            process.communicate(timeout=LONGEST)
            assert process.returncode == 0, (name, process.returncode)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGTERM)
            process.communicate()
        seconds, whole = time.monotonic() - began, content(place)
        for number in range(options.times):
            fresh(place, result, name)
            at = seconds * (number + chance.random()) / options.times
            yield interrupted(name, arguments, at, place, whole)


def fresh(place: Path, result: Path, name: str) -> None:
    """An empty place, or one with an earlier result to replace."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    if "replacing" in name:
        shutil.copytree(result, place / "out")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=5, help="interruptions of each command")
    parser.add_argument("--size", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="commands whose name holds this")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found: list[Shot] = []
    with tempfile.TemporaryDirectory() as folder:
        for shot in shots(options, Path(folder)):
            found.append(shot)
            how = ENDED.get(shot.code, str(shot.code))
            said = "; ".join(shot.faults) or "ok"
            print(f"{shot.command:24} {shot.at:7.2f} s  {shot.latency:5.2f} s  {how}: {said}")
            sys.stdout.flush()
    told = [shot for shot in found if shot.code != 0]
    worst = max(told, key=lambda shot: shot.latency)
    bad = [shot for shot in found if shot.faults]
    median = sorted(shot.latency for shot in told)[len(told) // 2]
    print(
        f"{len(told)} interruptions, latency median {median:.2f} s, at most {worst.latency:.2f} s "
        f"({worst.command} at {worst.at:.1f} s); {len(bad)} not as they should be"
    )
    if options.json:
        options.json.write_text(json.dumps([asdict(shot) for shot in found], indent=1))
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
