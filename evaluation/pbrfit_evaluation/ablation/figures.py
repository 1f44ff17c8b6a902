"""The ablation as rows, verdicts, tables, plots and CSV files."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pbrfit_evaluation.ablation.cases import CASES, TITLES, VARIED_IN, CaseName
from pbrfit_evaluation.ablation.configurations import (
    CONFIGURATIONS,
    DEFAULT,
    FEW,
    NONE,
    VARIED,
    alone,
)
from pbrfit_evaluation.ablation.demands import DEMANDS, Judged, judge
from pbrfit_evaluation.ablation.measure import CostTask, RealTask, RoomTask
from pbrfit_evaluation.suite import (
    Column,
    HeatMap,
    Line,
    Mark,
    Panel,
    Picture,
    Plot,
    Results,
    Row,
    Section,
    Series,
    Table,
    Value,
    Verdict,
)

SHOWN = ("roughness", "metallic", "albedo", "albedo_scaled", "relight")
"""Errors in tables and plots."""

TITLE_OF = {one.key: one.title for one in (*CONFIGURATIONS, *FEW)}

CONDITIONS = {"a": "(a) right segments", "b": "(b) varying inside", "c": "(c) wrong segments"}


def _shown(results: Results[RoomTask]) -> list[str]:
    """Configurations in the tables: their keys."""
    return [one.key for one in (FEW if results.options.quick else CONFIGURATIONS)]


def _mean(results: Results[RoomTask], case: CaseName, key: str, metric: str) -> float:
    """RMSE over the rooms of a case that were finished; NaN without any."""
    errors = results.of(case=case).numbers("scores", key, metric)
    return float(np.mean(errors)) if errors else math.nan


def _ratio(results: Results[RoomTask], case: CaseName, key: str, metric: str) -> float:
    return _mean(results, case, key, metric) / _mean(results, case, NONE.key, metric)


def _judged(results: Results[RoomTask], key: str) -> list[Judged]:
    """What a configuration holds; nothing about cases without a finished room."""
    return [
        judge(demand, *errors)
        for demand in DEMANDS
        for of in [results.of(case=demand.case)]
        if (errors := [of.numbers("scores", k, demand.metric) for k in (NONE.key, key)])[0]
    ]


def _cases(results: Results[RoomTask]) -> list[CaseName]:
    """Those with a finished room."""
    return [case for case in CASES if results.of(case=case).finished]


def rooms(results: Results[RoomTask]) -> list[Row]:
    """Means and ratios of every case and configuration; what the default has to hold."""
    rows = []
    for case in CASES:
        of = results.of(case=case)
        for key in _shown(results) if of.finished else ():
            metrics: dict[str, float | None] = {}
            for name in ("recon", *SHOWN):
                metrics[name] = _mean(results, case, key, name)
                metrics[f"{name}_ratio"] = _ratio(results, case, key, name)
            count = len(of.finished)
            rows.append(Row(f"{case}, {key}", count, "auto", metrics, status=of.status("rooms")))
        if not of.finished:
            rows.append(Row(case, 0, None, {}, status=of.status("rooms")))
    for judged in _judged(results, DEFAULT.key):
        demand = judged.demand
        metrics = {"value": judged.value, "limit": demand.limit, "without": judged.without}
        metrics |= {"found": judged.found, "rooms_that_hold": float(judged.holding)}
        name = f"must hold ({demand.part}): {demand.case}, {demand.metric}"
        status = "ok" if judged.holds else "not held"
        rows.append(Row(name, len(judged.rooms), "auto", metrics, status=status))
    return rows


def verdicts(results: Results[RoomTask], _: Sequence[Row]) -> list[Verdict]:
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
        for judged in _judged(results, DEFAULT.key)
        for demand in [judged.demand]
    ]


def room_csvs(results: Results[RoomTask], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """Every room."""
    lines = [
        {"case": task.case, "seed": task.seed, "configuration": key, **scores}
        for task, found in results.finished
        for key, scores in found["scores"].items()
    ]
    return {"rooms.csv": lines}


def room_sections(results: Results[RoomTask], rows: Sequence[Row]) -> Iterator[Section]:
    """What each configuration holds, ratios, weights, errors and the first room."""
    cases = _cases(results)
    if not cases:
        return
    keys = [key for key in _shown(results) if key != NONE.key]
    groups = {
        **{metric: ("constant", metric) for metric in ("roughness", "metallic", "albedo")},
        **{case: (case, "") for case in ("varying", "shifted", "merged")},
    }
    held: list[list[Value]] = []
    for key in keys:
        judged = _judged(results, key)
        worst = [
            max((v.value for v in judged if v.demand.case == case and metric in v.demand.metric),
                default=None)
            for case, metric in groups.values()
        ]  # fmt: skip
        count = sum(v.holds for v in judged)
        held.append([TITLE_OF[key], *worst, f"{count} of {len(DEMANDS)}"])
    yield Section(
        "What all configurations hold",
        "(a) ratio of roughness, error of metallic, ratio of albedo, with right segments; (b), (c) "
        "the largest ratio of any error.",
        [Table(["priors", *groups, "demands held"], held)],
    )
    maps = [
        HeatMap(
            [[_ratio(results, case, key, name) for name in SHOWN] for key in keys],
            [name.replace("_", ", ") for name in SHOWN],
            [TITLE_OF[key] for key in keys],
            title=TITLES[case],
            ratio=True,
        )
        for case in cases
    ]
    yield Section(
        "Everything at a glance",
        figures=[
            Plot(
                "ratios",
                "RMSE over that without priors: below 1, violet, is better; above 1, orange, is "
                "worse.",
                maps,
                columns=3,
                share_y="all",
            )
        ],
    )
    if results.options.weights:
        yield Section("Weights", figures=[_curves(results, cases)])
    titles = {f"{case}, {key}": (TITLES[case], TITLE_OF[key]) for case in cases for key in TITLE_OF}
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
            _picture(f"room-{task.case}", found["sheet"], f"{TITLES[task.case]}.")
            for task, found in results.finished
            if "sheet" in found
        ],
    )


def _curves(results: Results[RoomTask], cases: Sequence[CaseName]) -> Plot:
    weights = results.options.weights
    panels = [
        Panel(
            "lines",
            [
                Series(
                    TITLES[case],
                    weights,
                    [_ratio(results, case, alone(prior, w).key, name) for w in weights],
                )
                for case in cases
                if case in VARIED_IN
            ],
            f"weight of {prior}",
            "RMSE / without priors",
            title=name,
            log="xy",
            marks=[Mark(1.0)],
        )
        for prior in VARIED
        for name in SHOWN
        if name != "albedo_scaled"
    ]
    return Plot("weights", "Each prior alone, at several weights.", panels, columns=4)


def _picture(name: str, sheet: str, caption: str) -> Picture:
    return Picture(name, caption, base64.b64decode(sheet))


# ---------------------------------------------------------------------------- real pictures, cost


def real(results: Results[RealTask]) -> list[Row]:
    """A row for each source and configuration."""
    rows = []
    for task, record in results.pairs:
        if record.values is None:
            rows.append(Row(task.source.name, 0, None, {}, status=record.error or "not run"))
            continue
        for key, found in record.values["found"].items():
            rows.append(Row(f"{task.source.name}, {key}", 1, "auto", found))
    return rows


def real_csvs(results: Results[RealTask], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """Every fit."""
    lines = [
        {"source": task.source.name, "configuration": key, **numbers}
        for task, found in results.finished
        for key, numbers in found["found"].items()
    ]
    return {"real.csv": lines}


def real_sections(results: Results[RealTask], _: Sequence[Row]) -> Iterator[Section]:
    """Errors and sheets of each source."""
    rows = [
        Row(task.source.name, 0, TITLE_OF[key], numbers)
        for task, found in results.finished
        for key, numbers in found["found"].items()
    ]
    columns = [
        Column("error", "held out: error relative\nto the picture's RMS", "low"),
        Column("psnr", "PSNR, dB", "high"),
        Column("ssim", "SSIM", "high"),
        Column("recon", "kept: RMSE"),
        Column("seconds", "fit, s"),
    ]
    yield Section(
        "Real pictures",
        "Materials are fitted to the kept pictures, and for a held-out picture only its light. No "
        "set has segments, so one prior is fitted for the whole picture."
        if rows
        else "None were given.",
        [Table.of(rows, columns)] if rows else (),
        [
            _picture(
                f"real-{task.source.name}",
                found["sheet"],
                f"{task.source.name}: {task.source.about}. {found['kept']} pictures kept, "
                f"{found['held_out']} held out; relit as the first of these, its light fitted.",
            )
            for task, found in results.finished
        ],
    )


def cost(results: Results[CostTask]) -> list[Row]:
    """A row for each part of an evaluation and each whole fit."""
    rows = []
    for _, found in results.finished:
        for name, milliseconds in found["parts"].items():
            rows.append(Row(f"cost, {name}", 1, None, {"milliseconds": milliseconds}))
        for key, fit in found["fits"].items():
            rows.append(Row(f"cost, fit, {key}", 1, "auto", fit))
    return rows


def cost_sections(_: Results[CostTask], rows: Sequence[Row]) -> Iterator[Section]:
    """What an evaluation takes, and whole fits."""
    if rows:
        yield Section(
            "What it costs",
            "A room with 16 pictures, nothing else running: loss and gradient without priors, what "
            "each part takes beside that, and whole fits.",
            [Table.of([replace(row, solver=None, scenes=0) for row in rows])],
        )
