"""Peers beside our fit as rows, tables and sheets of maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

from pbrfit_evaluation.grid.figures import Of, pictures
from pbrfit_evaluation.grid.figures import rows as grid_rows
from pbrfit_evaluation.peers.measure import GRID, WAYS
from pbrfit_evaluation.scores import Scores
from pbrfit_evaluation.suite import Column, Row, Section, Table

SHOWN = ("albedo", "albedo_scaled", "roughness", "metallic", "relight", "relight_scaled")
"""Columns of the tables."""


def rows(results: Of) -> list[Row]:
    """A row for each method, with the reason where it cannot run."""
    return grid_rows(GRID, results, [field.name for field in fields(Scores)])


def sections(results: Of, rows: Sequence[Row]) -> Iterator[Section]:
    """Errors, and the maps of the first scenes."""
    columns = [Column(name, best="low") for name in SHOWN]
    told = "RMSE, linear values. Intervals of 95 % over scenes."
    yield Section("Errors", told, [Table.of(rows, columns)])
    plain = [replace(row, metrics={one: row.metrics.get(one) for one in SHOWN}) for row in rows]
    yield Section("In short", "RMSE without intervals.", [Table.of(plain, columns)])
    labels = {key: way.words for key, way in WAYS.items()}
    sheets = pictures(results, labels, "The first scene: the truth, and what was found.")
    if sheets:
        yield Section("Maps", figures=sheets)
