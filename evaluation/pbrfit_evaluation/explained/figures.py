"""Rows, tables and sheets of the suites `transport` and `lamps`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pbrfit_evaluation.explained.measure import (
    GEOMETRY,
    LAMPS,
    OF_GEOMETRY,
)
from pbrfit_evaluation.grid import Grid
from pbrfit_evaluation.grid.figures import MAPS, Metrics, Of, pictures
from pbrfit_evaluation.grid.figures import rows as grid_rows
from pbrfit_evaluation.suite import Column, Row, Section, Table

ERRORS = (*MAPS, "relight")
METRICS = (*ERRORS, "recon", "seconds")
CHOICES = ("none", "occlusion", "bounce")


def _sheets(grid: Grid, results: Of) -> Iterator[Section]:
    labels = {key: way.words for key, way in grid.ways.items()}
    sheets = pictures(results, labels, "The first room: the truth, and what was found.")
    if sheets:
        yield Section("Maps", "White is 1 in roughness and metallic.", figures=sheets)


# ------------------------------------------------------------------------------------- geometry


def geometry_rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def more(_: str, way: str, of: Of) -> Metrics:
        if "transport" not in OF_GEOMETRY[way].options:
            return {}
        chosen = [values["choice"] for _, values in of.finished]
        return {f"chose_{one}": chosen.count(one) / len(chosen) for one in CHOICES}

    return grid_rows(GEOMETRY, results, METRICS, more)


def geometry_sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, what was chosen, and maps."""
    rest = ("recon", "seconds", *(f"chose_{one}" for one in CHOICES))
    columns = [*(Column(name, best="low") for name in ERRORS), *map(Column, rest)]
    yield Section("Errors", "RMSE, linear values.", [Table.of(found, columns)])
    yield from _sheets(GEOMETRY, results)


# ---------------------------------------------------------------------------------------- lamps


def lamps_rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def more(_: str, __: str, of: Of) -> Metrics:
        return {f"lamps_{name}": of.mean("lamps", name).mean for name in ("cm", "degrees", "near")}

    return grid_rows(LAMPS, results, (*MAPS, "recon", "seconds"), more)


def lamps_sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
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
    yield from _sheets(LAMPS, results)
