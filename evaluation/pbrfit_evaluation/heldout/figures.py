"""Held-out pictures as rows, verdicts and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pbrfit.report.html import Cell
from pbrfit_evaluation.heldout.light import Score, relative_error
from pbrfit_evaluation.heldout.measure import WAYS, Task, cases, run
from pbrfit_evaluation.heldout.sources import Source
from pbrfit_evaluation.options import count, several
from pbrfit_evaluation.suite import Results, Row, Section, Suite, Table, Value, Verdict, digits

MEAN_REGRET, WORST_REGRET = 1.05, 1.25
"""Bars of the default's regret: geometric mean over sets, and any set."""

BESIDE = ("paper", 1.0), ("paper", 1.1), ("lambert", 1.0), ("nearest", 1.0)
"""What the default is held against, and how many times its error may be."""

OURS = [key for key, way in WAYS.items() if not (way.baseline or way.lamps)]
"""Ways that find materials and are told no lamps."""

Of = Results[Task]

Scores = Sequence[Mapping[str, Any]]
"""Of pictures, as records keep them."""


@dataclass(frozen=True)
class OfSet:
    """A source in all ways, over all folds."""

    source: Source
    results: Of

    @cached_property
    def errors(self) -> dict[str, float]:
        """Error of the held-out pictures by a way's own kind of light, of ways without failures."""
        found = {way: together(self.results.of(way=way), "own", error_of) for way in WAYS}
        return {way: error for way, error in found.items() if error is not None}

    @property
    def regret(self) -> float:
        """Error of the default over the least of `OURS`; NaN where one of the two is missing."""
        ours = [error for way, error in self.errors.items() if way in OURS]
        default = self.errors.get("default", math.nan)
        return default / min(ours) if len(ours) > 1 else math.nan


def together(of: Of, light: str, figure: Callable[[Scores], float]) -> float | None:
    """A figure of all pictures by a kind of light; None without any, or where a fold failed."""
    scores = [one for _, values in of.finished for one in values.get(light) or ()]
    return figure(scores) if scores and not of.failed else None


def error_of(scores: Scores) -> float:
    """RMSE over RMS of pictures together."""
    return relative_error([Score(**one) for one in scores])


def psnr_of(scores: Scores) -> float:
    """PSNR in dB of pictures together, whose white is 1; infinite where nothing is left."""
    of = [Score(**one) for one in scores]
    left = math.fsum(one.samples * one.rmse**2 for one in of)
    return 10 * math.log10(sum(one.samples for one in of) / left) if left > 0 else math.inf


def sets(results: Of) -> list[OfSet]:
    """By source."""
    sources = dict.fromkeys(task.source for task, _ in results.pairs)
    return [OfSet(source, results.of(source=source)) for source in sources]


def rows(results: Of) -> list[Row]:
    """A row a source and way."""
    found = []
    for one in sets(results):
        for way in WAYS:
            of = one.results.of(way=way)
            if not of.pairs:
                continue
            reason = next((values.get("not_possible") for _, values in of.finished), None)
            failed = next((record.error for record in of.failed), None)
            metrics = {
                "own": one.errors.get(way),
                "lamp": together(of, "lamp", error_of),
                "psnr": together(of, "own", psnr_of),
                "normals_mean": of.mean("normals", "mean").mean,
                "normals_median": of.mean("normals", "median").mean,
                "seconds": of.mean("seconds").mean,
                "processor": of.mean("processor").mean,
                **({"regret": one.regret} if way == "default" else {}),
            }
            status = failed or (f"not possible: {reason}" if reason else "ok")
            name, private = one.source.name, one.source.private
            found.append(Row(name, 1, way, metrics, status=status, private=private))
    return found


def geometric_mean(values: Sequence[float]) -> float:
    """NaN of none."""
    return math.exp(math.fsum(map(math.log, values)) / len(values)) if values else math.nan


def _regrets(of_sets: Sequence[OfSet]) -> list[tuple[float, Source]]:
    """The worst first."""
    found = [(one.regret, one.source) for one in of_sets if not math.isnan(one.regret)]
    return sorted(found, key=lambda of: -of[0])


def verdicts(results: Of, _: object) -> Iterator[Verdict]:
    """Regret, unless the run was a quick look."""
    regrets = _regrets(sets(results))
    if results.options.effort == "quick" or not regrets:
        return
    worst, source = regrets[0]
    mean = geometric_mean([regret for regret, _ in regrets])
    where = "a set without a licence" if source.private else source.name
    yield Verdict(f"regret, geometric mean of {len(regrets)} sets", mean, MEAN_REGRET)
    yield Verdict("regret, worst set", worst, WORST_REGRET, where)


