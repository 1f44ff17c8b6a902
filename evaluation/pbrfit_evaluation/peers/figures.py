"""Peers beside our fit as rows, tables and sheets of maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from pbrfit.acquire.marigold import MATERIALS_MODEL
from pbrfit.acquire.weights import Device
from pbrfit.commands.arguments import choice, value
from pbrfit_evaluation.grid.figures import Of, grid_rows, sheets
from pbrfit_evaluation.options import Setting, count, fixed
from pbrfit_evaluation.peers import rgbx
from pbrfit_evaluation.peers.measure import GRID, cases, work
from pbrfit_evaluation.scores import PROTOCOL, SCORES
from pbrfit_evaluation.suite import Column, Row, Section, Suite, Table

SHOWN = ("albedo", "albedo_scaled", "roughness", "metallic", "relight", "relight_scaled")
"""Columns of the tables."""


def rows(results: Of) -> list[Row]:
    """A row for each method, with the reason where it cannot run."""
    return grid_rows(GRID, results, SCORES)


def sections(results: Of, rows: Sequence[Row]) -> Iterator[Section]:
    """Errors, and the maps of the first scenes."""
    columns = [Column(name, best="low") for name in SHOWN]
    told = "RMSE, linear values. Intervals of 95 % over scenes."
    yield Section("Errors", told, [Table.of(rows, columns)])
    plain = [replace(row, metrics={one: row.metrics.get(one) for one in SHOWN}) for row in rows]
    yield Section("In short", "RMSE without intervals.", [Table.of(plain, columns)])
    caption = "The first scene: the truth, and what was found."
    yield from sheets("Maps", results, GRID, caption)


SUITE = Suite(
    name="peers",
    title="Peers that see one picture",
    protocol="pbrfit-peers-2: synthetic rooms; peers see one picture, the most evenly lit, in "
    "8-bit sRGB with its 98th percentile at white, our fit all pictures, with noise of 0.01, and "
    f"normals as an estimator gives them, with which all are relit; {PROTOCOL.partition(': ')[2]}",
    cases=cases,
    run=work,
    rows=rows,
    sections=sections,
    settings={
        **GRID.settings(6000, count("K", "how many", 10, 2), (256, 64)),
        "cycles_scenes": count("K", "rendered by Blender Cycles, where it is set up", 5, 0),
        "cycles_size": count("PIXELS", "of their pictures", 128, 32),
        "marigold": fixed(MATERIALS_MODEL, value("ID|FOLDER", str, "Marigold-IID")),
        "rgbx": fixed(rgbx.MODEL, value("ID|FOLDER", str, "RGB-X")),
        "device": fixed("auto", choice(Device, "where peers compute; auto = a GPU, else cpu")),
        "lights": Setting(16, 8),
        "iterations": Setting(500, 60),
        "samples": Setting(5, 1),
        "steps": Setting(None, 4),
        "longer_side": Setting(1000, 256),
    },
    about=(
        "Marigold-IID and RGB-X find materials in one picture of synthetic scenes, our fit in all "
        "pictures. A peer whose packages (pbrfit[diffusion]) or weights are missing is left out, "
        "and the report says why.",
        "A peer sees neither normals nor other lights; what it has is what it learnt from other "
        "scenes. So this is no race: it says what several pictures are worth beside one. A single "
        "picture cannot tell how bright the lamp was, so albedo and relit pictures are also "
        "compared after the best factor a channel (“scaled”).",
        "In whose favour: our renders are of our model, lights of low order without shadows or "
        "light between surfaces, which our fit expects and which peers, trained on path-traced or "
        "real rooms, have never seen. The rooms by Cycles have both, and no depth is given.",
    ),
    timed=True,
    jobs=1,  # a network may fill the GPU
)
