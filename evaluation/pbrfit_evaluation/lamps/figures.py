"""Rows, verdicts, a plot and maps of rooms under lamps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.sheet import Panel as SheetPanel
from pbrfit.result.sheet import Row as SheetRow
from pbrfit.result.sheet import as_png, sheet
from pbrfit_evaluation import cycles
from pbrfit_evaluation.lamps.measure import NAMES, Case, Setup
from pbrfit_evaluation.lamps.variants import BY_KEY, CONSTANT, HARMONICS, NEAR, VARIANTS
from pbrfit_evaluation.panels import unpacked
from pbrfit_evaluation.suite import (
    Column,
    Line,
    Panel,
    Picture,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Verdict,
    numbers_csv,
)

Of = Results[Case]

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
"""Mean error of `auto` over that of light from all around, told the same, at most."""

CENTIMETRES = 5.0
"""Median distance of lamps from true ones, at most, with true depth."""


def _lines(results: Of) -> Iterator[tuple[Setup, str]]:
    for setup in results.options.setups:
        for variant in VARIANTS:
            if variant.key in results.options.variants:
                yield setup, variant.key


def rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""
    found = []
    for setup, key in _lines(results):
        of, variant = results.of(setup=setup, variant=key), BY_KEY[key]
        if not of.pairs:
            why = cycles.why_not()
            found.append(Row(NAMES[setup], 0, variant.words, {}, status=f"not run: {why}"))
            continue
        measured = of.metrics(METRICS, "scores")
        measured |= {f"lamps_{name}": of.mean("lamps", name).mean for name in PLACES}
        scenes, status = len(of.finished), of.status("rooms")
        found.append(
            Row(NAMES[setup], scenes, variant.words, measured, status=status, guess=variant.guess)
        )
    return found


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Lamps and depth beat the guess and light from all around; `auto` spoils nothing."""
    for setup, key in _lines(results):
        of, variant = results.of(setup=setup, variant=key), BY_KEY[key]
        if not of.finished:
            continue
        case = f"{NAMES[setup]}, {variant.words}"
        if key == NEAR:
            for name in ERRORS:
                for other in (CONSTANT, HARMONICS):
                    over = ratio(results, setup, name, key, other)
                    if not math.isnan(over):
                        words = BY_KEY[other].words
                        yield Verdict(f"{case}: {name} over that of {words}", over, BETTER)
            off = of.mean("lamps", "cm").mean
            yield Verdict(f"{case}: lamps off by, cm", off, CENTIMETRES)
        if variant.light == "auto":
            other = "sh-depth" if variant.depth else HARMONICS
            ratios = {name: ratio(results, setup, name, key, other) for name in ERRORS}
            name = max(ratios, key=lambda one: ratios[one])
            if not math.isnan(ratios[name]):
                what = f"{case}: worst error over that of {BY_KEY[other].words}"
                yield Verdict(what, ratios[name], SPOILT, name)


def ratio(results: Of, setup: Setup, name: str, variant: str, other: str) -> float:
    """Mean error of a variant over that of another, of the rooms that both have; else NaN."""
    one, two = (
        {case.seed: values["scores"][name] for case, values in of.finished}
        for of in (results.of(setup=setup, variant=key) for key in (variant, other))
    )
    both = sorted(one.keys() & two.keys())
    if not both:
        return math.nan
    return float(np.mean([one[seed] for seed in both]) / np.mean([two[seed] for seed in both]))


def csvs(results: Of, _: object) -> dict[str, list[Line]]:
    """Every number of every room."""
    return {"scenes.csv": numbers_csv("lamps", results)}


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, where lamps were found, and maps of the first room."""
    yield Section(
        "Errors",
        "RMSE of the maps, linear values. Lamps: medians over the pictures of a room, means over "
        "rooms; degrees as seen from the middle of the surfaces.",
        [Table.of(found, COLUMNS)],
        [_plot(found)] if results.finished else [],
    )
    sheets = [
        Picture(f"maps-{setup}", f"{NAMES[setup]}: the first room.", as_png(drawn))
        for setup in results.options.setups
        if (drawn := _maps(results.of(setup=setup))) is not None
    ]
    if sheets:
        yield Section("Maps", "White is 1 in roughness and metallic.", figures=sheets)


def _plot(found: Sequence[Row]) -> Plot:
    """A panel an error, a line a setup, a colour a variant."""
    panels = []
    for name in ERRORS:
        series = []
        for look, variant in enumerate(VARIANTS):
            of = [row for row in found if row.solver == variant.words and row.scenes]
            mean, low, high = (
                [row.metrics[f"{name}{end}"] or math.nan for row in of]
                for end in ("", "_low", "_high")
            )
            if of:
                names = [row.name for row in of]
                series.append(Series(variant.words, mean, names, low=low, high=high, look=look))
        panels.append(Panel("dots", series, f"{name} RMSE", log="x"))
    setups = len({row.name for row in found if row.scenes})
    return Plot(
        "lamps",
        "The same as a plot, with intervals.",
        panels,
        columns=len(ERRORS),
        share_y="all",
        size=(2.8, 0.8 + 1.2 * setups),
    )


def _maps(results: Of) -> NDArray[np.uint8] | None:
    """A line a variant below the true maps; None without any."""
    kept = {
        case.variant: unpacked(values["panels"])
        for case, values in results.finished
        if "panels" in values
    }
    if not kept:
        return None
    first = next(iter(kept.values()))
    true = [SheetPanel(name, first[f"true {name}"]) for name in ERRORS]
    grid: list[SheetRow] = [[*true, SheetPanel("a picture", first["picture"])]]
    labels = ["truth"]
    for variant in VARIANTS:
        if variant.key in kept:
            grid.append([SheetPanel("", kept[variant.key][name]) for name in ERRORS])
            labels.append(variant.words)
    return sheet(grid, labels=labels)
