"""Errors, and where lamps were found, as rows, a table and sheets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pbrfit_evaluation.grid.figures import Metrics, Of, grid_rows, sheets
from pbrfit_evaluation.options import count, several
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Column, Row, Section, Suite, Table
from pbrfit_evaluation.transport.measure import LAMPS, run


def rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def more(_: str, __: str, of: Of) -> Metrics:
        return {f"lamps_{name}": of.mean("lamps", name).mean for name in ("cm", "degrees", "near")}

    return grid_rows(LAMPS, results, (*MAPS, "recon", "seconds"), more)


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, where lamps were found, and maps of the first room."""
    columns = (
        *(Column(name, best="low") for name in MAPS),
        Column("recon"),
        Column("lamps_cm", "lamps off by,\nmedian, cm", best="low"),
        Column("lamps_degrees", "median,\ndegrees", best="low"),
        Column("lamps_near", "share found\nnear"),
        Column("seconds"),
    )
    yield Section(
        "Errors",
        "RMSE of the maps, linear values. Lamps: medians over the pictures of a room, means over "
        "rooms; degrees as seen from the middle of the surfaces.",
        [Table.of(found, columns)],
    )
    caption = "The first room: the truth, and what was found. White is 1."
    yield from sheets("Maps", results, LAMPS, caption)


SUITE = Suite(
    name="lamps",
    title="Rooms under lamps",
    protocol=f"pbrfit-lamps-1: {SCORES}; lamps one a picture, medians over a room's; {{size}} "
    "pixels, {lights} pictures, {effort}",
    cases=LAMPS.cases,
    run=run,
    rows=rows,
    sections=sections,
    settings={
        **LAMPS.settings(
            8200, count("K", "rooms of a setup", 10, 2), (64, 24), "setups", ways="variants"
        ),
        "conditions": several("NAME", LAMPS.conditions, default=["points-shadows"], name="setups"),
        "lights": count("N", "pictures a room", 16),
    },
    about=(
        "Rooms with furniture, each picture lit by one lamp without size and of its own colour, "
        "somewhere in the upper half of the room or near the camera; rendered by Blender Cycles "
        "without light that surfaces reflect. Normals and segments are true, depth too where it "
        "is told. The constant guess has roughness 0.5, metallic 0 and the mean of the true "
        "albedo. Figures are means over rooms, with 95 % intervals by bootstrap over rooms in "
        "brackets.",
    ),
    timed=True,
)
