"""Rows, verdicts, the plot and strips of relit pictures."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.sheet import Panel as SheetPanel
from pbrfit.result.sheet import as_png, sheet
from pbrfit_evaluation.explained import figures as explained
from pbrfit_evaluation.explained.figures import Of, ratio
from pbrfit_evaluation.suite import (
    Column,
    Line,
    Picture,
    Row,
    Section,
    Table,
    Verdict,
    numbers_csv,
)
from pbrfit_evaluation.transport.measure import NAMES, PICTURED, SHOWN
from pbrfit_evaluation.transport.variants import TRUE, VARIANTS, WITHOUT, Variant

ERRORS = ("albedo", "roughness", "metallic", "relight")
METRICS = (*ERRORS, "recon", "seconds")
FACTS = ("depth_off", "normals_off", "segments", "purity")
CHOICES = ("none", "occlusion", "bounce")

CONSTANT = "constant"

BETTER = 1.0
"""Mean error with true depth over that of the constant guess and over that without depth, at most:
where light is blocked, geometry has to be worth something."""

SPOILT = 1.03
"""Mean error with any geometry over that without, at most: what `auto` takes has to be no worse."""


def rows(results: Of) -> list[Row]:
    """A row a setup and variant; one that was not run says why."""

    def measured(variant: Variant, of: Of) -> dict[str, float | None]:
        found = of.metrics(METRICS, "scores")
        found |= {name: of.mean("facts", name).mean for name in FACTS}
        if variant.transport is not None:
            chosen = [values["choice"] for _, values in of.finished]
            found |= {f"chose_{one}": _share(chosen, one) for one in CHOICES}
        return found

    return explained.rows(results, NAMES, VARIANTS, measured)


def _share(chosen: Sequence[str], one: str) -> float:
    return chosen.count(one) / len(chosen) if chosen else math.nan


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """True depth beats the guess and what is found without it; no variant spoils anything."""
    for setup, variant, of in explained.each(results, VARIANTS):
        if variant.transport is None or not of.finished:
            continue
        case, key = f"{NAMES[setup]}, {variant.words}", variant.key
        worst = {name: ratio(results, setup, name, key, WITHOUT) for name in ERRORS}
        if key == TRUE and setup != "brdf":
            for name in ERRORS:
                over = ratio(results, setup, name, key, CONSTANT)
                yield Verdict(f"{case}: {name} over the constant guess", over, BETTER)
                yield Verdict(f"{case}: {name} over that without depth", worst[name], BETTER)
            continue
        name = max(worst, key=lambda one: worst[one])
        yield Verdict(f"{case}: worst error over that without depth", worst[name], SPOILT, name)


def csvs(results: Of, _: object) -> dict[str, list[Line]]:
    """Every number of every room, and what was chosen."""
    chosen: list[Line] = [
        {"part": "transport", "task": case.key, "figure": "choice", "value": values["choice"]}
        for case, values in results.finished
    ]
    return {"scenes.csv": [*numbers_csv("transport", results), *chosen]}


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, what was told and chosen, and relit pictures."""
    yield Section(
        "Errors",
        "RMSE, linear values.",
        [Table.of(found, [*(Column(name, best="low") for name in ERRORS), "recon", "seconds"])],
        [explained.plot("transport", found, VARIANTS, ERRORS)] if results.finished else [],
    )
    headings = {
        "depth_off": "depth off by,\nrelative",
        "normals_off": "its normals\noff by, degrees",
        "purity": "pixels of their\nsegment's object",
    } | {f"chose_{one}": f"share of rooms:\n{one}" for one in CHOICES}
    run = [row for row in found if row.scenes and not row.guess]
    told = [*FACTS, *(f"chose_{one}" for one in CHOICES)]
    yield Section(
        "What fits were given, and what they chose",
        "Depth after the best common factor.",
        [Table.of(run, [Column(name, headings.get(name, "")) for name in told])],
    )
    strips = [
        Picture(f"relit-{setup}", _caption(setup), as_png(strip))
        for setup in results.options.setups
        if (strip := relit(results.of(setup=setup))) is not None
    ]
    if strips:
        yield Section("Relit pictures", "The first room of each setup.", figures=strips)


def _caption(setup: str) -> str:
    return f"{NAMES[setup]}: pictures of light that the fit has not seen."


def relit(results: Of) -> NDArray[np.uint8] | None:
    """Sheet of Cycles' pictures beside relit ones, a line for each light; None without any."""
    kept = {case.variant: v["pictures"] for case, v in results.finished if "pictures" in v}
    if not kept:
        return None
    columns = {"Cycles": _decoded(next(iter(kept.values())), "cycles")}
    captions = {WITHOUT: "relit, without geometry", TRUE: "relit, with true depth"}
    columns |= {captions[key]: _decoded(kept[key], "relit") for key in PICTURED if key in kept}
    shown = min(SHOWN, *(len(of) for of in columns.values()))
    grid: list[list[SheetPanel | None]] = [
        [SheetPanel(name if i == 0 else "", of[i]) for name, of in columns.items()]
        for i in range(shown)
    ]
    return sheet(grid)


def _decoded(pictures: dict[str, Any], name: str) -> NDArray[np.float64]:
    levels = np.frombuffer(base64.b64decode(pictures[name]), np.uint8)
    return np.asarray(levels.reshape(pictures["shape"]) / 255)
