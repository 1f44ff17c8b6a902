"""Rows, a table and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from pbrfit_evaluation.generated.measure import GRID, WAYS, by_cycles, cases, run
from pbrfit_evaluation.grid.figures import Metrics, Of, grid_rows, pictures
from pbrfit_evaluation.options import count
from pbrfit_evaluation.panels import in_lines, unpacked
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Column, Picture, Row, Section, Suite, Table

ERRORS = ("albedo_scaled", "roughness", "metallic", "relight_scaled")

OURS = ", our renderer"
"""Ends the name of a row whose rooms are not by Cycles."""


def rows(results: Of) -> list[Row]:
    """A row a way."""

    def more(key: str, _: str, of: Of) -> Metrics:
        found = {name: of.mean(name).mean for name in ("kept", "honest_refused", "damaged_kept")}
        if WAYS[key].path:
            for name in ("ours", "blender"):
                found[f"first_light_{name}"] = of.mean("blender", name).mean
        return found

    ours = "" if by_cycles(results.options) else OURS
    found = grid_rows(GRID, results, [*ERRORS, "albedo", "relight"], more)
    return [replace(row, name=f"{row.name}{ours}") for row in found]


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors by stage, and pictures."""
    headings = {"albedo_scaled": "albedo", "relight_scaled": "relit"}
    columns = [Column(name, headings.get(name, "")) for name in ERRORS]
    yield Section(
        "Errors by stage",
        "RMSE of linear values; albedo and relit pictures after the best factor a channel.",
        [Table.of(found, columns)],
    )
    figures = list(_pictures(results))
    if figures:
        yield Section("Pictures", figures=figures)


def _pictures(results: Of) -> Iterator[Picture]:
    shown = [values for _, values in results.finished if "inputs" in values]
    if shown:
        most = max(shown, key=lambda values: len(set(values["kinds"])))
        panels = in_lines({"": unpacked(most["inputs"])})
        yield Picture("inputs", "Stand-ins of the first room.", panels)
    caption = "The first room; relit by the first held-out light."
    yield from pictures(results, GRID.conditions, caption, by="condition")


SUITE = Suite(
    name="generated",
    title="From one photograph, with stand-in pictures",
    protocol=f"pbrfit-generated-1: {SCORES}; {{size}} pixels, {{pictures}} pictures, {{effort}}",
    cases=cases,
    run=run,
    rows=rows,
    sections=sections,
    settings={
        **GRID.settings(9700, count("K", "rooms", 4, 1), (64, 64), "ways"),
        "pictures": count("N", "a room, the photograph among them", 13, 7),
    },
    about=(
        "Textured rooms under soft lights, by Cycles with all light transport, stand for a "
        "photograph and for pictures that a generator made of it: tone curves, drift, repainting, "
        "another room. Fits with and without review, alignment, robust weights and exposure "
        "handling, and by commands from photograph to Blender. Without Blender Cycles (make "
        "cycles-env) and with --quick our own renderer makes the rooms.",
        "Levels of damage build upon each other. Normals and segments are true unless a row says "
        "otherwise. Brackets are 95 % intervals of means over rooms. The constant guess has "
        "roughness 0.5, metallic 0 and the mean of the true albedo.",
    ),
)
