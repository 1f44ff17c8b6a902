"""Errors with and without geometry, and what fits chose, as rows, a table and sheets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pbrfit_evaluation.grid.figures import Metrics, Of, grid_rows, sheets
from pbrfit_evaluation.options import count
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Column, Row, Section, Suite, Table
from pbrfit_evaluation.transport.measure import GEOMETRY, OF_GEOMETRY, run

ERRORS = (*MAPS, "relight")
CHOICES = ("none", "occlusion", "bounce")


def rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def more(_: str, way: str, of: Of) -> Metrics:
        if "transport" not in OF_GEOMETRY[way].options:
            return {}
        chosen = [values["choice"] for _, values in of.finished]
        return {f"chose_{one}": chosen.count(one) / len(chosen) for one in CHOICES}

    return grid_rows(GEOMETRY, results, (*ERRORS, "recon", "seconds"), more)


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, what was chosen, and maps."""
    rest = ("recon", "seconds", *(f"chose_{one}" for one in CHOICES))
    columns = [*(Column(name, best="low") for name in ERRORS), *map(Column, rest)]
    yield Section("Errors", "RMSE, linear values.", [Table.of(found, columns)])
    caption = "The first room: the truth, and what was found. White is 1."
    yield from sheets("Maps", results, GEOMETRY, caption)


SUITE = Suite(
    name="transport",
    title="Shadows and bounces by geometry",
    protocol=f"pbrfit-transport-1: {SCORES}; {{size}} pixels, {{lights}} pictures, {{effort}}",
    cases=GEOMETRY.cases,
    run=run,
    rows=rows,
    sections=sections,
    settings={
        **GEOMETRY.settings(
            8100, count("K", "rooms of a setup", 10, 2), (64, 24), "setups", ways="variants"
        ),
        "lights": count("N", "pictures a room; as many are held out", 16),
    },
    about=(
        "Rooms with furniture under panoramas of SH3 light, rendered by Blender Cycles: without "
        "shadows, with shadows, and with all that a path tracer does; fitted with and without "
        "their depth. Normals are true. A network's depth has smooth errors of scale and shift, "
        "washed-out outlines and noise. Figures are means over rooms, with 95 % intervals by "
        "bootstrap over rooms in brackets. The constant guess has roughness 0.5, metallic 0 and "
        "the mean of the true albedo, with the lights that then fit best.",
    ),
    timed=True,
)
