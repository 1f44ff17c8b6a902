"""Draw the figure of docs/model.md that has both reflection models, recovered and in Blender.

    python tools/models_in_blender.py [--kind spheres] [--size 144] [--samples 512] [--seed 0]

Pictures of a synthetic scene, rendered with the principled model, are fitted with either model.
Each result is relit by pbrfit under a light that no picture had, and exported to glTF and rendered
by Cycles under that light. Prints how far they are apart. Needs the environment of `make
cycles-env`. Writes docs/images/models-in-blender.png.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path[:0] = [
    str(REPOSITORY / "tests" / "python" / "export"),
    str(REPOSITORY / "tests" / "support"),
]

from blender_card import Rendering, in_blender  # noqa: E402
from pbrfit import Result, decompose, relight  # noqa: E402
from pbrfit.export import export_result  # noqa: E402
from pbrfit.io import images  # noqa: E402
from pbrfit.result.differences import blue_to_yellow  # noqa: E402
from pbrfit.result.sheet import OUTSIDE, Key, Panel, Row, displayed, sheet  # noqa: E402
from pbrfit.synthetic import make_scene  # noqa: E402

PICTURES = 16
NOISE = 0.002
SPAN = 0.2
"""Difference, relative to the mean radiance, at the end of the scale of colours."""

TITLES = {"principled": "--model principled", "paper": "--model paper"}

Picture = NDArray[np.floating[Any]]


def main() -> None:
    """Fit, relight, render, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kind", default="spheres", choices=("spheres", "room", "furnished"))
    parser.add_argument("--size", type=int, default=144)
    parser.add_argument("--samples", type=int, default=512)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    scene = make_scene(
        chosen.kind,
        size=chosen.size,
        lights=PICTURES,
        held_out=1,
        noise=NOISE,
        seed=chosen.seed,
        model="principled",
    )
    assert scene.truth is not None and scene.truth.relight_lighting is not None  # noqa: PT018
    [light] = scene.truth.relight_lighting
    print(f"{'RMSE / mean radiance':<24}{'all':>8}{'dielectric':>12}{'metal':>8}")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for model, title in TITLES.items():
            result = decompose(scene, model=model)
            lit = replace(result, lighting=light[None], pictures=("held_out",))
            ours = relight(lit, light)
            theirs = rendered_by_cycles(Path(folder) / model, lit, chosen.samples)
            error = tell(title, ours, theirs, scene.truth.materials.metallic > 0.5)
            rows.append(row(ours, theirs, error))
    key = Key(
        "|difference| / mean radiance",
        blue_to_yellow(np.linspace(0, 1, 256)),
        {share / SPAN: f"{share:g}" for share in (0, 0.05, 0.1, 0.15, 0.2)},
    )
    path = REPOSITORY / "docs" / "images" / "models-in-blender.png"
    images.write_png(path, sheet(rows, labels=list(TITLES.values()), keys=[key]), tag="srgb")
    print(f"figure: {path}")


def rendered_by_cycles(folder: Path, result: Result, samples: int) -> Picture:
    """The exported result as imported, under its one light: (H, W, 3)."""
    folder.mkdir()
    exported = export_result(result, folder / "out", format="gltf", bits=16, geometry="facets")
    height, width = result.mask.shape
    light = folder / "out" / "lights" / exported.panoramas[0].file
    blender = in_blender(
        folder / "job",
        folder / "out" / "material.glb",
        (width, height),
        [Rendering("as imported", light, samples=samples)],
        camera_only=True,
        timeout=1800,
    )
    return np.where(result.mask[..., None], blender.pictures["as imported"][..., :3], np.nan)


def tell(title: str, ours: Picture, theirs: Picture, metal: NDArray[np.bool_]) -> float:
    """Print how far the pictures are apart; return it for all pixels."""
    valid = np.isfinite(ours).all(axis=-1)
    parts = [valid & of for of in (np.full(valid.shape, True), ~metal, metal)]
    errors = [
        np.sqrt(np.mean((theirs[part] - ours[part]) ** 2)) / ours[part].mean() for part in parts
    ]
    print(f"{title:<24}{errors[0]:>8.4f}{errors[1]:>12.4f}{errors[2]:>8.4f}")
    return float(errors[0])


def row(ours: Picture, theirs: Picture, error: float) -> Row:
    """Ours, Blender's and the difference."""
    valid = np.isfinite(ours).all(axis=-1)
    white = float(np.nanpercentile(ours, 98))
    size = np.abs(theirs - ours).mean(axis=-1) / np.nanmean(ours)
    colors = blue_to_yellow(np.clip(np.nan_to_num(size) / SPAN, 0, 1))
    colors[~valid] = OUTSIDE
    return [
        Panel("pbrfit relight", displayed(ours, white)),
        Panel("the export in Blender", displayed(theirs, white)),
        Panel(f"difference, RMSE {100 * error:.1f} %", colors),
    ]


if __name__ == "__main__":
    main()
