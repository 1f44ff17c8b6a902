"""Rows, ratios and the plot of rooms that are explained in several ways."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Protocol, TypeVar

from pbrfit_evaluation import cycles
from pbrfit_evaluation.explained import Case
from pbrfit_evaluation.suite import Panel, Plot, Results, Row, Series

Of = Results[Case]


class Variant(Protocol):
    """A way to explain a room."""

    @property
    def key(self) -> str:
        """For files."""

    @property
    def words(self) -> str:
        """For people."""

    @property
    def guess(self) -> bool:
        """Whether nothing is fitted but the lights."""


V = TypeVar("V", bound=Variant)


def each(results: Of, variants: Sequence[V]) -> Iterator[tuple[str, V, Of]]:
    """Setups and variants that were asked for, with their cases."""
    for setup in results.options.setups:
        for variant in variants:
            if variant.key in results.options.variants:
                yield setup, variant, results.of(setup=setup, variant=variant.key)


def rows(
    results: Of,
    names: Mapping[str, str],
    variants: Sequence[V],
    measured: Callable[[V, Of], Mapping[str, float | None]],
) -> list[Row]:
    """A row a setup, by its name, and variant; one that was not run says why."""
    found = []
    for setup, variant, of in each(results, variants):
        about = names[setup], len(of.finished), variant.words
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


def plot(name: str, found: Sequence[Row], variants: Sequence[V], errors: Sequence[str]) -> Plot:
    """A panel an error, a line a setup, a colour a variant."""
    panels = []
    for error in errors:
        series = []
        for look, variant in enumerate(variants):
            of = [row for row in found if row.solver == variant.words and row.scenes]
            mean, low, high = (
                [row.metrics[f"{error}{end}"] or math.nan for row in of]
                for end in ("", "_low", "_high")
            )
            if of:
                names = [row.name for row in of]
                series.append(Series(variant.words, mean, names, low=low, high=high, look=look))
        panels.append(Panel("dots", series, f"{error} RMSE", log="x"))
    setups = len({row.name for row in found if row.scenes})
    size = (2.8, 0.8 + 1.2 * setups)
    caption = "The same as a plot, with intervals."
    return Plot(name, caption, panels, columns=len(errors), share_y="all", size=size)
