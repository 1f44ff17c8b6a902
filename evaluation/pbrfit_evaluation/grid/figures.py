"""What suites of a `Grid` make of their records: rows, bars and sheets of maps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from pbrfit_evaluation.arrays import worst
from pbrfit_evaluation.grid import Case, Grid
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.panels import beside_truth, unpacked
from pbrfit_evaluation.suite import Picture, Results, Row, Section, Verdict

Of = Results[Case]
Metrics = Mapping[str, float | None]


def by_seed(results: Of, condition: str, way: str, *path: str) -> dict[int, float]:
    """The number at a path of names of each scene."""
    of = results.of(condition=condition, way=way)
    return {case.seed: of.of(seed=case.seed).average(*path) for case, _ in of.finished}


def grid_rows(
    grid: Grid,
    results: Of,
    metrics: Sequence[str],
    more: Callable[[str, str, Of], Metrics] = lambda *_: {},
) -> list[Row]:
    """A row a condition and way: means of the scores, and what more is made of its cases."""
    found = []
    for condition, key in grid.each(results.options):
        of = results.of(condition=condition, way=key)
        way, why = grid.ways[key], grid.why_not(results.options, condition, key)
        status = f"not run: {why}" if why else of.status("scenes")
        values: dict[str, float | None] = {}
        if of.finished:
            values = {**of.metrics(metrics, "scores"), **more(condition, key, of)}
        about = grid.conditions[condition], len(of.finished), way.words or None
        found.append(Row(*about, values, status=status, guess=way.guess))
    return found


@dataclass(frozen=True)
class Bar:
    """What a mean error has to be, over that of other cases of the same seeds."""

    what: str
    """In words."""
    of: tuple[str, str]
    over: tuple[str, str] | None
    """`of` and `over`: condition and way; without `over` the error itself is judged."""
    names: Sequence[str]
    """Scores, of which the worst counts."""
    most: float
    """At most this."""
    part: str = ""
    """Of the verdict."""


def ratios(results: Of, bar: Bar) -> dict[str, float]:
    """By score what a bar judges; NaN where cases are missing."""
    one = results.of(condition=bar.of[0], way=bar.of[1])
    if bar.over is None:
        return {name: one.average("scores", name) for name in bar.names}
    other = results.of(condition=bar.over[0], way=bar.over[1])
    return {name: one.over(other, name) for name in bar.names}


def of_bars(results: Of, bars: Iterable[Bar]) -> Iterator[Verdict]:
    """Bars between cases that were both asked for; without any that finished nothing holds."""
    there = {(case.condition, case.way) for case, _ in results.pairs}
    for bar in bars:
        if {bar.of, bar.over or bar.of} <= there:
            found = ratios(results, bar)
            value, name = worst(found)
            where = name.replace("_", ", ") if len(found) > 1 else ""
            yield Verdict(bar.what, value, bar.most, where, part=bar.part)


def of_most(what: str, held: Mapping[int, float], least: int, part: str = "") -> Verdict:
    """How many scenes hold, by seed, of which it has to be at least so many."""
    missed = [str(seed) for seed, good in held.items() if not good]
    where = f"not: {', '.join(missed)}" if missed else ""
    return Verdict(what, len(held) - len(missed), least, where, at_least=True, part=part)


def sheets(
    title: str, results: Of, grid: Grid, caption: str, name: str = "maps", by: str = "way"
) -> Iterator[Section]:
    """A section of sheets of maps, where cases are pictured; see `pictures`."""
    labels = grid.words if by == "way" else grid.conditions
    if found := pictures(results, labels, caption, name, by):
        yield Section(title, figures=found)


def pictures(
    results: Of, labels: Mapping[str, str], caption: str, name: str = "maps", by: str = "way"
) -> list[Picture]:
    """A sheet of the maps of a scene beside the true ones: a line a way, or a condition.

    `labels` are those of the lines, by key. With lines of ways there is a sheet a condition.
    """
    sheets: dict[str, dict[str, Values]] = {}
    for case, values in results.finished:
        if "maps" in values:
            sheet = f"{name}-{case.condition}" if by == "way" else name
            sheets.setdefault(sheet, {})[getattr(case, by)] = values
    found = []
    for sheet, of in sheets.items():
        kept = {labels[key]: unpacked(of[key]["maps"]) for key in labels if key in of}
        found.append(Picture(sheet, caption, beside_truth(kept)))
    return found
