"""Tasks for tests of `evaluation.jobs`, in a file that worker processes can import; and records."""

from __future__ import annotations

import os
import time
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit.model.geometry import angles_between, positions
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw, make_scene
from pbrfit.synthetic.geometry import trace
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.suite import Results


@dataclass(frozen=True)
class Task:
    """Writes its name into a folder, then does as it is told."""

    key: str
    folder: Path
    act: str = "well"


def work(task: Task, threads: int) -> dict[str, Any]:
    """Leave the process id of every attempt, then end in one of several ways."""
    trace = task.folder / f"{task.key}.trace"
    with trace.open("a", encoding="utf-8") as file:
        file.write(f"{os.getpid()}\n")
    attempt = len(trace.read_text("utf-8").splitlines())
    if task.act == "raise":
        raise ValueError("two\nlines")
    if task.act == "die":
        os._exit(7)
    if task.act == "interrupt":
        raise KeyboardInterrupt
    if task.act == "last":
        time.sleep(600)
    if task.act == "last at first" and attempt == 1:
        time.sleep(2)  # no longer: before Python 3.12 a death may show only when another task ends
    if task.act == "no pickle":
        return {"name": (name for name in [task.key])}
    if task.act == "no pickle raised":

        class StrangeError(Exception):
            pass

        raise StrangeError("as it is")
    if task.act == "no JSON":
        return {"name": {task.key}}
    return {"name": task.key, "threads": threads}


def recorded(*pairs: tuple[Any, Mapping[str, Any] | str], **options: Any) -> Results[Any]:
    """Cases with what they found, or the error they ended in, as a suite gets them."""
    records = [
        Record(case.key, None, found, 1.0)
        if isinstance(found, str)
        else Record(case.key, found, None, 1.0)
        for case, found in pairs
    ]
    cases = [case for case, _ in pairs]
    return Results(Namespace(**options), list(zip(cases, records, strict=True)))


def own_room(case: Any, _: int) -> Scene:
    """Stand in for a room of Cycles: one of our renderer, with its depth."""
    [stream] = np.random.SeedSequence(case.seed).spawn(1)
    of = draw("furnished", np.random.default_rng(stream))
    count = case.lights
    made = make_scene("furnished", size=case.size, lights=count, held_out=count, seed=case.seed)
    rays = -made.views.reshape(-1, 3)
    distance = trace(of.primitives, of.eye, rays @ of.turn.T).distance.reshape(made.valid.shape)
    return replace(made, depth=distance * made.views[..., 2])


def depth_off(found: Any, true: Any, valid: Any) -> float:
    """Mean relative error of depth over valid pixels, after the best common factor (a median)."""
    ratio = (found / true)[valid]
    return float(np.nanmean(np.abs(ratio / np.nanmedian(ratio) - 1)))


def normals_off(depth: Any, normals: Any, fov: float, valid: Any) -> float:
    """Median angle in degrees between the normals of a depth map and given ones."""
    points = positions(depth, fov)
    across = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    with np.errstate(invalid="ignore"):
        facing = -across / np.linalg.norm(across, axis=-1, keepdims=True)
    return float(np.nanmedian(angles_between(facing, normals)[valid]))
