"""Fill the table and draw the figure of docs/export.md that have the Blender extension.

    python tools/extension_in_blender.py [--size 128] [--samples 256]

The room of `pbrfit demo`, rendered and fitted with either model, is exported with the preset
"blender", imported by the extension as a user does, and rendered by Cycles under recovered lights
and a sun; how far that is from `pbrfit.relight`. Under the panorama of the test data (PBRFIT_DATA),
too, if it is there. Needs the environment of `make cycles-env`.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(REPOSITORY / "tests" / "support")]

from blender_extension import Import, imported  # noqa: E402
from pbrfit import Environment, Result, decompose, relight  # noqa: E402
from pbrfit.export import export_result  # noqa: E402
from pbrfit.result.differences import blue_to_yellow  # noqa: E402
from pbrfit.result.relighting import DirectionalLight  # noqa: E402
from pbrfit.result.sheet import Key, Panel, Row, as_png, displayed, sheet  # noqa: E402
from pbrfit.synthetic import make_scene  # noqa: E402
from pbrfit_evaluation.report import evidence, markdown  # noqa: E402
from pbrfit_evaluation.suite import Table, Value  # noqa: E402

LIGHTS = (0, 3, 5, 9)
SUN = DirectionalLight(-50.0, 35.0)
HDRI = "hdri/venice_sunset_1k.hdr"
SPAN = 0.2
"""Difference, relative to the RMS radiance, at the end of the scale of colours."""

Picture = NDArray[np.floating[Any]]
Line = list[Value]


def main() -> None:
    """Fit, export, import, render, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--samples", type=int, default=256)
    chosen = parser.parse_args()
    rows: list[Row] = []
    told: list[Line] = []
    with tempfile.TemporaryDirectory() as folder:
        for model in ("principled", "paper"):
            scene = make_scene("room", size=chosen.size, model=model)
            result = decompose(scene, model=model)
            drawn, lines = compared(Path(folder) / model, result, chosen.samples)
            rows += drawn
            told += lines
    key = Key(
        "|difference| / RMS radiance",
        blue_to_yellow(np.linspace(0, 1, 256)),
        {share / SPAN: f"{share:g}" for share in (0, 0.05, 0.1, 0.15, 0.2)},
    )
    table = Table(["model", "import, light", "all", "dielectrics", "metals"], told)
    print(markdown(table))
    command = f"python tools/extension_in_blender.py --size {chosen.size}"
    evidence.record(
        REPOSITORY / "docs",
        "extension",
        command=f"{command} --samples {chosen.samples}",
        protocol="pbrfit-extension-1: RMSE over RMS radiance, beside pbrfit.relight",
        tables={"As imported": table},
        files={"relit.png": as_png(sheet(rows, keys=[key]))},
    )


def compared(folder: Path, result: Result, samples: int) -> tuple[list[Row], list[Line]]:
    """Rows of the figure for a light and the sun; a line a light and geometry."""
    folder.mkdir()
    export_result(result, folder / "out", preset="blender")
    of_sun = {"sun": True, "azimuth": SUN.azimuth, "elevation": SUN.elevation}
    runs: dict[str, tuple[dict[str, Any], Any]] = {
        f"facets, light {i}": ({"light": result.pictures[i]}, result.lighting[i]) for i in LIGHTS
    }
    runs["facets, sun"] = (of_sun, SUN)
    data = Path(os.environ.get("PBRFIT_DATA", REPOSITORY.parent / "shared" / "data"))
    if (data / HDRI).is_file():
        light = Environment.read(data / HDRI)
        runs["facets, photographed panorama"] = ({"panorama": str(data / HDRI)}, light)
    runs["relief, light 0"] = ({"geometry": "RELIEF"}, result.lighting[0])
    if result.model == "paper":
        runs["facets, light 0, Principled"] = ({"own_law": False}, result.lighting[0])
    imports = [Import(name, options, samples=samples) for name, (options, _) in runs.items()]
    _, pictures = imported(folder / "job", folder / "out", imports, timeout=3600)
    rows, lines = [], []
    for name, (_, light) in runs.items():
        ours, theirs = relight(result, light), pictures[name][..., :3]
        errors = apart(ours, theirs, result)
        lines.append([result.model, name, *errors])
        if name in ("facets, light 0", "facets, sun"):
            rows.append(row(f"{result.model}, {name.partition(', ')[2]}", ours, theirs, errors[0]))
    return rows, lines


def apart(ours: Picture, theirs: Picture, result: Result) -> list[float]:
    """How far the pictures are apart: all pixels, dielectrics, metals."""
    metal = result.metallic > 0.5
    return [
        float(np.sqrt(np.mean((theirs - ours)[of] ** 2) / np.mean(ours[of] ** 2)))
        for of in (result.mask, result.mask & ~metal, result.mask & metal)
    ]


def row(title: str, ours: Picture, theirs: Picture, error: float) -> Row:
    """Ours, Blender's and the difference."""
    white = float(np.nanpercentile(ours, 98))
    rms = np.sqrt(np.nanmean(ours**2))
    colors = blue_to_yellow(np.clip(np.abs(theirs - ours).mean(axis=-1) / rms / SPAN, 0, 1))
    return [
        Panel(f"{title}: pbrfit relight", displayed(ours, white)),
        Panel("the import in Blender", displayed(theirs, white)),
        Panel(f"difference, RMSE {100 * error:.1f} %", colors),
    ]


if __name__ == "__main__":
    main()
