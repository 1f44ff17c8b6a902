"""The suite as files: page, plots, Markdown, CSV, summary."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pbrfit_evaluation import page, summary
from pbrfit_evaluation.normals import Measured, Part
from pbrfit_evaluation.normals.report.sections import SECTIONS
from pbrfit_evaluation.normals.report.verdicts import JUDGED, verdicts
from pbrfit_evaluation.page import Cell, Section, Table
from pbrfit_evaluation.tables import write_csv
from pbrfit_evaluation.verdicts import Verdict, must_hold
from pbrfit_evaluation.verdicts import lines as said

MARKDOWN, SCENES = "normals.md", "scenes.csv"

PROTOCOL = "pbrfit-normals-1"
"""Under one name and effort, the same scenes, seeds and measures."""

JUDGING = (
    f"Judged is “{JUDGED}”, the default; without noise “on”. Won back: (not refined − refined) / "
    "(not refined − floor), of means over scenes."
)


def write(folder: Path, measured: Measured) -> None:
    """Write `report.html`, its figures, `normals.md`, `scenes.csv` and `summary.json`."""
    judged = verdicts(measured)
    sections = [must_hold(judged, [JUDGING])] if judged else []
    sections += [make(measured) for part, make in SECTIONS.items() if measured.finished(part)]
    if measured.failed:
        rows = [[Cell(r.key), Cell(r.error or "", "why")] for r in measured.failed]
        sections.append(Section("What failed", [], [Table([Cell("Task"), Cell("Error")], rows)]))
    opening = _opening(measured, judged)
    page.write_page(folder, "Wrong normals, refined", opening, sections)
    blocks = ["\n\n".join(opening) + "\n"]
    blocks += [_titled(section.title, t) for section in sections for t in section.tables]
    (folder / MARKDOWN).write_text("\n".join(blocks), encoding="utf-8")
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
        "What wrong normals cost, and how much of it comes back when they are refined together "
        "with materials and lights.",
        f"pbrfit {version('pbrfit')}, effort “{effort.name}”, at most {effort.iterations} "
        f"iterations; jobs at a time: {measured.jobs}, but cost alone; {on['processor']}, "
        f"{on['cores']} cores, {on['system']}, Python {on['python']}, numpy {on['numpy']}.",
        *(f"{part.capitalize()}: {note}." for part, note in measured.notes.items()),
    ]


def _titled(title: str, table: Table) -> str:
    caption = f"{table.caption}\n\n" if table.caption else ""
    return f"### {title}\n\n{caption}{page.markdown(table)}"


def _figures(measured: Measured) -> Iterator[tuple[str, str, str, float | str]]:
    """Every number of every task, and why it was decided so; pictures are in the records alone."""
    for part in measured.found:
        for task, values in measured.finished(part):
            for name, value in _leaves(values):
                yield part, task.key, name, value


def _leaves(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, float | str]]:
    for name, value in values.items():
        path = f"{before}{name}"
        if isinstance(value, Mapping) and name != "panels":
            yield from _leaves(value, f"{path}/")
        elif isinstance(value, (int, float)):
            yield path, float(value)
        elif isinstance(value, str):
            yield path, value


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
        if measured.found[part] and not measured.finished(part):
            yield summary.Row(part, 0, None, {}, status="every task failed")
