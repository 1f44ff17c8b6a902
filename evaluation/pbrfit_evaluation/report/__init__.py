"""The report of a suite: page, plots, Markdown, CSV files and summary, from data alone."""

from __future__ import annotations

import argparse
import csv
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit.io.json_files import as_json, write_json
from pbrfit.report import html
from pbrfit.report.html import Cell, address, paragraph
from pbrfit_evaluation.jobs import SUMMARY, Record
from pbrfit_evaluation.suite import (
    Line,
    Picture,
    Results,
    Row,
    Section,
    Suite,
    Table,
    Value,
    Verdict,
    csv_files,
    digits,
)

CPUINFO = Path("/proc/cpuinfo")

_TOLD = ("name", "scenes", "solver", "metrics", "paper", "status")
"""Of a row, in the summary."""


def write_summary(
    folder: Path,
    protocol: str,
    rows: Sequence[Row],
    *,
    command: str,
    tables: Mapping[str, str],
) -> None:
    """Write `summary.json` into an existing folder.

    `protocol` is name and version of how things were measured: results under one name compare.
    `command` makes them again, without names of this machine; `tables` are those of the page as
    Markdown, by title.
    """
    content = {
        "protocol": protocol,
        "command": command,
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "version": version("pbrfit"),
        "machine": machine(),
        "rows": [{name: as_json(getattr(row, name)) for name in _TOLD} for row in rows],
        "tables": [{"title": title, "markdown": text} for title, text in tables.items()],
    }
    private = sorted({row.name for row in rows if row.private})
    content |= {"private": private} if private else {}
    write_json(folder / SUMMARY, content)


