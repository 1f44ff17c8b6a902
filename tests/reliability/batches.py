"""Batches of small scenes as processes of their own, and what they leave."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.input_files import digest
from pbrfit.result.result import FILES, Result
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene

SIZE, LIGHTS = 16, 4

SAME = ("materials.exr", "lighting.json")
"""Files of a result that are the same bits whenever and wherever it is made."""

DYING = Path(__file__).with_name("dying.py")

PATIENCE = 300.0
"""Seconds after which something hangs."""

Content = tuple[str, ...]
Mark = tuple[int, int]


def make_versions(folder: Path, scenes: int, versions: int) -> list[list[Path]]:
    """Scene folders by scene and version; the same for every call."""
    made = []
    for number in range(scenes):
        row = [folder / f"scene-{number}-version-{version}" for version in range(versions)]
        for version, path in enumerate(row):
            make_scene(
                "furnished", size=SIZE, lights=LIGHTS, seed=number, noise=0.01 * (1 + version)
            ).save(path)
        made.append(row)
    return made


def tiled_scene(folder: Path, size: int, lights: int, tile: int = 250) -> Path:
    """A scene folder of `size`² pixels, the same room of `tile`² again and again."""
    room = make_scene("furnished", size=tile, lights=lights, held_out=1)
    times = -(-size // tile)
    assert room.segments is not None

    def tiled(plane: NDArray[Any]) -> NDArray[Any]:
        return np.tile(plane, (times, times, 1))[:size, :size]

    Scene(
        images=np.stack([tiled(image) for image in room.images]).astype(np.float32),
        normals=tiled(room.normals),
        segments=tiled(room.segments[..., None])[..., 0],
        fov=room.fov,
    ).save(folder)
    return folder


def put_version(scene: Path, version: Path) -> None:
    """Let a scene be as it is in this version."""
    shutil.rmtree(scene, ignore_errors=True)
    shutil.copytree(version, scene)


def started(arguments: Sequence[object], **how: Any) -> subprocess.Popen[str]:
    """The command as the leader of a session of its own."""
    program = how.pop("program", ["-m", "pbrfit"])
    return subprocess.Popen(
        [sys.executable, *map(str, program), *map(str, arguments)],
        text=True,
        start_new_session=True,
        **how,
    )


def ended(arguments: Sequence[object], **how: Any) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the command."""
    process = started(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **how)
    out, errors = process.communicate(timeout=PATIENCE)
    return process.returncode, out, errors


def of_session(leader: int) -> list[int]:
    """Processes of a session that run, as Linux tells; one that waits for its parent does not."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            status = (folder / "stat").read_text().rpartition(")")[2].split()
        except (OSError, ValueError):
            continue
        if folder.name.isdigit() and int(status[3]) == leader and status[0] not in "ZX":
            found.append(int(folder.name))
    return found


def seconds_until(condition: Callable[[], bool], patience: float = PATIENCE) -> float:
    """How long it takes."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < patience, "it did not happen"
        time.sleep(0.005)
    return time.monotonic() - began


def content(result: Path) -> Content:
    """What is the same for every run of a scene."""
    return tuple(digest(result / name) for name in SAME)


def mark(result: Path) -> Mark:
    """By which it shows whether a result was written again."""
    found = (result / "result.json").stat()
    return found.st_ino, found.st_mtime_ns


def faults_of(result: Path) -> list[str]:
    """Why a result is not whole."""
    try:
        told = json.loads((result / "result.json").read_text(encoding="utf-8"))["files"]
        wrong = [name for name in FILES if told[name] != digest(result / name)]
        Result.load(result)
    except Exception as error:
        return [f"{result.name}: {type(error).__name__}: {error}"]
    return [f"{result.name}: {name} is not what was written" for name in wrong]


def statuses(text: str) -> list[tuple[str, str]]:
    """(scene, status) of the lines of JSON that are whole."""
    found = []
    for line in text.splitlines(keepends=True):
        if line.endswith("\n"):
            told: Mapping[str, Any] = json.loads(line)
            found.append((Path(told["scene"]).name, str(told["status"])))
    return found


def environment(temporary: Path, **more: object) -> dict[str, str]:
    """Of a process whose temporary files go to this folder."""
    return {**os.environ, "TMPDIR": str(temporary), **{k: str(v) for k, v in more.items()}}
