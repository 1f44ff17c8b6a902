"""Rows, verdicts, a plot and maps of rooms under lamps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from pbrfit_evaluation.explained import ROWS
from pbrfit_evaluation.explained import figures as explained
from pbrfit_evaluation.explained.figures import Of, ratio
from pbrfit_evaluation.explained.variants import (
    BY_KEY,
    GUESS,
    HARMONICS,
    NEAR,
    OF_LAMPS,
    Variant,
)
from pbrfit_evaluation.panels import beside_truth
from pbrfit_evaluation.suite import Column, Picture, Row, Section, Table, Verdict, dots

WORDS = {variant.words: variant.words for variant in OF_LAMPS}

ERRORS = ("albedo", "roughness", "metallic")
METRICS = (*ERRORS, "recon", "seconds")
PLACES = ("cm", "degrees", "near")

COLUMNS = (
    *(Column(name, best="low") for name in ERRORS),
    Column("recon"),
    Column("lamps_cm", "lamps off by,\nmedian, cm", best="low"),
    Column("lamps_degrees", "median,\ndegrees", best="low"),
    Column("lamps_near", "share found\nnear"),
    Column("seconds"),
)

BETTER = 1.0
"""Mean error with lamps and depth over that of the constant guess, and over that of light from all
around, at most."""

SPOILT = 1.03
"""Mean error of `auto` over that of environment light, given the same, at most."""

CENTIMETRES = 5.0
"""Median distance of lamps from true ones, at most, with true depth."""


def rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def measured(_: Variant, of: Of) -> dict[str, float | None]:
        lamps = {f"lamps_{name}": of.mean("lamps", name).mean for name in PLACES}
        return of.metrics(METRICS, "scores") | lamps

    return explained.rows(results, OF_LAMPS, measured)


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Lamps and depth beat the guess and environment light; `auto` spoils nothing."""
    for setup, variant, of in explained.each(results, OF_LAMPS):
        if not of.finished:
            continue
        case = f"{ROWS[setup][1]}, {variant.words}"
        if variant.key == NEAR:
            for name in ERRORS:
                for other in (GUESS.key, HARMONICS):
                    over = ratio(results, setup, name, NEAR, other)
                    if not math.isnan(over):
                        words = BY_KEY[other].words
                        yield Verdict(f"{case}: {name} over that of {words}", over, BETTER)
            off = of.mean("lamps", "cm").mean
            yield Verdict(f"{case}: lamps off by, cm", off, CENTIMETRES)
        if variant.options.get("light") == "auto":
            other = "sh-depth" if variant.depth == "true" else HARMONICS
            ratios = {name: ratio(results, setup, name, variant.key, other) for name in ERRORS}
            name = max(ratios, key=lambda one: ratios[one])
            if not math.isnan(ratios[name]):
                what = f"{case}: worst error over that of {BY_KEY[other].words}"
                yield Verdict(what, ratios[name], SPOILT, name)


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, where lamps were found, and maps of the first room."""
    yield Section(
        "Errors",
        "RMSE of the maps, linear values. Lamps: medians over the pictures of a room, means over "
        "rooms; degrees as seen from the middle of the surfaces.",
        [Table.of(found, COLUMNS)],
        [dots("lamps", found, WORDS, ERRORS)] if results.finished else [],
    )
    words = {variant.key: variant.words for variant in OF_LAMPS}
    sheets = [
        Picture(f"maps-{setup}", f"{ROWS[setup][1]}: the first room.", png)
        for setup in results.options.setups
        for kept in [explained.panels(results.of(setup=setup), words)]
        if kept
        for png in [beside_truth(kept, ERRORS, "picture")]
    ]
    if sheets:
        yield Section("Maps", "White is 1 in roughness and metallic.", figures=sheets)
