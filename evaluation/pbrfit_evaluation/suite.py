"""What a suite is: cases, how one is run, figures, verdicts; and what its report shows.

How to add a suite `speed`:

1. A package `pbrfit_evaluation/speed` whose `figures.py` has `SUITE = Suite("speed", ...)`, and a
   line in `commands.SUITES` with its name and summary. That gives `pbrfit evaluate speed` with
   `--out`, `--overwrite`, `--resume`, `--jobs`, `--cluster`, `--quiet` and `--quick`.
2. `cases(options)` returns frozen dataclasses that can be pickled, with a `key` that is unique and
   fit for a file; their `repr` says all that the result depends on. It checks the options, too.
3. `run(case, threads)` measures one, in any process, and returns values that JSON can hold. They
   are kept in `records/KEY.json`; `--resume` uses them again if case and code are the same.
4. `rows(results)` makes the rows of summary.json from what was finished, which may be nothing.
5. `verdicts(results, rows)` says what the figures must be; `sections(results, rows)` is what the
   page shows beside them: tables as data, and PNGs of plots (`plots`) and maps.
6. Sizes and counts are `settings`, each with its option (`options`). Files named `figures.py` do
   not count as code that records depend on.

Suites of scenes whose truth is known are scenes × conditions × ways: `grid` has their cases, rows,
bars and sheets.

Nothing here writes or measures: `commands` builds the command and runs it, `jobs` keeps records,
`report` writes.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from pbrfit.report.html import Cell
from pbrfit.report.notation import scientific
from pbrfit_evaluation.jobs import Record, Task, Values
from pbrfit_evaluation.options import Setting

Options = argparse.Namespace
"""As given on the command line, settled: `options.effort` is "full" or "quick"."""


C = TypeVar("C", bound=Task)
C_co = TypeVar("C_co", bound=Task, covariant=True)
"""A case: what is measured at a time."""


# ------------------------------------------------------------------------------ what is measured


@dataclass(frozen=True)
class Mean:
    """Mean over `count` scenes and its bootstrap interval.

    `low` and `high` are NaN for a single scene, all three without any.
    """

    mean: float
    low: float
    high: float
    count: int


def mean_with_interval(values: Iterable[float]) -> Mean:
    """Mean of the numbers that are finite, with a percentile bootstrap interval of 95 %.

    Scenes are drawn again with replacement, 2000 times from a fixed seed (Efron 1979), so the
    interval says how far the mean depends on which scenes happened to be in the set.
    """
    from scipy.stats import bootstrap

    finite = np.array([value for value in values if math.isfinite(value)], dtype=np.float64)
    if not finite.size:
        return Mean(math.nan, math.nan, math.nan, 0)
    mean = float(finite.mean())
    if finite.size == 1:
        return Mean(mean, math.nan, math.nan, 1)
    found = bootstrap(
        (finite,),
        np.mean,
        n_resamples=2000,
        confidence_level=0.95,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    interval = found.confidence_interval
    return Mean(mean, float(interval.low), float(interval.high), finite.size)


@dataclass(frozen=True)
class Results(Generic[C_co]):
    """Cases of a suite with their records, in the order of the cases."""

    options: Options
    pairs: Sequence[tuple[C_co, Record]]

    def of(self, **facts: object) -> Results[C_co]:
        """Those of the cases whose attributes have these values."""
        same = [
            (case, record)
            for case, record in self.pairs
            if all(getattr(case, name, None) == value for name, value in facts.items())
        ]
        return Results(self.options, same)

    @property
    def finished(self) -> list[tuple[C_co, Values]]:
        """Cases that ended well, with what they found."""
        return [(case, record.values) for case, record in self.pairs if record.values is not None]

    @property
    def failed(self) -> list[Record]:
        """Records of the others."""
        return [record for _, record in self.pairs if record.error is not None]

    def status(self, what: str = "cases") -> str:
        """For a row: "ok", or how many failed."""
        failed = len(self.failed)
        return f"{failed} of {len(self.pairs)} {what} failed" if failed else "ok"

    def numbers(self, *path: str) -> list[float]:
        """The number at a path of names in what each case found; cases without one left out."""
        found = []
        for _, value in self.finished:
            at: Any = value
            for name in path:
                at = at.get(name) if at is not None else None
            if at is not None:
                found.append(float(at))
        return found

    def mean(self, *path: str) -> Mean:
        """Mean of `numbers`, with its interval."""
        return mean_with_interval(self.numbers(*path))

    def average(self, *path: str) -> float:
        """Mean of `numbers`; NaN without any."""
        found = self.numbers(*path)
        return sum(found) / len(found) if found else math.nan

    def over(self, other: Results[Any], name: str) -> float:
        """Mean score over that of others, of seeds that both have; NaN without any, or over 0."""
        one, two = (
            {vars(case)["seed"]: values["scores"][name] for case, values in of.finished}
            for of in (self, other)
        )
        both = one.keys() & two.keys()
        sums = [sum(scores[seed] for seed in sorted(both)) for scores in (one, two)]
        return sums[0] / sums[1] if sums[1] else float("nan")

    def metrics(self, names: Iterable[str], *path: str) -> dict[str, float | None]:
        """For a row: means of names below a path, and NAME_low and NAME_high of their intervals.

        NaN where no case has the number.
        """
        found: dict[str, float | None] = {}
        for name in names:
            of = self.mean(*path, name)
            found |= {name: of.mean, f"{name}_low": of.low, f"{name}_high": of.high}
        return found


@dataclass(frozen=True)
class Row:
    """One line of a suite's results, as in summary.json."""

    name: str
    """What the line is about."""
    scenes: int
    """How many scenes were measured, 0 where it is not about scenes."""
    solver: str | None
    """The one that was run, None where there is none."""
    metrics: Mapping[str, float | None]
    """Figures by name. What is not a finite number is written as null."""
    paper: Mapping[str, float] | None = None
    """The paper's figures under the same names, where it has any."""
    status: str = "ok"
    """"ok", "not held", or why the line was not run."""
    guess: bool = False
    """Whether nothing was fitted, so that no figure is marked as the best; not in summary.json."""
    private: bool = False
    """Whether documentation leaves out rows of this name, and lines of tables that begin with it.
    """


