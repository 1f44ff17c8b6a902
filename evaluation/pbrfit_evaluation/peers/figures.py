"""Peers beside our fit as rows, a table, sheets of maps and a CSV file."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace

from pbrfit_evaluation.peers.measure import METHODS, Method, Task, no_cycles, why_not
from pbrfit_evaluation.scores import Scores, better
from pbrfit_evaluation.suite import Column, Line, Picture, Results, Row, Section, Table
from pbrfit_evaluation.table1.rows import Renderer

IN_WORDS: dict[Method, str] = {
    "pbrfit": "pbrfit, all pictures",
    "constant": "constant guess",
    "marigold": "Marigold-IID, one picture",
    "rgbx": "RGB-X, one picture",
}

ROOMS: dict[Renderer, str] = {"own": "our renders", "cycles": "rooms by Cycles"}

SHOWN = (
    *("albedo", "albedo_scaled", "roughness", "metallic", "relight", "relight_scaled"),
    *("albedo_psnr", "albedo_ssim", "relight_psnr"),
)
"""Columns of the table."""


def rows(results: Results[Task]) -> list[Row]:
    """A row for each method, with the reason where it cannot run."""
    made = []
    for renderer, where in ROOMS.items():
        for method in METHODS:
            of = results.of(method=method, renderer=renderer)
            why = why_not(method, results.options)
            if renderer == "cycles":
                why = why or no_cycles(results.options)
            names = [field.name for field in fields(Scores)] if of.finished else []
            metrics = of.metrics(names, "scores")
            status = f"not run: {why}" if why else next((r.error or "" for r in of.failed), "ok")
            guess = method == "constant"
            found = len(of.finished)
            made.append(Row(where, found, IN_WORDS[method], metrics, status=status, guess=guess))
    return made


def csvs(results: Results[Task], _: Sequence[Row]) -> Mapping[str, Sequence[Line]]:
    """Every scene by every method."""
    lines = [
        {
            "rooms": task.renderer,
            "method": task.method,
            "seed": task.seed,
            "picture": found["picture"],
            **found["scores"],
        }
        for task, found in results.finished
    ]
    return {"scenes.csv": lines}


def sections(results: Results[Task], rows: Sequence[Row]) -> Iterator[Section]:
    """Errors, and the maps of the first scenes."""
    columns = [Column(name, best=better(name)) for name in SHOWN]
    yield Section(
        "Errors",
        "RMSE unless a column says otherwise, linear values; PSNR in dB and SSIM in sRGB. "
        "Intervals of 95 % over scenes.",
        [Table.of(rows, columns)],
    )
    few = [Column(name, best=better(name)) for name in SHOWN[:6]]
    plain = [
        replace(row, metrics={one.metric: row.metrics.get(one.metric) for one in few})
        for row in rows
    ]
    yield Section("In short", "RMSE without intervals.", [Table.of(plain, few)])
    pictures = [
        Picture(
            f"scene-{task.renderer}-{task.seed}-{task.method}",
            f"{ROOMS[task.renderer]}, seed {task.seed}, {IN_WORDS[task.method]}.",
            base64.b64decode(found["sheet"]),
        )
        for task, found in sorted(results.finished, key=lambda pair: _place(pair[0]))
        if "sheet" in found
    ]
    if pictures:
        yield Section("Maps", figures=pictures)


def _place(task: Task) -> tuple[bool, int]:
    return task.renderer == "cycles", task.seed