def sections(results: Of, rows: Sequence[Row]) -> Iterator[Section]:
    """The default beside the other ways, errors by set, and every figure."""
    of_sets = sets(results)
    if any(one.errors for one in of_sets):
        if any("default" in one.errors for one in of_sets):
            yield Section("In short", tables=[_in_short(of_sets)])
        yield Section(
            "Errors",
            "RMSE over RMS of the held-out pictures, in values of their files; 1 is that of "
            "black. The least of each set is bold.",
            [_by_way(of_sets)],
        )
    yield Section(
        "Figures",
        "Own: the same errors. Lamp: those of the same materials, each held-out picture explained "
        "by one far lamp and constant ambient light. PSNR is in dB, white being 1. Angles are to "
        "true normals, which no way is given, in degrees.",
        [Table.of(rows)],
    )


def _in_short(of_sets: Sequence[OfSet]) -> Table:
    regrets = [regret for regret, _ in _regrets(of_sets)]
    lines: list[list[Value]] = []
    if regrets:
        lines = [
            ["regret, geometric mean", digits(geometric_mean(regrets))],
            ["regret, worst set", digits(regrets[0])],
        ]
    for way, factor in BESIDE:
        both = [one.errors for one in of_sets if {"default", way} <= one.errors.keys()]
        held = sum(of["default"] <= factor * of[way] for of in both)
        most = "at most" if factor == 1 else f"at most {factor:g} times"
        what = f"sets with {most} the error of: {WAYS[way].words}"
        lines += [[what, f"{held} of {len(both)}"]] if both else []
    return Table(["default", "found"], lines)


def _by_way(of_sets: Sequence[OfSet]) -> Table:
    """A line a set, a column a way; at last geometric means, of ways that all sets have."""
    ways = [way for way in WAYS if any(way in one.errors for one in of_sets)]
    lines: list[list[Value]] = []
    for one in of_sets:
        of = one.errors
        cells = [
            Cell(digits(of[way]), "best" if of[way] == min(of.values()) else "number", of[way])
            if way in of
            else None
            for way in ways
        ]
        lines.append([one.source.name, *cells])
    all_of = {way: [one.errors[way] for one in of_sets if way in one.errors] for way in ways}
    means = [geometric_mean(of) if len(of) == len(of_sets) else None for of in all_of.values()]
    lines.append([f"geometric mean of {len(of_sets)} sets", *means])
    return Table(["set", *(WAYS[way].words for way in ways)], lines)


SUITE = Suite(
    name="heldout",
    title="Held-out pictures",
    protocol="pbrfit-heldout-1: materials from the kept pictures, light of the held-out ones; RMSE "
    "over RMS of all held-out pictures together, in values of the files, samples that are clipped "
    "left out; {held_out} of at most {pictures} pictures held out at a time, {folds} folds, "
    "{max_size} pixels",
    cases=cases,
    run=run,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    folders="scene folder, a public set as published, or a folder of such",
    settings={
        "ways": several("NAME", WAYS, ("default", "lambert", "nearest")),
        "held_out": count("K", "pictures that are held out at a time", 1),
        "folds": count("F", "so many times, spread evenly over the pictures", 4, 1),
        "pictures": count("N", "of a set that are used at most, evenly chosen", 32, 6),
        "max_size": count("PIXELS", "average larger pictures down to this longer side", 192, 32),
    },
    about=(
        "Materials are fitted to the kept pictures of each set, then only the light of each "
        "held-out picture. What is left of the values in its file, as they are stored, is the "
        "error: so ways compare that read the files by different tone curves. It is also taken "
        "with one far lamp and constant ambient light, whatever light a way found.",
        "Regret is the error of the default over the least of the default, its flags and the "
        "paper's recipe. “Lambert, rank 3” is a matt surface under unknown lamps, “known lamps” "
        "photometric stereo by least squares; the nearest and the sum of kept pictures have a "
        "factor a channel. All of these read the files both as sRGB and as linear; the better "
        "counts. Relightable images (PTM, HSH, PCA) are told the lamp of a held-out picture where "
        "it is known, else where a fit finds it.",
        "A small error does not prove maps right: several materials may explain the same pictures.",
    ),
)
