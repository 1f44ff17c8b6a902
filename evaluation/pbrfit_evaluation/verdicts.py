"""Figures and what they have to be: what a suite that has bars says of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from pbrfit.report.notation import scientific
from pbrfit_evaluation.page import Cell, Section, Table

PartOf = TypeVar("PartOf", bound=str)
"""The names of a suite's parts."""


@dataclass(frozen=True)
class Verdict(Generic[PartOf]):
    """A figure and what it has to be.

    Attributes
    ----------
    part
        Of the suite.
    what
        In words.
    value
        The figure.
    bar
        At most this; at least, where `at_least`.
    where
        What else belongs to the figure.
    """

    part: PartOf
    what: str
    value: float
    bar: float
    where: str = ""
    at_least: bool = False

    @property
    def holds(self) -> bool:
        """A figure that is not a number holds nothing."""
        return self.value >= self.bar if self.at_least else self.value <= self.bar


_FAILS = "does\N{NO-BREAK SPACE}not\N{NO-BREAK SPACE}hold"


def digits(value: float) -> str:
    """Three digits, so that 1.02 is told from 1; powers of ten for what is small or large."""
    if value == 0 or (math.isfinite(value) and 0.01 <= abs(value) < 1e4):
        return f"{value:.3g}"
    return scientific(value)


def _bar(verdict: Verdict[PartOf]) -> str:
    """What the figure has to be."""
    return f"{'≥' if verdict.at_least else '≤'} {digits(verdict.bar)}"


def lines(judged: Sequence[Verdict[PartOf]]) -> list[str]:
    """The verdicts, for a terminal."""
    return [
        f"{'holds' if v.holds else 'FAILS':<7}{digits(v.value):>12} {_bar(v):>10}  {v.what}"
        + (f"  ({v.where})" if v.where else "")
        for v in judged
    ]


def must_hold(judged: Sequence[Verdict[PartOf]], said: Sequence[str] = ()) -> Section:
    """The verdicts, for a page."""
    columns = [
        Cell("Part", "name"),
        Cell("What"),
        Cell("Found", "number"),
        Cell("Must be", "number"),
        Cell("Verdict"),
        Cell("Where"),
    ]
    rows = []
    part = ""
    for verdict in judged:
        rows.append(
            [
                Cell("" if verdict.part == part else verdict.part, "name"),
                Cell(verdict.what),
                Cell(digits(verdict.value), "number", verdict.value),
                Cell(_bar(verdict), "number"),
                Cell("holds", "pass") if verdict.holds else Cell(_FAILS, "fail"),
                Cell(verdict.where, "why"),
            ]
        )
        part = verdict.part
    return Section("What must hold", list(said), [Table(columns, rows)])
