"""How far a sphere under a panorama is from Cycles: the table and the figure of docs/relight.md.

    python tools/environment_in_cycles.py PANORAMA... [--samples 1024] [--side 64] [--figure FILE]

Needs the environment of `make cycles-env`. Differences are RMSE over RMS radiance, up to 80 degrees
from the middle of the sphere, of the principled model, without light between surfaces.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import Environment, Materials
from pbrfit.io.display import encoded
from pbrfit.model.environment import render_environment
from pbrfit.result.metrics import white_of
from pbrfit_evaluation.cycles.process import find_python, run_worker

Array = NDArray[np.floating[Any]]

WORKER = Path(__file__).resolve().parents[1] / "tests" / "support" / "blender_environment.py"
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
    parser.add_argument("--figure", type=Path)
    chosen = parser.parse_args()
    paths = {path.stem: path.resolve() for path in chosen.panoramas}
    job = {
        "side": chosen.side,
        "samples": chosen.samples,
        "panoramas": {name: str(path) for name, path in paths.items()},
        "surfaces": SURFACES,
    }
    print("| panorama | " + " | ".join(SURFACES) + " |")
    print("|---" * (len(SURFACES) + 1) + "|")
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run_worker(find_python(), folder, 3600, json.dumps(job), worker=WORKER)
        for panorama, path in paths.items():
            light = Environment.read(path)
            cells, pairs = [], []
            for surface, numbers in SURFACES.items():
                theirs = np.load(folder / f"{panorama}-{surface}.npy").astype(np.float64)
                found = ours(numbers, light, chosen.side)
                known = np.isfinite(found)
                error = np.sqrt(np.mean((found - theirs)[known] ** 2) / np.mean(theirs[known] ** 2))
                cells.append(f"{error:.3f}")
                pairs.append((found, np.where(known, theirs, np.nan)))
            print(f"| {panorama} | " + " | ".join(cells) + " |", flush=True)
            rows.append(pairs)
    if chosen.figure is not None:
        draw(rows, chosen.figure)


def draw(rows: list[list[tuple[Array, Array]]], path: Path) -> None:
    """Ours above Cycles', a panorama after the other."""
    from PIL import Image

    strips = []
    for pairs in rows:
        exposure = -np.log2(max(white_of(theirs) for _, theirs in pairs[:5]))
        for which in (0, 1):
            panels = [encoded(pair[which], exposure, "neutral") for pair in pairs]
            strips.append(np.concatenate([np.nan_to_num(one, nan=1.0) for one in panels], axis=1))
    picture = Image.fromarray(np.rint(255 * np.concatenate(strips)).astype(np.uint8))
    picture.resize((2 * picture.width, 2 * picture.height), Image.Resampling.BICUBIC).save(path)


if __name__ == "__main__":
    sys.exit(main())
