"""Rows, ratios and the plot of rooms that are explained in several ways."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pbrfit_evaluation import cycles
from pbrfit_evaluation.explained import ROWS, Case
from pbrfit_evaluation.explained.variants import Variant
from pbrfit_evaluation.panels import unpacked
from pbrfit_evaluation.suite import Results, Row

Of = Results[Case]

Panels = Mapping[str, Mapping[str, NDArray[np.float64]]]
"""Of cases, by label and name."""


def each(results: Of, variants: Sequence[Variant]) -> Iterator[tuple[str, Variant, Of]]:
    """Setups and variants that were asked for, with their cases."""
    for setup in results.options.setups:
        for variant in variants:
            if variant.key in results.options.variants:
                yield setup, variant, results.of(setup=setup, variant=variant.key)


def rows(
    results: Of,
    variants: Sequence[Variant],
    measured: Callable[[Variant, Of], Mapping[str, float | None]],
) -> list[Row]:
    """A row a setup, by its name, and variant; one that was not run says why."""
    found = []
    for setup, variant, of in each(results, variants):
        about = ROWS[setup][1], len(of.finished), variant.words
        if not of.pairs:
            found.append(Row(*about, {}, status=f"not run: {cycles.why_not()}"))
            continue
        status = of.status("rooms")
        found.append(Row(*about, measured(variant, of), status=status, guess=variant.guess))
    return found


def ratio(results: Of, setup: str, name: str, variant: str, other: str) -> float:
    """Mean error of a variant over that of another, of the rooms that both have; else NaN."""
    one, two = (results.of(setup=setup, variant=key) for key in (variant, other))
    return one.over(two, name)


def panels(results: Of, words: Mapping[str, str]) -> Panels:
    """Panels of the cases that kept some, by words for their variants, in the order of these."""
    kept = {
        case.variant: values["panels"] for case, values in results.finished if "panels" in values
    }
    return {words[key]: unpacked(kept[key]) for key in words if key in kept}
