"""Part "memory": the peak of a fit, in units of the bytes that the pictures alone have.

Each fit has a process of its own, in which libraries are loaded and threads awake before anything
is counted. From then on all counts: the pictures themselves, and what the fit makes of them.
"""

from __future__ import annotations

import gc
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit.batch import process_memory
from pbrfit.io.output import scratch_folder
from pbrfit.model.reflection import DEFAULT_MODEL, render
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw
from pbrfit.synthetic.exposure import MEAN_RADIANCE
from pbrfit.synthetic.lights import random_lights
from pbrfit_evaluation.solvers.fits import (
    AUTO,
    FIRST_SEED,
    GAUSS_NEWTON,
    LBFGSB,
    PICTURES,
    Name,
    fit,
    room,
)
from pbrfit_evaluation.solvers.own_process import call

SOLVERS: tuple[Name, ...] = (GAUSS_NEWTON, AUTO, LBFGSB)
BARS: dict[Name, float] = {GAUSS_NEWTON: 4.0, AUTO: 8.0}
"""Largest peak over the pictures' bytes."""

LARGE_BYTES = 8 * 2**30
"""What 4 million pixels may take."""

REHEARSAL_SIZE = 32
ITERATIONS = 60
"""Enough to go through every stage of a fit; memory does not grow with more."""


@dataclass(frozen=True)
class Task:
    """A fit whose memory is measured."""

    solver: Name
    size: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"memory_{self.solver}_{self.size}"

    @property
    def picture_bytes(self) -> int:
        """Of the pictures in float32."""
        return PICTURES * self.size**2 * 12


def plan(sizes: tuple[int, ...]) -> list[Task]:
    """Every solver at every size."""
    return [Task(solver, size) for size in sizes for solver in SOLVERS]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Bytes at the peak over those before the pictures are there; None where nothing tells."""
    with scratch_folder() as folder:
        path = folder / "scene.npz"
        call(write_scene, path, task.size, threads)
        peak, seconds = call(peak_of_fit, path, task.solver, threads)
    return {"peak": peak, "seconds": seconds, "pictures": task.picture_bytes}


def write_scene(path: Path, size: int, threads: int) -> None:
    """Keep a room's pictures and normals in float32, rendered one by one."""
    seed = np.random.default_rng(FIRST_SEED)
    view = draw("furnished", seed).cast(size)
    lights = random_lights(PICTURES, seed)
    images = np.empty((PICTURES, size, size, 3), dtype=np.float32)
    for image, light in zip(images, lights, strict=True):
        found = render(
            *(view.materials, view.normals, light, view.fov, threads), model=DEFAULT_MODEL
        )
        image[:] = found * (MEAN_RADIANCE / found.mean())
    np.savez(
        path,
        images=images,
        normals=view.normals.astype(np.float32),
        segments=view.segments,
        fov=view.fov,
    )


def peak_of_fit(path: Path, solver: Name, threads: int) -> tuple[int | None, float]:
    """Bytes that a fit adds to the process at its peak, and its seconds."""
    fit(room(0, REHEARSAL_SIZE, held_out=1), solver, iterations=ITERATIONS, threads=threads)
    gc.collect()
    before = process_memory.resident_kib()
    forgotten = process_memory.forget_peak()
    with np.load(path) as kept:
        scene = Scene(
            images=kept["images"],
            normals=kept["normals"],
            segments=kept["segments"],
            fov=float(kept["fov"]),
        )
    result = fit(scene, solver, iterations=ITERATIONS, threads=threads)
    peak = process_memory.peak_kib()
    if before is None or peak is None or not forgotten:
        return None, result.seconds
    return 1024 * (peak - before), result.seconds