def machine() -> dict[str, str | int]:
    """What the measurements ran on."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


def _processor() -> str:
    try:
        lines = CPUINFO.read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


PAGE = "report.html"

LONG = 40
"""Letters; longer text in a table is folded."""


@dataclass(frozen=True)
class Outcome:
    """All that a run of a suite found, for its report."""

    rows: Sequence[Row]
    verdicts: Sequence[Verdict]
    sections: Sequence[Section]
    files: Mapping[str, Sequence[Line] | bytes]
    failed: Sequence[Record]


def outcome(suite: Suite[Any], results: Results[Any]) -> Outcome:
    """What a suite makes of its records."""
    rows = suite.rows(results)
    return Outcome(
        rows,
        list(suite.verdicts(results, rows)),
        list(suite.sections(results, rows)),
        {**csv_files(results), **suite.files(results)},
        results.failed,
    )


def write(folder: Path, suite: Suite[Any], options: argparse.Namespace, found: Outcome) -> None:
    """Write `report.html`, its plots and pictures, `NAME.md`, CSV files and `summary.json`."""
    sections = [*_judged(found.verdicts), *found.sections, *_failures(found.failed)]
    (folder / PAGE).write_text(
        _page(folder, suite.title, _opening(suite, options, found), sections), encoding="utf-8"
    )
    texts = (
        f"### {section.title}\n\n{markdown(table)}"
        for section in sections
        for table in section.tables
    )
    (folder / f"{suite.name}.md").write_text("\n".join(texts), encoding="utf-8")
    for name, lines in found.files.items():
        if isinstance(lines, bytes):
            (folder / name).write_bytes(lines)
        else:
            _write_csv(folder / name, lines)
    write_summary(
        folder,
        suite.protocol_of(options),
        [*(verdict.row for verdict in found.verdicts), *found.rows],
        command=command_of(suite, options),
        tables=_by_title(sections),
    )


def command_of(suite: Suite[Any], options: argparse.Namespace) -> str:
    """What makes the figures again: options that are not the defaults, folders by name."""
    words = ["pbrfit", "evaluate", suite.name, *(["--quick"] if options.quick else [])]
    words += [_told(options.folders)] if suite.folders and options.folders else []
    for name, setting in suite.settings.items():
        asked = getattr(options, name)
        if setting.flag is not None and asked not in (getattr(setting, options.effort), None):
            words.append(f"--{(setting.name or name).replace('_', '-')}")
            words += [] if asked is True else [_told(asked)]
    return " ".join(words)


def _by_title(sections: Iterable[Section]) -> dict[str, str]:
    """Tables as Markdown; of several in a section, those after the first have a number."""
    found = {}
    for section in sections:
        for i, table in enumerate(section.tables):
            found[f"{section.title} {i + 1}" if i else section.title] = markdown(table)
    return found


def lines(found: Outcome) -> list[str]:
    """For a terminal: the verdicts, or else the first table."""
    if found.verdicts:
        return [
            f"{'holds' if v.holds else 'FAILS':<7}{digits(v.value):>12} {_bar(v):>10}  {v.what}"
            + (f"  ({v.where})" if v.where else "")
            for v in found.verdicts
        ]
    tables = [table for section in found.sections for table in section.tables]
    return markdown(tables[0]).splitlines() if tables else []


def _opening(suite: Suite[Any], options: argparse.Namespace, found: Outcome) -> list[str]:
    on = machine()
    asked = {name: getattr(options, name) for name in suite.settings}
    told = ", ".join(
        f"{name.replace('_', ' ')} {_told(value)}"
        for name, value in asked.items()
        if value not in (None, False)
    )
    bars = [verdict for verdict in found.verdicts if verdict.bar is not None]
    held = sum(verdict.holds for verdict in bars)
    return [
        *([f"{held} of {len(bars)} demands hold."] if bars else []),
        *suite.about,
        f"Protocol: {suite.protocol_of(options)}.",
        f"pbrfit {version('pbrfit')}, effort “{options.effort}”{', ' if told else ''}{told}. "
        f"{on['processor']}, {on['cores']} cores, {on['system']}, Python {on['python']}, numpy "
        f"{on['numpy']}.",
    ]


def _told(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return " ".join(map(_told, value))
    return value.name if isinstance(value, Path) else str(value)


def _bar(verdict: Verdict) -> str:
    """What the figure has to be."""
    if verdict.bar is None:
        return ""
    return f"{'≥' if verdict.at_least else '≤'} {digits(verdict.bar)}"


_FAILS = "does\N{NO-BREAK SPACE}not\N{NO-BREAK SPACE}hold"


def _judged(verdicts: Sequence[Verdict]) -> Iterable[Section]:
    if not verdicts:
        return
    parts = len({verdict.part for verdict in verdicts}) > 1
    rows: list[list[Value]] = []
    part = None
    for verdict in verdicts:
        holds = Cell("holds", "pass") if verdict.holds else Cell(_FAILS, "fail")
        row: list[Value] = [verdict.what, Cell(digits(verdict.value), "number", verdict.value)]
        row += [Cell(_bar(verdict), "number"), "" if verdict.bar is None else holds, verdict.where]
        rows.append([Cell("" if verdict.part == part else verdict.part, "name"), *row][not parts :])
        part = verdict.part
    columns = ["part", "what", "found", "must be", "verdict", "where"][not parts :]
    yield Section("What must hold", tables=[Table(columns, rows)])


def _failures(failed: Sequence[Record]) -> Iterable[Section]:
    if failed:
        table = Table(
            ["case", "error"], [[record.key, Cell(record.error or "", "why")] for record in failed]
        )
        yield Section("What failed", "Failed cases are in no figure.", [table])


def _write_csv(path: Path, lines: Sequence[Line]) -> None:
    """Write CSV with a header line; numbers in full precision, NaN and what is not there empty."""
    columns = dict.fromkeys(column for line in lines for column in line)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(columns))
        writer.writeheader()
        for line in lines:
            writer.writerow({name: value for name, value in line.items() if value == value})


# ------------------------------------------------------------------------------------- the page


def _page(folder: Path, title: str, opening: Sequence[str], sections: Sequence[Section]) -> str:
    body = [f"<h1>{escape(title)}</h1>", *map(paragraph, opening)]
    for section in sections:
        body.append(f"<h2>{escape(section.title)}</h2>")
        body += [paragraph(text) for text in section.text.split("\n\n") if text]
        body += [html.table(_dressed(table)) for table in section.tables]
        body += [_figure(folder, figure) for figure in section.figures]
    return html.document(title, "\n".join(body))


def _figure(folder: Path, figure: Picture) -> str:
    (folder / f"{figure.name}.png").write_bytes(figure.png)
    caption = escape(figure.caption)
    return (
        f'<figure><img src="{address(figure.png)}" alt="{caption}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _dressed(table: Table) -> html.Table:
    """The table with a look for each cell: numbers right, long text folded."""
    columns = [
        Cell(text, "number" if number else "name" if len(text) <= LONG else "")
        for text, number in zip(table.columns, _numeric(table), strict=True)
    ]
    return html.Table(columns, [list(map(_cell, row)) for row in table.rows])


def _numeric(table: Table) -> list[bool]:
    """By column, whether it holds numbers."""
    columns = zip(*(map(_cell, row) for row in table.rows), strict=True) if table.rows else ()
    found = [any(cell.look in ("number", "best") for cell in column) for column in columns]
    return found or [False] * len(table.columns)


def _cell(value: Value) -> Cell:
    if isinstance(value, Cell):
        return value
    if isinstance(value, str):
        return Cell(value, "why" if len(value) > LONG else "name")
    if value is None or value != value:
        return Cell("–", "number")
    return Cell(digits(value), "number", float(value))


def markdown(table: Table) -> str:
    """Write a table as GitHub's Markdown, a line of text with each row."""
    rule = ["---:" if number else "---" for number in _numeric(table)]
    rows = [[text.replace("|", "\\|") for text in table.columns], rule]
    rows += [[_marked(_cell(value)) for value in row] for row in table.rows]
    return "".join(f"| {' | '.join(' '.join(text.split()) for text in row)} |\n" for row in rows)


def _marked(cell: Cell) -> str:
    text = cell.text.replace("|", "\\|")
    return f"**{text}**" if cell.look == "best" and text else text
