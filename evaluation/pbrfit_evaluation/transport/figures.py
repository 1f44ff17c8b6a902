"""Rows, verdicts, the plot and strips of relit pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from pbrfit_evaluation.explained import ROWS
from pbrfit_evaluation.explained import figures as explained
from pbrfit_evaluation.explained.figures import Of, ratio
from pbrfit_evaluation.explained.variants import GUESS, OF_GEOMETRY, TRUE, WITHOUT, Variant
from pbrfit_evaluation.panels import in_lines
from pbrfit_evaluation.suite import Column, Picture, Row, Section, Table, Verdict, dots

WORDS = {variant.words: variant.words for variant in OF_GEOMETRY}

ERRORS = ("albedo", "roughness", "metallic", "relight")
METRICS = (*ERRORS, "recon", "seconds")
FACTS = ("depth_off", "normals_off", "segments", "purity")
CHOICES = ("none", "occlusion", "bounce")

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
        if variant.options:
            chosen = [values["choice"] for _, values in of.finished]
            count = len(chosen) or math.nan
            found |= {f"chose_{one}": chosen.count(one) / count for one in CHOICES}
        return found

    return explained.rows(results, OF_GEOMETRY, measured)


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """True depth beats the guess and what is found without it; no variant spoils anything."""
    for setup, variant, of in explained.each(results, OF_GEOMETRY):
        if not variant.options or not of.finished:
            continue
        case, key = f"{ROWS[setup][1]}, {variant.words}", variant.key
        worst = {name: ratio(results, setup, name, key, WITHOUT) for name in ERRORS}
        if key == TRUE and setup != "brdf":
            for name in ERRORS:
                over = ratio(results, setup, name, key, GUESS.key)
                yield Verdict(f"{case}: {name} over the constant guess", over, BETTER)
                yield Verdict(f"{case}: {name} over that without depth", worst[name], BETTER)
            continue
        name = max(worst, key=lambda one: worst[one])
        yield Verdict(f"{case}: worst error over that without depth", worst[name], SPOILT, name)


def sections(results: Of, found: Sequence[Row]) -> Iterator[Section]:
    """Errors, what was told and chosen, and relit pictures."""
    yield Section(
        "Errors",
        "RMSE, linear values.",
        [Table.of(found, [*(Column(name, best="low") for name in ERRORS), "recon", "seconds"])],
        [dots("transport", found, WORDS, ERRORS)] if results.finished else [],
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
    words = {WITHOUT: "relit, without geometry", TRUE: "relit, with true depth"}
    strips = [
        Picture(
            f"relit-{setup}",
            f"{ROWS[setup][1]}: pictures of light that the fit has not seen.",
            relit(kept),
        )
        for setup in results.options.setups
        if (kept := explained.panels(results.of(setup=setup), words))
    ]
    if strips:
        yield Section("Relit pictures", "The first room of each setup.", figures=strips)


def relit(kept: explained.Panels) -> bytes:
    """PNG of Cycles' pictures beside relit ones, a line for each light."""
    every = next(iter(kept.values()))
    return in_lines(
        {
            number: {
                "Cycles": every[f"Cycles {number}"],
                **{words: of[f"relit {number}"] for words, of in kept.items()},
            }
            for number in dict.fromkeys(name.split()[1] for name in every)
        }
    )
