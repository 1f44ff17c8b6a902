"""Rows, verdicts, tables and sheets of the suites `transport` and `lamps`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pbrfit_evaluation.explained.measure import GEOMETRY, LAMPS
from pbrfit_evaluation.explained.variants import (
    HARMONICS,
    NEAR,
    OF_GEOMETRY,
    OF_LAMPS,
    TRUE,
    WITHOUT,
)
from pbrfit_evaluation.grid import Grid
from pbrfit_evaluation.grid.figures import MAPS, Bar, Metrics, Of, pictures
from pbrfit_evaluation.grid.figures import rows as grid_rows
from pbrfit_evaluation.grid.figures import verdicts as of_bars
from pbrfit_evaluation.suite import Column, Row, Section, Table, Verdict, dots

ERRORS = (*MAPS, "relight")
METRICS = (*ERRORS, "recon", "seconds")
FACTS = ("depth_off", "normals_off", "segments", "purity")
CHOICES = ("none", "occlusion", "bounce")

BETTER = 1.0
"""Mean error with true depth, or lamps, over that of the constant guess and over that without, at
most: where light is blocked, geometry has to be worth something."""

SPOILT = 1.03
"""Mean error with any geometry over that without, and of `auto` over that of environment light, at
most: what `auto` takes has to be no worse."""

CENTIMETRES = 5.0
"""Median distance of lamps from true ones, at most, with true depth."""


def _bar(grid: Grid, setup: str, way: str, other: str, name: str = "") -> Bar:
    """Of one error, or of the worst."""
    title = f"{grid.conditions[setup]}, {grid.ways[way].words}"
    what = f"{title}: {name or 'worst error'} over that of {grid.ways[other].words}"
    names = [name] if name else ERRORS if grid is GEOMETRY else MAPS
    return Bar(what, (setup, way), (setup, other), names, BETTER if name else SPOILT)


def _sheets(grid: Grid, results: Of) -> Iterator[Section]:
    labels = {key: way.words for key, way in grid.ways.items()}
    sheets = pictures(results, labels, "The first room: the truth, and what was found.")
    if sheets:
        yield Section("Maps", "White is 1 in roughness and metallic.", figures=sheets)


# ------------------------------------------------------------------------------------- geometry


def geometry_rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def more(_: str, way: str, of: Of) -> Metrics:
        found = {name: of.mean("facts", name).mean for name in FACTS}
        if "transport" in OF_GEOMETRY[way].options:
            chosen = [values["choice"] for _, values in of.finished]
            found |= {f"chose_{one}": chosen.count(one) / len(chosen) for one in CHOICES}
        return found

    return grid_rows(GEOMETRY, results, METRICS, more)


def geometry_verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """True depth beats the guess and what is found without it; no variant spoils anything."""
    for setup in GEOMETRY.conditions:
        for key, way in OF_GEOMETRY.items():
            if key == TRUE and setup != "brdf":
                for name in ERRORS:
                    for other in ("constant", WITHOUT):
                        yield from of_bars(results, [_bar(GEOMETRY, setup, key, other, name)])
            elif "transport" in way.options:
                yield from of_bars(results, [_bar(GEOMETRY, setup, key, WITHOUT)])


def geometry_sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, what was given and chosen, and maps."""
    words = {way.words: way.words for way in OF_GEOMETRY.values()}
    yield Section(
        "Errors",
        "RMSE, linear values.",
        [Table.of(found, [*(Column(name, best="low") for name in ERRORS), "recon", "seconds"])],
        [dots("transport", found, words, ERRORS)] if results.finished else [],
    )
    headings = {
        "depth_off": "depth off by,\nrelative",
        "normals_off": "its normals\noff by, degrees",
        "purity": "pixels of their\nsegment's object",
    } | {f"chose_{one}": f"share of rooms:\n{one}" for one in CHOICES}
    run = [row for row in found if row.scenes and not row.guess]
    given = [*FACTS, *(f"chose_{one}" for one in CHOICES)]
    yield Section(
        "What fits were given, and what they chose",
        "Depth after the best common factor.",
        [Table.of(run, [Column(name, headings.get(name, "")) for name in given])],
    )
    yield from _sheets(GEOMETRY, results)


# ---------------------------------------------------------------------------------------- lamps


def lamps_rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def more(_: str, __: str, of: Of) -> Metrics:
        return {f"lamps_{name}": of.mean("lamps", name).mean for name in ("cm", "degrees", "near")}

    return grid_rows(LAMPS, results, (*MAPS, "recon", "seconds"), more)


def lamps_verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Lamps and depth beat the guess and environment light; `auto` spoils nothing."""
    for setup, title in LAMPS.conditions.items():
        for name in MAPS:
            for other in ("constant", HARMONICS):
                yield from of_bars(results, [_bar(LAMPS, setup, NEAR, other, name)])
        near = results.of(condition=setup, way=NEAR)
        if near.finished:
            what = f"{title}, {OF_LAMPS[NEAR].words}: lamps off by, cm"
            yield Verdict(what, near.mean("lamps", "cm").mean, CENTIMETRES)
        for way, other in (("auto", HARMONICS), ("auto-depth", "sh-depth")):
            yield from of_bars(results, [_bar(LAMPS, setup, way, other)])


def lamps_sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, where lamps were found, and maps of the first room."""
    words = {way.words: way.words for way in OF_LAMPS.values()}
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
        [dots("lamps", found, words, MAPS)] if results.finished else [],
    )
    yield from _sheets(LAMPS, results)
