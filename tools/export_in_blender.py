"""Print the table and draw the figure of docs/export.md: exports in Blender beside our renders.

    python tools/export_in_blender.py [--samples 256]

Needs the environment of `make cycles-env` and, for the row of a photographed panorama, the test
data (PBRFIT_DATA). Leaves its table in docs/evidence/export.json.
"""

from __future__ import annotations

import argparse
import os
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

from test_export_blender import difference, diffuse  # noqa: E402

from blender_card import Rendering, in_blender, lopsided_lights, relief  # noqa: E402
from pbrfit import Environment, Result, relight  # noqa: E402
from pbrfit.export import export_result  # noqa: E402
from pbrfit.export.view_mesh import Geometry  # noqa: E402
from pbrfit.result.differences import blue_to_yellow  # noqa: E402
from pbrfit.result.sheet import OUTSIDE, Key, Panel, Row, as_png, displayed, sheet  # noqa: E402
from pbrfit.synthetic import make_scene  # noqa: E402
from pbrfit_evaluation.report import evidence, markdown  # noqa: E402
from pbrfit_evaluation.suite import Table, Value  # noqa: E402

HDRI = "hdri/venice_sunset_1k.hdr"
SPAN = 0.5
"""Difference, relative to the mean radiance, at the end of the scale of colours."""

CASES: dict[Geometry, dict[str, dict[str, Any]]] = {
    "card": {
        "diffuse, no normal texture": {"diffuse": True, "flat": True},
        "diffuse": {"diffuse": True},
        "as imported": {},
    },
    "facets": {
        "diffuse": {"diffuse": True},
        "as imported": {},
        "distribution GGX": {"distribution": "GGX"},
    },
}

Picture = NDArray[np.floating]
Line = list[Value]


def main() -> None:
    """Render, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--samples", type=int, default=256)
    samples = parser.parse_args().samples
    wall = relief(128, 128)
    made = make_scene("room", size=128, lights=3, held_out=1)
    assert made.truth is not None
    room = replace(
        wall,
        materials=made.truth.materials,
        normals=made.normals,
        mask=made.valid,
        fov=made.fov,
        lighting=lopsided_lights(),
    )
    rows: list[Row] = []
    told: list[Line] = []
    with tempfile.TemporaryDirectory() as name:
        drawn: tuple[tuple[str, Result, Geometry], ...] = (
            ("wall", wall, "card"),
            ("wall", wall, "facets"),
            ("room", room, "card"),
            ("room", room, "facets"),
        )
        for title, result, geometry in drawn:
            ours, found, lines = compared(Path(name), title, result, geometry, samples)
            told += lines
            if (title, geometry) != ("wall", "facets"):
                rows.append(row(title, ours, found, f"Blender: {geometry}"))
        data = Path(os.environ.get("PBRFIT_DATA", REPOSITORY.parent / "shared" / "data"))
        if (data / HDRI).is_file():
            told += photographed(Path(name) / "hdri", wall, data / HDRI, samples)
    key = Key(
        "|difference| / mean radiance",
        blue_to_yellow(np.linspace(0, 1, 256)),
        {share / SPAN: f"{share:g}" for share in (0, 0.1, 0.2, 0.3, 0.4, 0.5)},
        {"outside the mask": (OUTSIDE,) * 3},
    )
    table = Table(["scene", "geometry", "Blender's material", "all", "dielectrics", "metals"], told)
    print(markdown(table))
    evidence.record(
        REPOSITORY / "docs",
        "export",
        command=f"python tools/export_in_blender.py --samples {samples}",
        protocol="pbrfit-export-1: RMSE over mean radiance, without bounces",
        tables={"In Cycles": table},
        files={"blender.png": as_png(sheet(rows, keys=[key]))},
    )


def compared(
    folder: Path, title: str, result: Result, geometry: Geometry, samples: int
) -> tuple[Picture, Picture, list[Line]]:
    """Our picture under the first light, and Blender's as imported; and differences."""
    folder = folder / f"{title} {geometry}"
    exported = export_result(result, folder / "out", format="gltf", geometry=geometry)
    light = folder / "out" / "lights" / exported.panoramas[0].file
    height, width = result.mask.shape
    cases = CASES[geometry]
    blender = in_blender(
        folder / "job",
        folder / "out" / "material.glb",
        (width, height),
        [Rendering(case, light, samples=samples, **of) for case, of in cases.items()],
        camera_only=geometry == "facets",
    )
    ours = relight(result, result.lighting[0])
    flat = np.broadcast_to([0.0, 0.0, 1.0], result.normals.shape)
    lines = []
    for case, of in cases.items():
        expected = diffuse(result, flat if "flat" in of else result.normals)
        found = blender.pictures[case]
        lines.append(
            told_of(title, geometry, case, found, expected if "diffuse" in of else ours, result)
        )
    return ours, blender.pictures["as imported"], lines


def photographed(folder: Path, result: Result, file: Path, samples: int) -> list[Line]:
    """The same for a photographed panorama: whole, and as the SH light that we make of it."""
    lines = []
    environment = Environment.read(file)
    light = environment.harmonics
    for name in ("its SH light", "itself"):
        of = replace(result, lighting=light[None], pictures=("hdri",))
        exported = export_result(of, folder / name, format="gltf")
        used = folder / name / "lights" / exported.panoramas[0].file if name != "itself" else file
        height, width = of.mask.shape
        blender = in_blender(
            folder / f"{name} job",
            folder / name / "material.glb",
            (width, height),
            [Rendering("as imported", used, samples=samples)],
        )
        ours = relight(of, environment if name == "itself" else light)
        found = blender.pictures["as imported"]
        lines.append(told_of("wall", "card", f"under {file.stem}, {name}", found, ours, of))
    return lines


def told_of(
    title: str, geometry: str, case: str, found: Picture, expected: Picture, result: Result
) -> Line:
    """A line of differences: of all pixels, dielectrics and metals."""
    metal = result.metallic > 0.5
    parts = [difference(found, expected, result.mask & of) for of in (True | metal, ~metal, metal)]
    return [title, geometry, case, *(f"{100 * part:.1f} %" for part in parts)]


def row(title: str, ours: Picture, found: Picture, caption: str) -> Row:
    """Ours, Blender's and the difference."""
    valid = np.isfinite(ours).all(axis=-1)
    theirs = np.where(valid[..., None], found[..., :3], np.nan)
    white = float(np.nanpercentile(ours, 99))
    size = np.abs(theirs - ours).mean(axis=-1) / np.nanmean(ours)
    colors = blue_to_yellow(np.clip(np.nan_to_num(size) / SPAN, 0, 1))
    colors[~valid] = OUTSIDE
    return [
        Panel(f"{title}: pbrfit", displayed(ours, white)),
        Panel(caption, displayed(theirs, white)),
        Panel("difference", colors),
    ]


if __name__ == "__main__":
    main()
