"""Table 1 as files: page, plot, CSV, summary."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path

from pbrfit.model.reflection import Model
from pbrfit_evaluation import page, summary
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.recipes import IN_WORDS, Recipe
from pbrfit_evaluation.scores import PROTOCOL, Scores
from pbrfit_evaluation.table1 import plot
from pbrfit_evaluation.table1.measure import FIRST_SEED, Task
from pbrfit_evaluation.table1.models import both_models
from pbrfit_evaluation.table1.rows import COLUMNS, Row
from pbrfit_evaluation.tables import Mean, mean_with_interval, write_csv

TABLE, MARKDOWN, SCENES = "table1.csv", "table1.md", "scenes.csv"

METRICS = tuple(f.name for f in fields(Scores))

EFFORT = ("seconds", "evaluations")
"""Columns that are no errors."""

NAMES = {
    "recon": "recon",
    "albedo": "albedo",
    "roughness": "roughness",
    "metallic": "metallic",
    "relight": "relight",
    "roughness_on_metal": "roughness\non metal",
    "metallic_on_metal": "metallic\non metal",
    "albedo_scaled": "albedo,\nscaled",
    "relight_scaled": "relight,\nscaled",
    "albedo_psnr": "albedo\nPSNR [dB]",
    "albedo_ssim": "albedo\nSSIM",
    "relight_psnr": "relight\nPSNR [dB]",
    "relight_ssim": "relight\nSSIM",
    "seconds": "seconds",
    "evaluations": "evaluations",
}
"""Of the columns."""

SOLVERS: dict[Recipe, str | None] = {
    "plain": "auto, no priors",
    "default": "auto, default",
    "paper": "lbfgsb, paper's recipe",
    "paper-priors": "lbfgsb, paper's recipe and priors",
    "constant": "constant guess",
    "start": "start, not optimised",
}


GUESSES: tuple[Recipe, ...] = ("constant", "start")
"""What is not fitted."""


@dataclass(frozen=True)
class Outcome:
    """A row fitted with a model: its records, or why there are none."""

    row: Row
    model: Model
    records: Sequence[Record]
    unavailable: str = ""

    @property
    def name(self) -> str:
        """Of row and model."""
        return f"{self.row.name}, {self.model}"

    @property
    def finished(self) -> list[Record]:
        """Those without an error."""
        return [record for record in self.records if record.values is not None]

    @property
    def status(self) -> str:
        """For the summary: "ok", or what went wrong."""
        if self.unavailable:
            return f"not run: {self.unavailable}"
        failed = len(self.records) - len(self.finished)
        return "ok" if not failed else f"{failed} of {len(self.records)} scenes failed"

    def mean(self, recipe: Recipe, metric: str) -> Mean:
        """Over the scenes that were finished."""
        found = (r.values["recipes"][recipe][metric] for r in self.finished if r.values is not None)
        return mean_with_interval(math.nan if value is None else value for value in found)

    def fact(self, name: str) -> Mean:
        """Of something about the scenes themselves."""
        found = (r.values["facts"].get(name) for r in self.finished if r.values is not None)
        return mean_with_interval(value for value in found if value is not None)


def outcomes(
    rows: Sequence[Row],
    models: Sequence[Model],
    tasks: Sequence[Task],
    records: Sequence[Record],
    unavailable: Mapping[str, str],
) -> list[Outcome]:
    """Sort records by row and model; `unavailable` says by key why a row was not run."""
    sorted_in: dict[tuple[str, Model], list[Record]] = {
        (row.key, model): [] for row in rows for model in models
    }
    for task, record in zip(tasks, records, strict=True):
        sorted_in[task.row, task.model].append(record)
    return [
        Outcome(row, model, sorted_in[row.key, model], unavailable.get(row.key, ""))
        for row in rows
        for model in models
    ]


def write(folder: Path, found: Sequence[Outcome], setup: Sequence[str]) -> None:
    """Write `report.html`, `table1.png`, `.csv` and `.md`, `scenes.csv` and `summary.json`.

    Parameters
    ----------
    folder
        Exists.
    found
        The rows.
    setup
        Sentences on how it was run: sizes, numbers, options.
    """
    measured = _Measured(found)
    page.write_page(
        folder, "Table 1 on scenes whose truth is known", _opening(setup), _sections(measured)
    )
    rest = [name for name in METRICS if name not in COLUMNS]
    (folder / MARKDOWN).write_text(
        f"{page.markdown(_table(measured, COLUMNS, with_paper=True))}\n"
        f"{page.markdown(_table(measured, rest))}",
        encoding="utf-8",
    )
    write_csv(
        folder / TABLE,
        ("row", "model", "recipe", "metric", "mean", "low", "high", "scenes"),
        (
            (outcome.row.key, outcome.model, recipe, metric, m.mean, m.low, m.high, m.count)
            for outcome in found
            for recipe in outcome.row.recipes
            for metric in METRICS
            if (m := measured(outcome, recipe, metric)).count
        ),
    )
    write_csv(
        folder / SCENES,
        ("scene", "model", "recipe", *METRICS),
        (
            (record.key, outcome.model, recipe, *record.values["recipes"][recipe].values())
            for outcome in found
            for record in outcome.finished
            if record.values is not None
            for recipe in outcome.row.recipes
        ),
    )
    summary.write_summary(folder, PROTOCOL, [row for o in found for row in _rows(o, measured)])


class _Measured:
    """Means with intervals, each computed once."""

    def __init__(self, found: Sequence[Outcome]) -> None:
        self.outcomes = found
        self._means: dict[tuple[str, Model, Recipe, str], Mean] = {}

    def __call__(self, outcome: Outcome, recipe: Recipe, metric: str) -> Mean:
        key = (outcome.row.key, outcome.model, recipe, metric)
        if key not in self._means:
            self._means[key] = outcome.mean(recipe, metric)
        return self._means[key]


def _rows(outcome: Outcome, mean: _Measured) -> list[summary.Row]:
    row = outcome.row
    if not outcome.finished:
        return [summary.Row(outcome.name, 0, None, {}, row.paper or None, outcome.status)]
    rows = []
    for recipe in row.recipes:
        metrics: dict[str, float | None] = {}
        for metric in METRICS:
            m = mean(outcome, recipe, metric)
            metrics |= {metric: m.mean, f"{metric}_low": m.low, f"{metric}_high": m.high}
        rows.append(
            summary.Row(
                outcome.name,
                len(outcome.finished),
                SOLVERS[recipe],
                metrics,
                row.paper or None,
                outcome.status,
            )
        )
    return rows


def _opening(setup: Sequence[str]) -> list[str]:
    on = summary.machine()
    return [
        "How well materials and lights come back from pictures whose truth is known, in the "
        "setups of the paper's Table 1 and some that it leaves out.",
        *setup,
        "Each setup is there for each reflection model that was asked for: “paper” is the paper's "
        "eq. 12, “principled” the BRDF of path tracers, integrated over the light. The model is "
        "that of all fits and guesses of its lines, the paper's recipe included. Our renderer uses "
        "the same model, so that a fit can be exact, but for one setup; Cycles' pictures are the "
        "same for both models.",
        "Figures are means over scenes; in brackets 95 % intervals by bootstrap over scenes. "
        f"Here, {PROTOCOL.partition(': ')[2]}. Lines marked “paper” repeat the paper's "
        "own numbers, which are of other scenes: context, no comparison.",
        f"“{IN_WORDS['paper'].capitalize()}”, as we read it: one run of scipy's L-BFGS-B on "
        "albedo, roughness and metallic within [0, 1] and all lights, from the mean picture, "
        "roughness 0.5 and metallic 0.1. The paper's rows have no priors but for one; “our "
        "default” has its priors and is given the true segments. The constant guess has "
        "roughness 0.5, metallic 0 and the mean of the true albedo, with the lights that then fit "
        "best: it knows nothing of the pixels. Our start is where our default begins, with the "
        f"lights that fit it. Seeds from {FIRST_SEED} on; none served to tune anything.",
        f"pbrfit {version('pbrfit')}; {on['processor']}, {on['cores']} cores, {on['system']}, "
        f"Python {on['python']}, numpy {on['numpy']}. Seconds are of one fit while as many others "
        "ran as there were jobs.",
    ]


def _sections(measured: _Measured) -> list[Section]:
    found = measured.outcomes
    sections = [
        Section(
            "The paper's columns",
            ["RMSE, linear. The best of the fits is bold."],
            [_table(measured, COLUMNS, with_paper=True)],
            [Figure("table1", plot.draw(found, measured), "The same as a plot, with intervals.")]
            if any(outcome.finished for outcome in found)
            else [],
        ),
        Section(
            "More of the same results",
            [
                "Errors on metal pixels alone; albedo and relit pictures after the best factor a "
                "channel, which pictures barely fix; what people see; and the effort."
            ],
            [_table(measured, [name for name in METRICS if name not in COLUMNS])],
        ),
        *both_models(found, measured),
        _rows_in_words(found),
    ]
    failed = [record for outcome in found for record in outcome.records if record.error]
    if failed:
        rows = [[Cell(record.key), Cell(record.error or "", "why")] for record in failed]
        sections.append(
            Section(
                "Scenes that failed",
                ["They are in no mean."],
                [Table([Cell("Scene"), Cell("Error")], rows)],
            )
        )
    pictures = [
        Figure(
            f"example-{outcome.row.key}-{outcome.model}",
            base64.b64decode(record.values["preview"]),
            f"{outcome.name}, scene {record.key.rpartition('_')[2]}, our default: picture, "
            "reconstruction, maps and normals; below the truth and the errors.",
        )
        for outcome in found
        for record in outcome.finished
        if record.values is not None and "preview" in record.values
    ]
    if pictures:
        sections.append(Section("Examples", ["The first scene of each setup."], figures=pictures))
    return sections


def _table(measured: _Measured, metrics: Sequence[str], *, with_paper: bool = False) -> Table:
    columns = [Cell("Setup"), Cell("Model"), Cell("Scenes", "number"), Cell("Explained by")]
    columns += [Cell(NAMES[name], "number") for name in metrics]
    rows: list[list[Cell]] = []
    outcomes = measured.outcomes
    for i, outcome in enumerate(outcomes):
        row = outcome.row
        last = i + 1 == len(outcomes) or outcomes[i + 1].row != row
        name = row.name if i == 0 or outcomes[i - 1].row != row else ""
        if not outcome.finished:
            gaps = [Cell("", "number")] * len(metrics)
            why = Cell(outcome.status, "note")
            rows.append([Cell(name), Cell(outcome.model, "name"), Cell(""), why, *gaps])
            name = ""
        else:
            for recipe in row.recipes:
                first = recipe == row.recipes[0]
                scenes = str(len(outcome.finished)) if first else ""
                rows.append(
                    [
                        Cell(name),
                        Cell(outcome.model if first else "", "name"),
                        Cell(scenes, "number"),
                        Cell(IN_WORDS[recipe], "name"),
                        *(_figure(measured, outcome, recipe, metric) for metric in metrics),
                    ]
                )
                name = ""
        if with_paper and row.paper and last:
            rows.append(
                [
                    Cell(name),
                    Cell(""),
                    Cell(""),
                    Cell(f"paper, other scenes: {row.paper_row}", "note"),
                    *(_papers(row.paper.get(metric)) for metric in metrics),
                ]
            )
    return Table(columns, rows)


def _papers(value: float | None) -> Cell:
    return Cell("–" if value is None else f"{value:.3f}", "number")


def _figure(measured: _Measured, outcome: Outcome, recipe: Recipe, metric: str) -> Cell:
    mean = measured(outcome, recipe, metric)
    fits = [name for name in outcome.row.recipes if name not in GUESSES]
    sign = -1 if metric.endswith(("psnr", "ssim")) else 1
    best = min(fits, key=lambda fit: _order(measured(outcome, fit, metric).mean * sign))
    is_best = recipe == best and metric not in EFFORT and mean.count
    look: page.Look = "best" if is_best else "number"
    return Cell(with_interval(mean, _format(metric)), look)


def _order(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _format(metric: str) -> Callable[[float], str]:
    if metric.endswith("psnr") or metric == "seconds":
        return "{:.1f}".format
    if metric == "evaluations":
        return "{:.0f}".format
    return _three_digits


def _three_digits(value: float) -> str:
    return f"{value:.4f}" if abs(value) < 0.0995 else f"{value:.3f}"


def with_interval(mean: Mean, form: Callable[[float], str] = _three_digits) -> str:
    """A mean, and below it its interval."""
    if not mean.count:
        return "–"
    if mean.count == 1:
        return form(mean.mean)
    return f"{form(mean.mean)}\n[{form(mean.low)}, {form(mean.high)}]"


def _rows_in_words(found: Sequence[Outcome]) -> Section:
    columns = [Cell("Setup"), Cell("What it is"), Cell("Metal\npixels", "number")]
    columns += [Cell("Condition\nof the lights", "number"), Cell("Normals off by\nmean", "number")]
    columns += [Cell("Refined\nto", "number"), Cell("Scenes\nrefined", "number")]
    rows = []
    for i, outcome in enumerate(found):
        if i > 0 and found[i - 1].row == outcome.row:
            continue  # the same worlds
        metal, condition, off, refined, share = (
            outcome.fact(name)
            for name in (
                "metal_share",
                "condition",
                "normals_mean",
                "refined_mean",
                "refined_scenes",
            )
        )
        rows.append(
            [
                Cell(outcome.row.name),
                Cell(outcome.row.what, "why"),
                Cell(f"{100 * metal.mean:.0f} %" if metal.count else "", "number"),
                Cell(f"{condition.mean:.0f}" if condition.count else "", "number"),
                Cell(f"{off.mean:.1f}°" if off.count else "", "number"),
                Cell(f"{refined.mean:.1f}°" if refined.count else "", "number"),
                Cell(f"{100 * share.mean:.0f} %" if share.count else "", "number"),
            ]
        )
    return Section("The setups", [], [Table(columns, rows)])


def lines(found: Sequence[Outcome]) -> list[str]:
    """The paper's columns for a terminal."""
    width = max(len(outcome.name) for outcome in found)
    head = "".join(f"{name:>11}" for name in COLUMNS)
    texts = [f"{'':<{width}}  {'':<27}{head}"]
    for i, outcome in enumerate(found):
        name = outcome.name
        if not outcome.finished:
            texts.append(f"{name:<{width}}  {outcome.status}")
            continue
        for recipe in outcome.row.recipes:
            means = [outcome.mean(recipe, metric) for metric in COLUMNS]
            figures = "".join(f"{_three_digits(m.mean) if m.count else '–':>11}" for m in means)
            texts.append(f"{name:<{width}}  {IN_WORDS[recipe]:<27}{figures}")
            name = ""
        if outcome.row.paper and (i + 1 == len(found) or found[i + 1].row != outcome.row):
            figures = "".join(f"{_papers(outcome.row.paper.get(c)).text:>11}" for c in COLUMNS)
            texts.append(f"{'':<{width}}  {'paper, other scenes':<27}{figures}")
    counts = Counter(outcome.status for outcome in found if outcome.records)
    for status, count in counts.items():
        if status != "ok":
            texts.append(f"{count} rows: {status}")
    return texts
