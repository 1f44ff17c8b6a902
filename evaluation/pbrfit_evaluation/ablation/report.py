"""The suite as files: page, plots, sheets, CSV, summary."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit_evaluation import page, summary
from pbrfit_evaluation.ablation import Effort, RealTask, RoomTask, plots
from pbrfit_evaluation.ablation.cases import CASES, TITLES, VARIED_IN, CaseName
from pbrfit_evaluation.ablation.configurations import (
    CONFIGURATIONS,
    DEFAULT,
    NONE,
    VARIED,
    Configuration,
    alone,
)
from pbrfit_evaluation.ablation.demands import DEMANDS, Verdict, judge
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.scores import Scores
from pbrfit_evaluation.tables import write_csv

PROTOCOL = f"pbrfit-ablation-1: rooms with noise of 0.01 at a mean radiance of 0.4; {SCORES}"

SHOWN: dict[str, str] = {
    "roughness": "roughness",
    "metallic": "metallic",
    "albedo": "albedo",
    "albedo_scaled": "albedo, scaled",
    "relight": "relight",
}
"""Errors in tables and plots, and what they are called there."""

MARKDOWN, ROOMS, REAL = "ablation.md", "rooms.csv", "real.csv"

PARTS = {
    "a": "(a) right segments",
    "b": "(b) varying inside",
    "c": "(c) wrong segments",
}

HELD_OUT = {
    "error": "held out: RMSE / RMS",
    "psnr": "PSNR, dB",
    "ssim": "SSIM",
    "recon": "kept: RMSE",
    "seconds": "fit, s",
}


@dataclass(frozen=True)
class Measured:
    """Tasks with their records, in the same order; the cost's record apart."""

    effort: Effort
    rooms: Sequence[tuple[RoomTask, Record]]
    real: Sequence[tuple[RealTask, Record]]
    cost: Record

    def errors(self, case: CaseName, configuration: Configuration, metric: str) -> list[float]:
        """RMSE of each room of a case that was finished."""
        return [
            float(record.values["scores"][configuration.key][metric])
            for task, record in self.rooms
            if task.case == case and record.values is not None
        ]

    def mean(self, case: CaseName, configuration: Configuration, metric: str) -> float:
        """Over the rooms of a case; NaN without any."""
        errors = self.errors(case, configuration, metric)
        return float(np.mean(errors)) if errors else math.nan

    def ratio(self, case: CaseName, configuration: Configuration, metric: str) -> float:
        """Of the mean to that without priors."""
        return self.mean(case, configuration, metric) / self.mean(case, NONE, metric)

    def verdicts(self, configuration: Configuration) -> list[Verdict]:
        """What a configuration holds; nothing about cases without a finished room."""
        return [
            judge(demand, before, self.errors(demand.case, configuration, demand.metric))
            for demand in DEMANDS
            if (before := self.errors(demand.case, NONE, demand.metric))
        ]

    @property
    def cases(self) -> list[CaseName]:
        """Those with a finished room."""
        return [case for case in CASES if self.errors(case, NONE, "recon")]


def write(folder: Path, measured: Measured) -> None:
    """Write `report.html`, its pictures, `ablation.md`, `rooms.csv`, `real.csv`, `summary.json`."""
    sections = list(_sections(measured))
    page.write_page(folder, "What the priors are worth", _opening(measured), sections)
    tables = [table for section in sections for table in section.tables]
    (folder / MARKDOWN).write_text("\n".join(map(_titled, tables)), encoding="utf-8")
    names = [field.name for field in fields(Scores)]
    write_csv(
        folder / ROOMS,
        ("case", "seed", "configuration", *names),
        (
            (task.case, task.seed, key, *(scores[name] for name in names))
            for task, record in measured.rooms
            if record.values is not None
            for key, scores in record.values["scores"].items()
        ),
    )
    write_csv(
        folder / REAL,
        ("source", "configuration", *HELD_OUT),
        (
            (task.source.name, key, *(found[name] for name in HELD_OUT))
            for task, record in measured.real
            if record.values is not None
            for key, found in record.values["found"].items()
        ),
    )
    effort = measured.effort
    protocol = f"{PROTOCOL}; {effort.size} pixels, {effort.iterations} iterations"
    summary.write_summary(folder, protocol, list(_rows(measured)))


