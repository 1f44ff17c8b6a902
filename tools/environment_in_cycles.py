"""How far a sphere under a panorama is from Cycles: the table and the figure of docs/relight.md.

    python tools/environment_in_cycles.py PANORAMA... [--samples 1024] [--side 64] [--docs docs]

Needs the environment of `make cycles-env`. Differences are RMSE over RMS radiance, up to 80 degrees
from the middle of the sphere, of the principled model, without light between surfaces.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import Environment, Materials
from pbrfit.display.tone import encoded
from pbrfit.model.environment import render_environment
from pbrfit.result.metrics import white_of
from pbrfit_evaluation.cycles.process import find_python, run_worker
from pbrfit_evaluation.report import evidence, markdown
from pbrfit_evaluation.suite import Table, Value

Array = NDArray[np.floating[Any]]

WORKER = Path(__file__).resolve().with_name("spheres_in_cycles.py")
SURFACES = {
    "metal, r = 0.2": (0.8, 0.2, 1.0),
    "0.35": (0.8, 0.35, 1.0),
    "0.5": (0.8, 0.5, 1.0),
    "0.7": (0.8, 0.7, 1.0),
    "1": (0.8, 1.0, 1.0),
    "plastic, r = 0.2": (0.5, 0.2, 0.0),
    "0.5 ": (0.5, 0.5, 0.0),
    "1 ": (0.5, 1.0, 0.0),
}
"""Albedo, roughness, metallic."""
FINER = 4
"""Samples a pixel in each direction on our side."""


def ours(surface: tuple[float, float, float], light: Environment, side: int) -> Array:
    """(side, side, 3), averaged over pixels; NaN at the rim."""
    fine = side * FINER
    at = (2 * np.arange(fine) + 1 - fine) / fine
    x, y = np.meshgrid(at, -at)
    inside = x**2 + y**2 < np.sin(np.radians(80)) ** 2
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normals = np.where(inside[..., None], np.stack([x, y, z], axis=-1), np.nan)
    flat = np.where(inside, 1.0, np.nan)
    albedo, roughness, metallic = surface
    materials = Materials(
        np.repeat(albedo * flat[..., None], 3, axis=-1), roughness * flat, metallic * flat
    )
    seen = render_environment(materials, normals, light, 0.0, model="principled")
    return seen.reshape(side, FINER, side, FINER, 3).mean(axis=(1, 3))


def main() -> None:
    """Render, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("panoramas", nargs="+", type=Path)
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--docs", type=Path, help="write table and figure there")
    chosen = parser.parse_args()
    paths = {path.stem: path.resolve() for path in chosen.panoramas}
    job = {
        "side": chosen.side,
        "samples": chosen.samples,
        "panoramas": {name: str(path) for name, path in paths.items()},
        "surfaces": SURFACES,
    }
    rows: list[list[tuple[Array, Array]]] = []
    lines: list[list[Value]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run_worker(find_python(), folder, 3600, json.dumps(job), worker=WORKER)
        for panorama, path in paths.items():
            light = Environment.read(path)
            line: list[Value] = [panorama]
            pairs = []
            for surface, numbers in SURFACES.items():
                theirs = np.load(folder / f"{panorama}-{surface}.npy").astype(np.float64)
                found = ours(numbers, light, chosen.side)
                known = np.isfinite(found)
                error = np.sqrt(np.mean((found - theirs)[known] ** 2) / np.mean(theirs[known] ** 2))
                line.append(float(error))
                pairs.append((found, np.where(known, theirs, np.nan)))
            lines.append(line)
            rows.append(pairs)
    errors = [value for line in lines for value in line if isinstance(value, float)]
    lines.append(["mean of all", float(np.mean(errors)), *[""] * (len(SURFACES) - 1)])
    table = Table(["panorama", *SURFACES], lines)
    print(markdown(table))
    if chosen.docs is not None:
        evidence.record(
            chosen.docs,
            "relight",
            command="python tools/environment_in_cycles.py PANORAMA... "
            f"--samples {chosen.samples} --side {chosen.side}",
            protocol="pbrfit-environment-1: RMSE over RMS radiance, to 80 degrees from the middle",
            tables={"Spheres under panoramas": table},
            files={"spheres.png": drawn(rows)},
        )


def drawn(rows: list[list[tuple[Array, Array]]]) -> bytes:
    """Ours above Cycles', a panorama after the other."""
    from PIL import Image

    strips = []
    for pairs in rows:
        exposure = -np.log2(max(white_of(theirs) for _, theirs in pairs[:5]))
        for which in (0, 1):
            panels = [encoded(pair[which], exposure, "neutral") for pair in pairs]
            strips.append(np.concatenate([np.nan_to_num(one, nan=1.0) for one in panels], axis=1))
    picture = Image.fromarray(np.rint(255 * np.concatenate(strips)).astype(np.uint8))
    large = picture.resize((2 * picture.width, 2 * picture.height), Image.Resampling.BICUBIC)
    file = io.BytesIO()
    large.save(file, "png")
    return file.getvalue()


if __name__ == "__main__":
    sys.exit(main())
