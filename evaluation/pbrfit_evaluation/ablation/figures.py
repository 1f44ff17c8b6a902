"""The ablation as rows, verdicts, tables, pictures and CSV files."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from pbrfit_evaluation.ablation.cases import CASES, TITLES
from pbrfit_evaluation.ablation.configurations import DEFAULT, NONE, Configuration, table
from pbrfit_evaluation.ablation.demands import DEMANDS, Judged, judge
from pbrfit_evaluation.ablation.measure import RoomTask
from pbrfit_evaluation.suite import (
    Column,
    Line,
    Picture,
    Results,
    Row,
    Section,
    Table,
    Value,
    Verdict,
)

SHOWN = ("roughness", "metallic", "albedo", "albedo_scaled", "relight")
"""Errors in tables."""

CONDITIONS = {
    "a": "(a) right segments",
    "b": "(b) varying inside",
    "c": "(c) wrong segments",
    "d": "(d) better and never worse",
}

Of = Results[RoomTask]


def _judged(results: Of, one: Configuration) -> list[Judged]:
    """What a configuration holds; nothing about cases without a finished room."""
    return [
        judge(demand, *errors)
        for demand in DEMANDS
        for of in [results.of(case=demand.case)]
        if (errors := [of.numbers("scores", k.key, demand.metric) for k in (NONE, one)])[0]
    ]


def rows(results: Of) -> list[Row]:
    """Means and ratios of every case and configuration; what the default has to hold."""
    found = []
    for case in CASES:
        of = results.of(case=case)
        count, status = len(of.finished), of.status("rooms")
        for one in of.pairs[0][0].configurations if count else ():
            metrics: dict[str, float | None] = {}
            for name in ("recon", *SHOWN):
                metrics[name] = mean = of.average("scores", one.key, name)
                metrics[f"{name}_ratio"] = mean / of.average("scores", NONE.key, name)
            found.append(Row(f"{case}, {one.key}", count, "gauss-newton", metrics, status=status))
        if not count:
            found.append(Row(case, 0, None, {}, status=status))
    for judged in _judged(results, DEFAULT):
        demand = judged.demand
        metrics = {"value": judged.value, "limit": demand.limit, "without": judged.without}
        metrics |= {"found": judged.found, "rooms_that_hold": float(judged.holding)}
        name = f"must hold ({demand.part}): {demand.case}, {demand.metric}"
        status = "ok" if judged.holds else "not held"
        found.append(Row(name, len(judged.rooms), "gauss-newton", metrics, status=status))
    return found


def verdicts(results: Of, _: Sequence[Row]) -> list[Verdict]:
    """What the default priors have to hold."""
    return [
        Verdict(
            f"{demand.case}, {demand.metric}" + (" over that without" if demand.relative else ""),
            judged.value,
            demand.limit,
            f"{judged.holding} of {len(judged.rooms)} rooms; no priors {judged.without:.4f}, "
            f"default {judged.found:.4f}",
            part=CONDITIONS[demand.part],
        )
        for judged in _judged(results, DEFAULT)
        for demand in [judged.demand]
    ]


def csvs(results: Of, _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """Every room."""
    lines = [
        {"case": task.case, "seed": task.seed, "configuration": key, **scores}
        for task, found in results.finished
        for key, scores in found["scores"].items()
    ]
    return {"rooms.csv": lines}


def sections(results: Of, rows: Sequence[Row]) -> Iterator[Section]:
    """What each configuration holds, errors and the first room."""
    if not results.finished:
        return
    yield Section(
        "What all configurations hold",
        "(a) ratio of roughness, error of metallic, ratio of albedo, with right segments; (b), (c) "
        "the largest ratio of any error.",
        [_held(results)],
    )
    titles = {
        f"{task.case}, {one.key}": (TITLES[task.case], one.title)
        for task, _ in results.finished
        for one in task.configurations
    }
    shown = [
        replace(row, name=name, solver=solver)
        for row in rows
        if row.name in titles
        for name, solver in [titles[row.name]]
    ]
    columns = [
        column
        for name in SHOWN
        for column in (Column(name, best="low"), Column(f"{name}_ratio", "ratio"))
    ]
    yield Section("Errors", "Mean RMSE.", [Table.of(shown, columns)])
    yield Section(
        "The first room",
        "Maps and a picture under new light: the ground truth, and what was recovered.",
        figures=[
            Picture(f"room-{task.case}", f"{TITLES[task.case]}.", base64.b64decode(found["sheet"]))
            for task, found in results.finished
            if "sheet" in found
        ],
    )


def _held(results: Of) -> Table:
    """The worst value of every kind of demand, and how many hold, by configuration."""
    groups = {metric: ("a", "constant", metric) for metric in ("roughness", "metallic", "albedo")}
    groups |= {"varying": ("b", "varying", "")}
    groups |= {case: ("c", case, "") for case in ("shifted", "merged")}
    lines: list[list[Value]] = []
    for one in table(quick=results.options.quick):
        if one is NONE:
            continue
        judged = _judged(results, one)
        worst = [
            max(
                (
                    v.value
                    for v in judged
                    if (v.demand.part, v.demand.case) == (part, case) and metric in v.demand.metric
                ),
                default=None,
            )
            for part, case, metric in groups.values()
        ]
        held = sum(v.holds for v in judged)
        lines.append([one.title, *worst, f"{held} of {len(DEMANDS)}"])
    return Table(["priors", *groups, "demands held"], lines)