@dataclass(frozen=True)
class Verdict:
    """A figure and what it has to be."""

    what: str
    """In words."""
    value: float
    """The figure; one that is not a number holds nothing."""
    bar: float | None
    """At most this; at least, where `at_least`. None = reported only."""
    where: str = ""
    """What else belongs to the figure: where the worst was found, why the bar is what it is."""
    at_least: bool = False
    part: str = ""
    """Of what it judges, where that has several."""

    @property
    def holds(self) -> bool:
        """Whether the figure is what it has to be."""
        if self.bar is None:
            return True
        return self.value >= self.bar if self.at_least else self.value <= self.bar

    @property
    def row(self) -> Row:
        """The verdict as a row of summary.json."""
        bar = {} if self.bar is None else {"bar": self.bar, "at_least": float(self.at_least)}
        name = f"{self.part}: {self.what}" if self.part else self.what
        status = "ok" if self.holds else "not held"
        return Row(name, 0, None, {"value": self.value, **bar}, status=status)


# ------------------------------------------------------------------------------ what is shown


@dataclass(frozen=True)
class Column:
    """A metric as a column: its heading, and which of its values is the best (none if None)."""

    metric: str
    heading: str = ""
    best: Literal["low", "high"] | None = None


Value = str | float | Cell | None
"""In a table: text, a number, None where there is none, or a cell as it is."""