def lines(measured: Measured) -> list[str]:
    """The verdicts, for a terminal."""
    found = []
    for verdict in measured.verdicts(DEFAULT):
        demand = verdict.demand
        found.append(
            f"{PARTS[demand.part]:<20}{demand.case:<10}{demand.metric:<11}"
            f"{verdict.without:>8.4f} ->{verdict.found:>7.4f}{verdict.value:>8.3f} "
            f"{_limit(verdict):<9}{verdict.holding} of {len(verdict.rooms)} rooms"
            f"{'' if verdict.holds else '   NOT HELD'}"
        )
    return found


def _titled(table: Table) -> str:
    return f"{table.caption}\n\n{page.markdown(table)}" if table.caption else page.markdown(table)


def _rows(measured: Measured) -> Iterator[summary.Row]:
    for case in CASES:
        records = [record for task, record in measured.rooms if task.case == case]
        failed = sum(record.error is not None for record in records)
        status = "ok" if not failed else f"{failed} of {len(records)} rooms failed"
        if case not in measured.cases:
            yield summary.Row(case, 0, None, {}, status=status)
            continue
        for one in measured.effort.configurations:
            metrics: dict[str, float | None] = {}
            for name in ("recon", *SHOWN):
                metrics[name] = measured.mean(case, one, name)
                metrics[f"{name}_ratio"] = measured.ratio(case, one, name)
            yield summary.Row(
                f"{case}, {one.key}", len(records) - failed, "auto", metrics, status=status
            )
    for verdict in measured.verdicts(DEFAULT):
        demand = verdict.demand
        yield summary.Row(
            f"must hold ({demand.part}): {demand.case}, {demand.metric}",
            len(verdict.rooms),
            "auto",
            {
                "value": verdict.value,
                "limit": demand.limit,
                "without": verdict.without,
                "found": verdict.found,
                "rooms_that_hold": float(verdict.holding),
            },
            status="ok" if verdict.holds else "not held",
        )
    for task, record in measured.real:
        if record.values is None:
            yield summary.Row(task.source.name, 0, None, {}, status=record.error or "not run")
            continue
        for key, found in record.values["found"].items():
            yield summary.Row(f"{task.source.name}, {key}", 1, "auto", found)
    if measured.cost.values is not None:
        parts = {"loss and gradient": measured.cost.values["data"], **measured.cost.values["more"]}
        for name, milliseconds in parts.items():
            yield summary.Row(f"cost, {name}", 1, None, {"milliseconds": milliseconds})
        for key, fit in measured.cost.values["fits"].items():
            yield summary.Row(f"cost, fit, {key}", 1, "auto", fit)


def _opening(measured: Measured) -> list[str]:
    effort = measured.effort
    seeds = [task.seed for task, _ in measured.rooms]
    on = summary.machine()
    return [
        "What each prior does to the errors of materials and relighting: where segments are "
        "right, where they are wrong or missing, and on real pictures.",
        f"{effort.rooms} rooms a case (seeds from {min(seeds)} on), {effort.size} × {effort.size} "
        f"pixels, 16 pictures with noise of 0.01 at a mean radiance of 0.4, 16 held out, rendered "
        f"and all pictures fitted with model {effort.model}; "
        f"{effort.iterations} iterations. {SCORES.partition(': ')[2]}. Ratios are between mean "
        "errors over the rooms.",
        f"{on['processor']}, {on['cores']} cores, {on['system']}, Python {on['python']}, numpy "
        f"{on['numpy']}.",
    ]


def _sections(measured: Measured) -> Iterator[Section]:
    if measured.cases:
        yield _demands(measured)
        yield _ratios(measured)
        if measured.effort.weights:
            yield _curves(measured)
        yield _tables(measured)
        yield Section(
            "The first room",
            ["Maps and a picture under new light: the truth, and what was recovered."],
            figures=[
                Figure(f"room-{task.case}", base64.b64decode(sheet), f"{TITLES[task.case]}.")
                for task, record in measured.rooms
                if record.values is not None and (sheet := record.values["sheet"]) is not None
            ],
        )
    yield _real(measured)
    yield _cost(measured)
    failed = [record for _, record in (*measured.rooms, *measured.real) if record.error]
    if failed:
        cells = [[Cell(record.key), Cell(record.error or "", "why")] for record in failed]
        yield Section("What failed", [], [Table([Cell("task"), Cell("error")], cells)])


