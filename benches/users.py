"""What a user waits for: `make bench-users`, which leaves its table in docs/evidence/users.json.

Photographs as cameras make them, and renders: each case is a scene folder, one run of the command
in a process of its own, and beside it, in the same run, decoding alone by Pillow (EXR: by pbrfit)
on all processors, and least squares of matt surfaces under known light in numpy on the pixels that
were fitted. Scenes are 512² rendered pixels, each repeated, with noise of their own.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from growth import BASE, GIB, NOISE, SEED, enlarged, larger, run
from pbrfit.io import images
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import render_lamps
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.report import evidence, markdown
from pbrfit_evaluation.suite import Table, Value


@dataclass(frozen=True)
class Case:
    """So many pictures, `BASE * repeated` pixels along a side, and the size they are fitted in."""

    name: str
    pictures: int
    repeated: int
    max_size: int | None = None
    lamps: bool = True


CASES = (
    Case("12 JPEG of 13 MP, a lamp each, at 1024", 12, 7, 1024),
    Case("12 JPEG of 13 MP, a lamp each, at 2048", 12, 7, 2048),
    Case("60 JPEG of 6 MP, a lamp each, at 1024", 60, 5, 1024),
    Case("16 EXR of 2 MP, environments", 16, 3, lamps=False),
)


def main() -> None:
    """Measure all cases, and fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases, from 0")
    options = parser.parse_args()
    columns = ["", "time, s", "outside the fit, s", "processors, s", "peak, GiB"]
    columns += ["decoding alone, s", "matt least squares, s"]
    lines: list[list[Value]] = []
    for number in options.only or range(len(CASES)):
        lines.append(measure(CASES[number]))
        print(markdown(Table(columns, lines[-1:])), flush=True)
    if not options.only:
        evidence.record(
            options.docs,
            "users",
            command="make bench-users",
            protocol="pbrfit-users-1: one run each of the command with its defaults",
            tables={"What users wait for": Table(columns, lines)},
        )


def measure(case: Case) -> list[Value]:
    """A line of the table."""
    with tempfile.TemporaryDirectory() as folder:
        scene, result = Path(folder) / "scene", Path(folder) / "result"
        paths = of_lamps(case, scene) if case.lamps else of_environments(case, scene)
        alone = decoding(paths)
        size = case.max_size or BASE * case.repeated
        shorter = least_squares(case, size * size)
        asked = ["--max-size", str(case.max_size)] if case.max_size else []
        found = run([scene, *asked], result)
    outside = found["seconds"] - found["seconds_of_fit"]
    return [
        case.name,
        *(found["seconds"], outside, found["processor_seconds"], found["peak_bytes"] / GIB),
        *(alone, shorter),
    ]


def of_lamps(case: Case, folder: Path) -> list[Path]:
    """Loose photographs of things under one far lamp each, in sRGB; nothing else is given."""
    small = make_scene("furnished", size=BASE, lights=3, held_out=1, seed=SEED)
    assert small.truth is not None
    rng = np.random.default_rng(SEED)
    places = rng.normal(size=(case.pictures, 3)) * (0.5, 0.5, 0.0) + (0, 0, 1)
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    lamps = Lamps(np.arange(case.pictures), places, colors=np.ones((case.pictures, 3)))
    shown = render_lamps(small.truth.materials, small.normals, lamps, None, fov=small.fov)
    shown *= 0.25 / shown[:, small.valid].mean()
    folder.mkdir()
    paths = []
    for number, image in enumerate(shown):
        large = larger(np.nan_to_num(image).astype(np.float32), case.repeated)
        large += NOISE * rng.standard_normal(large.shape, dtype=np.float32)
        bytes_ = (255 * np.clip(large, 0, 1) ** (1 / 2.2) + 0.5).astype(np.uint8)
        paths.append(folder / f"{number:02}.jpg")
        Image.fromarray(bytes_).save(paths[-1], quality=92)
    return paths


def of_environments(case: Case, folder: Path) -> list[Path]:
    """Renders in float EXR with their normals."""
    enlarged(case.repeated, case.pictures).save(folder)
    return sorted((folder / "images").iterdir())


def decoding(paths: list[Path]) -> float:
    """Seconds of decoding all pictures, one at a time for each processor."""

    def decode(path: Path) -> None:
        if path.suffix == ".exr":
            images.read_channels(path)
            return
        with Image.open(path) as picture:
            picture.load()

    began = time.perf_counter()
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        list(pool.map(decode, paths))
    return time.perf_counter() - began


def least_squares(case: Case, pixels: int) -> float:
    """Seconds of albedo times normal (three numbers a pixel and channel), or of nine for SH."""
    rng = np.random.default_rng(SEED)
    unknowns = 3 if case.lamps else 9
    light = rng.normal(size=(case.pictures, unknowns)).astype(np.float32)
    samples: NDArray[Any] = np.ones((case.pictures, 3 * pixels), np.float32)
    began = time.perf_counter()
    np.linalg.pinv(light) @ samples
    return time.perf_counter() - began


if __name__ == "__main__":
    main()