@dataclass(frozen=True)
class Table:
    """Headings, and rows with a value for each."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Value]]

    @classmethod
    def of(cls, rows: Sequence[Row], columns: Sequence[Column | str] = ()) -> Table:
        """Rows of summary.json as a table, with intervals and what went wrong.

        `columns` are metrics, all of them by default. Among rows of one name the best of a column
        is bold.
        """
        if not columns:
            names = dict.fromkeys(name for row in rows for name in row.metrics)
            bounds = {f"{name}{end}" for name in names for end in ("_low", "_high")}
            columns = [name for name in names if name not in bounds]
        shown = [Column(one) if isinstance(one, str) else one for one in columns]
        solvers = any(row.solver for row in rows)
        scenes = any(row.scenes for row in rows)
        status = any(row.status != "ok" for row in rows)
        head = ["", *(["scenes"] if scenes else []), *(["solver"] if solvers else [])]
        head += [one.heading or one.metric.replace("_", " ") for one in shown]
        made: list[Sequence[Value]] = []
        for before, row in zip([None, *rows], rows, strict=False):
            first = before is None or before.name != row.name
            alike = [other for other in rows if other.name == row.name and not other.guess]
            line: list[Value] = [row.name if first else ""]
            line += [float(row.scenes) if first else ""] if scenes else []
            line += [row.solver or ""] if solvers else []
            line += [figure(row, one, alike) for one in shown]
            line += [Cell("" if row.status == "ok" else row.status, "note")] if status else []
            made.append(line)
        return cls([*head, "status"] if status else head, made)


def figure(row: Row, column: Column, alike: Sequence[Row]) -> Cell | None:
    """A metric of a row with its interval, bold if it is the best of the rows alike."""
    value = row.metrics.get(column.metric)
    if value is None or value != value:
        return None
    low, high = (row.metrics.get(f"{column.metric}_{end}") for end in ("low", "high"))
    text = digits(value)
    if low is not None and high is not None and low == low:
        text += f"\n[{digits(low)}, {digits(high)}]"
    best = False
    if column.best and not row.guess and len(alike) > 1:
        others = [v for other in alike if (v := other.metrics.get(column.metric)) is not None]
        others = [v for v in others if v == v]
        best = value == (min(others) if column.best == "low" else max(others))
    return Cell(text, "best" if best else "number", value)


def digits(value: float) -> str:
    """Three digits, so that 1.02 is told from 1; powers of ten for what is small or large."""
    if abs(value) < 1e4 and value == int(value):
        return f"{value:.0f}"
    return f"{value:#.3g}".rstrip(".") if 0.001 <= abs(value) < 999.5 else scientific(value)


@dataclass(frozen=True)
class Picture:
    """A PNG: a plot (`plots`) or a sheet of maps (`pbrfit.result.sheet`)."""

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class Section:
    """A heading of the page, what has to be said, tables and pictures."""

    title: str
    text: str = ""
    tables: Sequence[Table] = ()
    figures: Sequence[Picture] = ()


Line = Mapping[str, object]
"""A line of a CSV file, values by column."""


def csv_files(results: Results[Any]) -> dict[str, list[Line]]:
    """What was found, by file name: in scenes.csv a line a case, with what the case is.

    Of a list of mappings NAME, such as a curve, there is NAME.csv with a line for each. Pictures
    (`panels.packed`) are in the records alone.
    """
    files: dict[str, list[Line]] = {"scenes.csv": []}
    for case, values in results.finished:
        head = dict(flat(asdict(case)))
        scores = values.get("scores", {})
        files["scenes.csv"].append(
            head | dict(flat(scores)) | dict(flat({**values, "scores": None}))
        )
        for name, of in values.items():
            if isinstance(of, list) and of and isinstance(of[0], Mapping):
                files.setdefault(f"{name}.csv", []).extend(head | dict(flat(one)) for one in of)
    return files


def flat(values: Mapping[str, Any], before: str = "") -> Iterable[tuple[str, float | str]]:
    """Numbers and words by their path; not lists of others, nor pictures (`panels.packed`)."""
    for name, value in values.items():
        if isinstance(value, Mapping) and "png" not in value:
            yield from flat(value, f"{before}{name}/")
        elif isinstance(value, (str, int, float)):
            yield f"{before}{name}", value
        elif isinstance(value, list) and all(isinstance(one, str) for one in value):
            yield f"{before}{name}", " ".join(value)


# ------------------------------------------------------------------------------ the suite


def _nothing(*_: Any) -> tuple[()]:
    return ()


def _all_rows(_: Any, rows: Sequence[Row]) -> Sequence[Section]:
    return [Section("Figures", tables=[Table.of(rows)])]


@dataclass(frozen=True)
class Suite(Generic[C]):
    """A sub-command of `pbrfit evaluate`."""

    name: str
    title: str
    """`name` and `title`: of the command, and of its report."""
    protocol: str
    """Name and version of how things are measured: results under one name compare. `{size}` and the
    like are replaced by the options."""
    cases: Callable[[Options], Sequence[C]]
    run: Callable[[C, int], Values]
    rows: Callable[[Results[C]], Sequence[Row]]
    _: KW_ONLY
    verdicts: Callable[[Results[C], Sequence[Row]], Iterable[Verdict]] = _nothing
    sections: Callable[[Results[C], Sequence[Row]], Iterable[Section]] = _all_rows
    """`cases`, `run`, `rows`, `verdicts` and `sections`: see the top of this file."""
    files: Callable[[Results[C]], Mapping[str, bytes]] = lambda _: {}
    """Other files than CSV ones, by name."""
    settings: Mapping[str, Setting] = field(default_factory=dict)
    """By the names that options have in `cases`."""
    folders: str = ""
    """What the folders of pictures are that the command takes; empty = it takes none."""
    about: Sequence[str] = ()
    """Paragraphs at the top of the page, that a reader needs to read the figures; the first, on
    what is measured, is in the help, too."""
    jobs: int | None = None
    """Default of `--jobs`; None = one for each processor."""
    timed: bool = False
    """Whether figures are times on this machine, so that no cluster can be used."""

    def settle(self, options: Options) -> None:
        """Give options what nobody asked for."""
        options.effort = "quick" if options.quick else "full"
        for name, setting in self.settings.items():
            if getattr(options, name, None) is None:
                setattr(options, name, getattr(setting, options.effort))

    def protocol_of(self, options: Options) -> str:
        """The protocol with the options' values in it."""
        return self.protocol.format_map(vars(options))