def _demands(measured: Measured) -> Section:
    rooms = measured.effort.rooms
    columns = [Cell("part", "name"), Cell("case", "name"), Cell("error", "name")]
    columns += [
        Cell(text, "number")
        for text in (
            "no priors",
            "default",
            "ratio",
            "limit",
            *(f"room {i + 1}" for i in range(rooms)),
        )
    ]
    columns.append(Cell("in the mean"))
    rows = []
    for verdict in measured.verdicts(DEFAULT):
        demand = verdict.demand
        rows.append(
            [
                Cell(PARTS[demand.part], "name"),
                Cell(TITLES[demand.case], "name"),
                Cell(demand.metric, "name"),
                Cell(_digits(verdict.without), "number"),
                Cell(_digits(verdict.found), "number"),
                Cell(f"{verdict.found / verdict.without:.2f}", "number"),
                Cell(_limit(verdict), "number"),
                *(
                    Cell(
                        f"{room:.3f}" if not demand.relative else f"{room:.2f}",
                        "number" if room <= demand.limit else "fail",
                    )
                    for room in verdict.rooms
                ),
                Cell("holds", "pass") if verdict.holds else Cell("does not hold", "fail"),
            ]
        )
    others = [_held_by(measured, one) for one in measured.effort.configurations if one != NONE]
    heads = ("roughness", "metallic", "albedo", "varying", "shifted", "merged")
    return Section(
        "What must hold",
        [
            "Limits are on the ratio to the fit without priors, or on the error itself where no "
            "ratio is named. The verdict is on the mean; rooms show the same figure one by one, "
            "marked where they are beyond the limit.",
        ],
        [
            Table(columns, rows, "The default priors."),
            Table(
                [Cell("priors"), *(Cell(head, "number") for head in heads), Cell("demands held")],
                others,
                "All configurations: (a) ratio of roughness, error of metallic, ratio of albedo; "
                "(b), (c) the largest ratio of any error.",
            ),
        ],
    )


def _held_by(measured: Measured, one: Configuration) -> list[Cell]:
    verdicts = measured.verdicts(one)
    groups = [
        [v for v in verdicts if v.demand.part == "a" and v.demand.metric == metric]
        for metric in ("roughness", "metallic", "albedo")
    ]
    groups += [
        [v for v in verdicts if v.demand.case == case] for case in ("varying", "shifted", "merged")
    ]
    held = sum(verdict.holds for verdict in verdicts)
    look: page.Look = "pass" if held == len(DEMANDS) else ""
    return [
        Cell(one.title, "name"),
        *map(_worst, groups),
        Cell(f"{held} of {len(DEMANDS)}", look),
    ]


def _worst(verdicts: Sequence[Verdict]) -> Cell:
    if not verdicts:
        return Cell("–", "number")  # no room of that case was finished
    worst = max(verdicts, key=lambda verdict: verdict.value)
    return Cell(f"{worst.value:.3g}", "number" if worst.holds else "fail")


def _limit(verdict: Verdict) -> str:
    demand = verdict.demand
    return f"≤ {demand.limit:g}" + (" ×" if demand.relative else "")


def _ratios(measured: Measured) -> Section:
    others = [one for one in measured.effort.configurations if one != NONE]
    tables = {
        case: np.array([[measured.ratio(case, one, name) for name in SHOWN] for one in others])
        for case in measured.cases
    }
    png = plots.draw_ratios(tables, [one.title for one in others], list(SHOWN.values()))
    caption = (
        "RMSE over that without priors: below 1, violet, is better; above 1, orange, is worse."
    )
    return Section("Everything at a glance", [], figures=[Figure("ratios", png, caption)])


def _curves(measured: Measured) -> Section:
    weights = np.array(measured.effort.weights)
    drawn = {
        prior: {
            case: {
                SHOWN[name]: (
                    weights,
                    np.array([measured.ratio(case, alone(prior, w), name) for w in weights]),
                )
                for name in ("roughness", "metallic", "albedo", "relight")
            }
            for case in measured.cases
            if case in VARIED_IN
        }
        for prior in VARIED
    }
    caption = "Each prior alone, at several weights."
    return Section(
        "Weights",
        [
            "What a weight gains where segments are right, and loses where they are wrong or "
            "materials vary inside them."
        ],
        figures=[Figure("weights", plots.draw_curves(drawn), caption)],
    )


