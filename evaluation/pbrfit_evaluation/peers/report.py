"""The suite as files: page, pictures, CSV, summary."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pbrfit_evaluation import page, scores, summary
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.peers import IN_WORDS, NOISE, PEERS, Effort, Method, Task
from pbrfit_evaluation.peers.pictures import draw_sheet
from pbrfit_evaluation.tables import Mean, mean_with_interval, write_csv

PROTOCOL = (
    "pbrfit-peers-1: synthetic rooms; peers see one picture, the most evenly lit, in 8-bit sRGB "
    "with its 98th percentile at white, our fit all pictures, with noise of 0.01, and normals as "
    "an estimator gives them, with which all are relit; " + scores.PROTOCOL.partition(": ")[2]
)

SHOWN = {
    "albedo": "albedo",
    "albedo_scaled": "albedo, scaled",
    "albedo_psnr": "albedo PSNR, dB",
    "albedo_ssim": "albedo SSIM",
    "roughness": "roughness",
    "metallic": "metallic",
    "relight": "relight",
    "relight_scaled": "relight, scaled",
    "relight_psnr": "relight PSNR, dB",
}
"""Columns of the table: names of `Scores`, and how they are called."""

ABSENT = "InputError: "
"""What the error of a task begins with whose peer lacks packages or weights."""

LARGER_IS_BETTER = ("albedo_psnr", "albedo_ssim", "relight_psnr")


@dataclass(frozen=True)
class Measured:
    """Tasks of a method and what became of them."""

    method: Method
    tasks: Sequence[Task]
    records: Sequence[Record]

    @property
    def done(self) -> list[tuple[Task, Mapping[str, Any]]]:
        """Tasks that ended well, with what they found."""
        return [
            (task, record.values)
            for task, record in zip(self.tasks, self.records, strict=True)
            if record.values is not None
        ]

    @property
    def status(self) -> str:
        """Why a scene has no figures, or "ok"."""
        errors = [record.error for record in self.records if record.error is not None]
        return errors[0].removeprefix(ABSENT) if errors else "ok"

    @property
    def expected(self) -> list[Record]:
        """Records whose errors are failures: a peer that is not there is none, a broken one is."""
        return [
            record
            for record in self.records
            if self.method not in PEERS or not (record.error or "").startswith(ABSENT)
        ]

    def mean(self, name: str) -> Mean:
        """Over scenes."""
        return mean_with_interval(values["scores"][name] for _, values in self.done)


def write(folder: Path, measured: Sequence[Measured], effort: Effort) -> None:
    """Write `report.html`, its pictures, `scenes.csv` and `summary.json`."""
    sections = [_figures(measured), *_pictures(measured), _peers(measured)]
    page.write_page(folder, "Peers that see one picture", _opening(effort), sections)
    names = list(measured[0].done[0][1]["scores"]) if measured[0].done else []
    lines = (
        (one.method, task.seed, values["picture"], *(values["scores"][name] for name in names))
        for one in measured
        for task, values in one.done
    )
    write_csv(folder / "scenes.csv", ("method", "seed", "picture", *names), lines)
    summary.write_summary(folder, PROTOCOL, [_row(one, names) for one in measured])


def _row(one: Measured, names: Sequence[str]) -> summary.Row:
    metrics: dict[str, float | None] = {}
    if one.done:
        for name in names:
            found = one.mean(name)
            metrics |= {name: found.mean, f"{name}_low": found.low, f"{name}_high": found.high}
    solver = "auto" if one.method == "pbrfit" else None
    return summary.Row(IN_WORDS[one.method], len(one.done), solver, metrics, status=one.status)


def _opening(effort: Effort) -> list[str]:
    sampler = "as recommended" if effort.steps is None else f"{effort.steps}"
    return [
        "Networks that find albedo, roughness and metallic in a single picture, beside our fit of "
        "all pictures under different lights. A peer sees neither normals nor other lights; what "
        "it has is what it learnt from other scenes. So this is no race: it says what several "
        "pictures are worth beside one.",
        f"{effort.scenes} synthetic scenes ({effort.kind}) of {effort.size} × {effort.size} "
        f"pixels, {effort.lights} pictures each. A peer gets the most evenly lit one in 8-bit "
        "sRGB, exposed so that its 98th percentile is white. Our fit gets normals with the errors "
        f"of an estimator (docs/table1.md) and pictures with noise of {NOISE:g}. The maps of all "
        "are rendered under the true held-out lights with these same normals. A single picture "
        "cannot tell how bright the lamp was, so albedo and relit pictures are also compared "
        "after the best factor a channel (“scaled”).",
        "In whose favour: the pictures are those of our model, lights of low order without "
        "shadows or light between surfaces, which our fit expects and which peers, trained on "
        "path-traced or real rooms, have never seen. Pictures with shadows are in docs/cycles.md.",
        f"Predictions of Marigold-IID, of which the median is taken: {effort.samples}; of RGB-X, "
        f"at {effort.longer_side} pixels: 1. Steps of their samplers: {sampler}.",
    ]


def _figures(measured: Sequence[Measured]) -> Section:
    columns = [Cell("mean over scenes"), *(Cell(text, "number") for text in SHOWN.values())]
    done = [one for one in measured if one.done]
    best = {
        name: (max if name in LARGER_IS_BETTER else min)(one.mean(name).mean for one in done)
        for name in SHOWN
        if done
    }
    rows = []
    for one in measured:
        cells = [Cell(IN_WORDS[one.method], "name")]
        for name in SHOWN:
            if not one.done:
                cells.append(Cell("not run", "note"))
                continue
            value = one.mean(name).mean
            text = f"{value:.1f}" if name.endswith("psnr") else f"{value:.3f}"
            cells.append(Cell(text, "best" if value == best[name] else "number", value))
        rows.append(cells)
    return Section(
        "Errors",
        [
            "RMSE unless a column says otherwise, linear values; PSNR and SSIM in sRGB. Intervals "
            "of 95 % over scenes are in summary.json, every scene in scenes.csv."
        ],
        [Table(columns, rows)],
    )


def _pictures(measured: Sequence[Measured]) -> Iterator[Section]:
    by_seed: dict[int, dict[str, Mapping[str, bytes]]] = {}
    for one in measured:
        for task, values in one.done:
            if "panels" in values:
                by_seed.setdefault(task.seed, {})[IN_WORDS[one.method]] = {
                    name: base64.b64decode(png) for name, png in values["panels"].items()
                }
    figures = [
        Figure(f"scene-{seed}", draw_sheet(panels), f"Scene of seed {seed}.")
        for seed, panels in sorted(by_seed.items())
    ]
    if figures:
        yield Section("Maps", [], figures=figures)


def _peers(measured: Sequence[Measured]) -> Section:
    rows = []
    for one in measured:
        if one.method in PEERS:
            ran = one.status == "ok"
            rows.append(
                [
                    Cell(IN_WORDS[one.method], "name"),
                    Cell(one.tasks[0].model or ""),
                    Cell("ran" if ran else f"not run: {one.status}", "" if ran else "why"),
                ]
            )
    return Section(
        "Checkpoints",
        [],
        [Table([Cell("peer"), Cell("checkpoint"), Cell("what became of it")], rows)],
    )


def lines(measured: Sequence[Measured]) -> list[str]:
    """The table for a terminal."""
    names = ("albedo", "albedo_scaled", "roughness", "metallic", "relight", "relight_scaled")
    found = [f"{'mean RMSE over scenes':<28}" + "".join(f"{name:>16}" for name in names)]
    for one in measured:
        label = f"{IN_WORDS[one.method]:<28}"
        if one.done:
            found.append(label + "".join(f"{one.mean(name).mean:>16.4f}" for name in names))
        else:
            found.append(f"{label}not run: {one.status}")
    return found
