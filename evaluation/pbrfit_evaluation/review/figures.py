"""The review's rates as rows, verdicts and tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from pbrfit_evaluation.options import Setting, first_seed
from pbrfit_evaluation.review.measure import Task, cases, work
from pbrfit_evaluation.review.pictures import REPAINTS
from pbrfit_evaluation.suite import Results, Row, Section, Suite, Table, Verdict

LEAST_CAUGHT = 0.95
MOST_REFUSED = 0.05

GROUPS: dict[str, tuple[str, ...]] = {
    "shift": ("shift",),
    "warp": ("warp",),
    "repaint": REPAINTS,
    "swap": ("swap",),
}
"""What has to be caught, by the damages it is made of."""

JUDGED: dict[str, tuple[tuple[str, ...], bool]] = {
    "all damage": (tuple(damage for kinds in GROUPS.values() for damage in kinds), True),
    **{name: (kinds, True) for name, kinds in GROUPS.items()},
    "honest": (("honest",), False),
    "honest among damaged": (("honest",), True),
}
"""What is counted: kinds of damage, and whether judged among damaged pictures."""


@dataclass(frozen=True)
class Rate:
    """How many of some pictures were refused."""

    refused: int
    pictures: int

    @property
    def share(self) -> float:
        """0 to 1; NaN of none."""
        return self.refused / self.pictures if self.pictures else math.nan

    def interval(self) -> tuple[float, float]:
        """Of 95 %, by Wilson's score (1927): what share lies behind so few pictures."""
        if not self.pictures:
            return math.nan, math.nan
        found = binomtest(self.refused, self.pictures).proportion_ci(method="wilson")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        """For people."""
        return f"{self.refused} of {self.pictures}"


def _judged(results: Results[Task]) -> Iterator[tuple[str, Rate, Verdict]]:
    """What is counted, how many, and what the share has to be; of no pictures, nothing holds."""
    pictures = [one for _, values in results.finished for one in values["judged"]]
    for name, (damages, among_damaged) in JUDGED.items():
        refused = [
            bool(one["refused"])
            for one in pictures
            if one["damage"] in damages and one["among_damaged"] == among_damaged
        ]
        of, honest = Rate(sum(refused), len(refused)), name.startswith("honest")
        bar = MOST_REFUSED if honest else LEAST_CAUGHT
        what = f"{name}: share refused"
        yield name, of, Verdict(what, of.share, bar, f"{of} pictures", at_least=not honest)


def rows(results: Results[Task]) -> list[Row]:
    """A row for all damage, each group of damages, and honest pictures."""
    found = []
    for name, of, verdict in _judged(results):
        low, high = of.interval()
        metrics = {
            "refused": of.refused,
            "pictures": of.pictures,
            "share": of.share,
            "share_low": low,
            "share_high": high,
            "least" if verdict.at_least else "most": verdict.bar,
        }
        found.append(Row(name, len(results.finished), None, metrics, status=verdict.row.status))
    return found


def verdicts(results: Results[Task], _: Sequence[Row]) -> list[Verdict]:
    """What the shares have to be."""
    return [verdict for _, _, verdict in _judged(results)]


def sections(_: Results[Task], rows: Sequence[Row]) -> Iterator[Section]:
    """The rates; what each picture was is in judged.csv."""
    columns = ("refused", "pictures", "share")
    yield Section("Rates", "With intervals of 95 %.", [Table.of(rows, columns)])


SOURCES = (
    ("furnished", "cycles-full", 1),
    ("furnished", "cycles", 4),
    ("detailed", "cycles", 2),
    ("furnished", "own", 3),
    ("detailed", "own", 3),
    ("textured", "own", 2),
    ("room", "own", 1),
    ("spheres", "own", 1),
)
"""Kinds of scenes, what renders them, and how many of each."""


SUITE = Suite(
    name="review",
    title="What the review of generated pictures finds",
    protocol="pbrfit-review-1: share of damaged pictures refused, and of honest ones",
    cases=cases,
    run=work,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    settings={
        "first_seed": first_seed("scene of a source", 6000),
        "sources": Setting(SOURCES, (("furnished", "own", 1), ("textured", "own", 1))),
        "size": Setting(512, 256),
        "pictures": Setting(16, 8),
        "sets": Setting(3, 1),
    },
    about=(
        "Renders of one view under many lights stand for the photograph and for pictures that a "
        "generator made of it. Some are damaged on purpose, five in each set. The review judges "
        "each against the photograph and then all together, as in `pbrfit generate`. Pictures are "
        "8-bit sRGB. Without Blender Cycles (make cycles-env), which casts hard shadows, only our "
        "own renders are judged.",
    ),
)