def _tables(measured: Measured) -> Section:
    columns = [Cell("priors"), *(Cell(name, "number") for name in SHOWN.values())]
    tables = []
    for case in measured.cases:
        least = {
            name: min(measured.mean(case, one, name) for one in measured.effort.configurations)
            for name in SHOWN
        }
        rows = [
            [
                Cell(one.title, "name"),
                *(
                    Cell(
                        f"{_digits(value)} ({measured.ratio(case, one, name):.2f})",
                        "best" if value == least[name] else "number",
                    )
                    for name in SHOWN
                    for value in [measured.mean(case, one, name)]
                ),
            ]
            for one in measured.effort.configurations
        ]
        tables.append(Table(columns, rows, f"{TITLES[case][0].upper()}{TITLES[case][1:]}."))
    return Section(
        "Errors", ["Mean RMSE, and in brackets its ratio to that without priors."], tables
    )


def _real(measured: Measured) -> Section:
    if not measured.real:
        return Section("Real pictures", ["None were given."])
    titles = {one.key: one.title for one in CONFIGURATIONS}
    columns = [Cell("set"), Cell("priors"), *(Cell(t, "number") for t in HELD_OUT.values())]
    rows, figures = [], []
    for task, record in measured.real:
        if record.values is None:
            continue
        name = task.source.name
        found: Mapping[str, Mapping[str, float]] = record.values["found"]
        least = min(of["error"] for of in found.values())
        for key, of in found.items():
            rows.append(
                [
                    Cell(name, "name"),
                    Cell(titles[key], "name"),
                    Cell(f"{of['error']:.4f}", "best" if of["error"] == least else "number"),
                    Cell(f"{of['psnr']:.1f}", "number"),
                    Cell(f"{of['ssim']:.3f}", "number"),
                    Cell(f"{of['recon']:.4f}", "number"),
                    Cell(f"{of['seconds']:.1f}", "number"),
                ]
            )
            name = ""
        figures.append(
            Figure(
                f"real-{task.source.name}",
                base64.b64decode(record.values["sheet"]),
                f"{task.source.name}: {task.source.about}. {record.values['kept']} pictures kept, "
                f"{record.values['held_out']} held out; relit as the first of these, its light "
                "fitted.",
            )
        )
    return Section(
        "Real pictures",
        [
            "Some pictures are held out; materials are fitted to the others, and for a held-out "
            "picture only its light. No true maps are known: the error says whether maps carry "
            "over to other light, and the pictures whether a person would believe them. No set has "
            "segments, so one prior is learnt for the whole picture.",
        ],
        [Table(columns, rows)],
        figures,
    )


def _cost(measured: Measured) -> Section:
    effort = measured.effort
    if measured.cost.values is None:
        return Section("What it costs", [f"Failed: {measured.cost.error}."])
    values: Mapping[str, Any] = measured.cost.values
    data, fits = values["data"], values["fits"]
    parts = [[Cell("loss and gradient alone", "name"), Cell(f"{data:.3f}", "number"), Cell("")]]
    parts += [
        [
            Cell(name, "name"),
            Cell(f"{spent:.3f}", "number"),
            Cell(f"{100 * spent / (data + spent):.1f} %", "number"),
        ]
        for name, spent in values["more"].items()
    ]
    least = fits[NONE.key]["seconds"]
    titles = {one.key: one.title for one in CONFIGURATIONS}
    whole = [
        [
            Cell(titles[key], "name"),
            Cell(f"{fit['seconds']:.2f}", "number"),
            Cell(f"{fit['iterations']:.0f}", "number"),
            Cell(f"{fit['evaluations']:.0f}", "number"),
            Cell(f"{1e3 * fit['seconds'] / fit['evaluations']:.1f}", "number"),
            Cell(f"{100 * (1 - least / fit['seconds']):.0f} %", "number"),
        ]
        for key, fit in fits.items()
    ]
    heads = ("seconds", "iterations", "evaluations", "ms / evaluation", "share beyond\nno priors")
    return Section(
        "What it costs",
        [
            f"A room of {effort.cost_size} × {effort.cost_size} pixels, 16 pictures, nothing else "
            "running. A prior of weight 0 is not evaluated.",
        ],
        [
            Table(
                [Cell("part"), Cell("ms", "number"), Cell("share of an evaluation", "number")],
                parts,
                "One evaluation, without the solver's own work.",
            ),
            Table([Cell("fit"), *(Cell(head, "number") for head in heads)], whole, "Whole fits."),
        ],
    )


def _digits(value: float) -> str:
    return f"{value:.4f}"
