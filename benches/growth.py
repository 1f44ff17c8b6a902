"""How time and memory of `pbrfit decompose` grow: `make bench-growth`.

It fills the table of docs/benchmarks/speed.md. Each case is a scene folder of float32 EXR and one
run of the command in a process of its own, files read and result written; `--only` names some, and
those of an earlier run are kept in out/growth.json. Scenes are a
synthetic room of 512² whose pixels are repeated, each with noise of its own, so that drawing them
takes no longer than they need to be written; 16 MP with 16 pictures take 3.2 GB on disk.
"""

from __future__ import annotations

import argparse
import io
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import pbrfit
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.report import evidence, markdown
from pbrfit_evaluation.suite import Table, Value

BASE = 512
NOISE = 0.01
SEED = 2006

CASES = (
    (1, 4), (2, 4), (4, 4), (8, 4),
    (1, 16), (2, 16), (3, 16), (4, 16), (6, 16), (8, 16),
    (1, 64), (2, 64),
)  # fmt: skip
"""(Repetitions of a pixel in each direction, pictures)."""

GIB = 2**30


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the cases that the file does not have yet, and fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/growth.json"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--again", action="store_true", help="measure all cases anew")
    parser.add_argument("--only", nargs="*", metavar="K,N", help="cases to measure")
    options = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    if options.out.exists() and not options.again:
        rows = json.loads(options.out.read_text(encoding="utf-8"))
    known = {(row["repeated"], row["pictures"]) for row in rows}
    asked = [tuple(map(int, one.split(","))) for one in options.only or []] or CASES
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for repeated, pictures in asked:
        if (repeated, pictures) not in known:
            rows.append(measure(repeated, pictures))
            rows.sort(key=lambda row: (row["pictures"], row["repeated"]))
            options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
            print(markdown(table_of(rows[-1:])))
    evidence.record(
        options.docs,
        "growth",
        command="make bench-growth",
        protocol="pbrfit-growth-1: one run each of the command with its defaults",
        tables={"Time and memory": table_of(rows)},
        files={"curves.png": plot(rows)},
    )


def measure(repeated: int, pictures: int) -> dict[str, Any]:
    """Seconds and peak of one run of the command."""
    with tempfile.TemporaryDirectory() as folder:
        scene, result = Path(folder) / "scene", Path(folder) / "result"
        enlarged(repeated, pictures).save(scene)
        found = run([scene], result)
        shutil.rmtree(scene)
    size = (BASE * repeated) ** 2 / 1e6
    return {"repeated": repeated, "pictures": pictures, "megapixels": size} | found


def run(arguments: Sequence[str | Path], result: Path) -> dict[str, Any]:
    """Seconds and peak of `pbrfit decompose` with some arguments, and what its result says."""
    command = [sys.executable, "-m", "pbrfit", "decompose", *arguments, "--out", result, "--json"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    seconds = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    content = json.loads((result / "result.json").read_text(encoding="utf-8"))
    return {
        "seconds": seconds,
        "seconds_of_fit": content["seconds"],
        "processor_seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        # Not `ru_maxrss`, which begins with the size of the process that started it.
        "peak_bytes": json.loads(done.stdout)["peak_bytes"],
        "stages": {stage["name"]: stage["seconds"] for stage in content["stages"]},
        "recon_rmse": content["metrics"]["recon_rmse"],
    }


def enlarged(repeated: int, pictures: int) -> pbrfit.Scene:
    """A room whose pixels are repeated, with noise."""
    small = make_scene("furnished", size=BASE, lights=pictures, held_out=1, seed=SEED)
    rng = np.random.default_rng(SEED)
    side = BASE * repeated
    images = np.empty((pictures, side, side, 3), np.float32)
    for to, image in zip(images, small.images, strict=True):
        rng.standard_normal(out=to, dtype=np.float32)
        to *= NOISE
        to += larger(image.astype(np.float32), repeated)
    return replace(
        small,
        images=images,
        normals=larger(small.normals.astype(np.float32), repeated),
        truth=None,
        segments=None,
    )


def larger(values: np.ndarray[Any, Any], repeated: int) -> np.ndarray[Any, Any]:
    """(H, W, ...) with every pixel several times in each direction."""
    return values.repeat(repeated, axis=0).repeat(repeated, axis=1)


def table_of(rows: Sequence[dict[str, Any]]) -> Table:
    """A line a case."""
    columns = ["megapixels", "pictures", "time, s", "of it the fit, s", "µs a pixel"]
    columns += ["peak, GiB", "pictures alone, GiB"]
    lines: list[list[Value]] = []
    for row in rows:
        size, pictures = row["megapixels"], row["pictures"]
        own = size * 1e6 * pictures * 12 / GIB
        seconds = [row["seconds"], row["seconds_of_fit"], row["seconds"] / size]
        lines.append([size, float(pictures), *seconds, row["peak_bytes"] / GIB, own])
    return Table(columns, lines)


def plot(rows: Sequence[dict[str, Any]]) -> bytes:
    """Time and memory by megapixels, a line for each number of pictures; as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    of_time, of_memory = figure.subplots(1, 2)
    colours = {4: "#0072B2", 16: "#D55E00", 64: "#009E73"}
    for pictures, marker in ((4, "o"), (16, "s"), (64, "^")):
        chosen = [row for row in rows if row["pictures"] == pictures]
        size = [row["megapixels"] for row in chosen]
        style = {"color": colours[pictures], "marker": marker, "label": f"{pictures} pictures"}
        of_time.plot(size, [row["seconds"] for row in chosen], **style)
        of_memory.plot(size, [row["peak_bytes"] / GIB for row in chosen], **style)
    for axes, what in ((of_time, "time, s"), (of_memory, "largest resident size, GiB")):
        axes.set(xscale="log", yscale="log", xlabel="megapixels", ylabel=what)
        axes.axvline(2.1, color="0.6", linewidth=1, linestyle=":")
        axes.grid(visible=True, which="both", color="0.9")
        axes.set_xticks([0.25, 1, 4, 16], ["0.25", "1", "4", "16"])
        axes.set_xticks([], minor=True)
        axes.set_yticks([], minor=True)
    of_time.set_yticks(times := [10, 20, 50, 100, 200, 500], list(map(str, times)))
    of_memory.set_yticks(sizes := [0.5, 1, 2, 4, 8], list(map(str, sizes)))
    of_memory.axhline(8, color="0.4", linewidth=1, linestyle="--")
    of_memory.text(0.27, 8.3, "8 GiB", color="0.3")
    of_time.text(2.2, of_time.get_ylim()[0] * 1.15, "in tiles", color="0.4")
    of_time.legend(frameon=False)
    file = io.BytesIO()
    figure.savefig(file, dpi=120)
    return file.getvalue()


if __name__ == "__main__":
    main()
