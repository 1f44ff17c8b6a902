"""The suite as files: page, plots, Markdown, CSV, summary."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pbrfit_evaluation import page, summary
from pbrfit_evaluation.page import Cell, Section, Table
from pbrfit_evaluation.solvers import Measured, Part
from pbrfit_evaluation.solvers.report.sections import SECTIONS
from pbrfit_evaluation.solvers.report.verdicts import verdicts
from pbrfit_evaluation.tables import write_csv
from pbrfit_evaluation.verdicts import Verdict, must_hold
from pbrfit_evaluation.verdicts import lines as said

MARKDOWN, SCENES = "solvers.md", "scenes.csv"

PROTOCOL = "pbrfit-solvers-1"
"""Under one name and effort, the same scenes, seeds and measures."""


def write(folder: Path, measured: Measured) -> None:
    """Write `report.html`, its plots, `solvers.md`, `scenes.csv` and `summary.json`."""
    judged = verdicts(measured)
    sections = [must_hold(judged)]
    sections += [make(measured) for part, make in SECTIONS.items() if measured.found.get(part)]
    if measured.failed:
        rows = [[Cell(r.key), Cell(r.error or "", "why")] for r in measured.failed]
        sections.append(Section("What failed", [], [Table([Cell("Task"), Cell("Error")], rows)]))
    page.write_page(folder, "The second-order solvers", _opening(measured, judged), sections)
    (folder / MARKDOWN).write_text(
        "\n".join(_titled(section.title, t) for section in sections for t in section.tables),
        encoding="utf-8",
    )
    write_csv(folder / SCENES, ("part", "task", "figure", "value"), _figures(measured))
    summary.write_summary(
        folder, f"{PROTOCOL}, {measured.effort.name}", list(_rows(measured, judged))
    )


def lines(measured: Measured) -> list[str]:
    """The verdicts, for a terminal."""
    return said(verdicts(measured))


def _opening(measured: Measured, judged: list[Verdict[Part]]) -> list[str]:
    held = sum(verdict.holds for verdict in judged)
    on = summary.machine()
    effort = measured.effort
    return [
        f"{held} of {len(judged)} demands hold.",
        "Whether the second-order solver “gauss-newton”, and “auto”, which goes on from there with "
        "L-BFGS on the whole objective, reach what they are there for, beside “lbfgsb”, scipy's "
        "L-BFGS-B.",
        f"pbrfit {version('pbrfit')}, effort “{effort.name}”, {effort.iterations} iterations; "
        f"jobs at a time: {measured.jobs}, but race and memory alone; {on['processor']}, "
        f"{on['cores']} cores, {on['system']}, Python {on['python']}, numpy {on['numpy']}.",
        *(f"{part.capitalize()}: {note}." for part, note in measured.notes.items()),
    ]


def _titled(title: str, table: Table) -> str:
    caption = f"{table.caption}\n\n" if table.caption else ""
    return f"### {title}\n\n{caption}{page.markdown(table)}"


def _figures(measured: Measured) -> Iterator[tuple[str, str, str, float]]:
    """Every number of every task; lists, such as curves, are in the records alone."""
    for part in measured.found:
        for task, values in measured.finished(part):
            for name, value in _numbers(values):
                yield part, task.key, name, value


def _numbers(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, float]]:
    for name, value in values.items():
        path = f"{before}{name}"
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{path}/")
        elif isinstance(value, (int, float)):
            yield path, float(value)


def _rows(measured: Measured, judged: list[Verdict[Part]]) -> Iterator[summary.Row]:
    for verdict in judged:
        yield summary.Row(
            f"{verdict.part}: {verdict.what}",
            len(measured.finished(verdict.part)),
            None,
            {"value": verdict.value, "bar": verdict.bar, "at_least": float(verdict.at_least)},
            status="ok" if verdict.holds else "not held",
        )
    for part in measured.found:
        if not measured.finished(part):
            yield summary.Row(part, 0, None, {}, status="every task failed")
