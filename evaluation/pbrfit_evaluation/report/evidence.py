"""Measured tables in the documentation: filled from summaries, and held against them.

Each suite and benchmark leaves its `summary.json` in `docs/evidence/NAME.json`. A page shows a
table of it between two comments, and a plot of it as a picture in that folder:

    <!-- evidence: NAME/TITLE -->
    (the table, and how it was measured)
    <!-- /evidence -->

    ![What it shows](evidence/NAME-PLOT.png)

`NAME/TITLE | HEADING | HEADING` shows these columns after the first, and no others; `| rows: A; B`
those rows, with the nameless ones below each. A test fails where page and summary differ.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

from pbrfit._core import InputError
from pbrfit.io.json_files import read_json, write_json
from pbrfit_evaluation.report import markdown, write_summary
from pbrfit_evaluation.suite import Row, Table

FOLDER = "evidence"
"""In the folder of the documentation."""

BLOCK = re.compile(
    r"(?P<head><!-- evidence: (?P<name>[a-z0-9-]+)/(?P<title>[^\n|]+?)"
    r"(?P<columns>( \| [^\n|]+?)*) -->\n)"
    r"(?P<body>.*?)"
    r"(?P<foot><!-- /evidence -->)",
    re.DOTALL,
)

ABSENT = "\n*Not measured at this version yet.*\n\n"
"""What stands in place of a table whose summary is not there."""

_MENTION = re.compile(rf"\b{FOLDER}/(?P<file>[A-Za-z0-9._-]+\.(?:png|webp|csv))\b")


def pages(docs: Path) -> list[Path]:
    """Markdown files that may show evidence: the documentation, and README beside its folder."""
    return [docs.parent / "README.md", *sorted(docs.rglob("*.md"))]


def record(
    docs: Path,
    name: str,
    *,
    command: str,
    protocol: str,
    tables: Mapping[str, Table],
    rows: Sequence[Row] = (),
    files: Mapping[str, bytes] = MappingProxyType({}),
) -> None:
    """As `publish`, for a benchmark or tool that is no suite: its tables, rows and plots."""
    with TemporaryDirectory() as name_of_folder:
        folder = Path(name_of_folder)
        for file, content in files.items():
            (folder / file).write_bytes(content)
        texts = {title: markdown(table) for title, table in tables.items()}
        write_summary(folder, protocol, rows, command=command, tables=texts)
        publish(docs, name, folder)


def publish(docs: Path, name: str, folder: Path) -> None:
    """Take over a suite's summary, the plots and CSV files that pages show, and fill the pages.

    `docs` is the folder of the documentation, with README.md beside it; `name` that of the suite or
    benchmark, which wrote `folder`. Raises InputError if there is no documentation, or a page asks
    for a table that the summary lacks.
    """
    if not docs.is_dir():
        raise InputError(f"{docs}: expected the documentation's folder, found none")
    summary = _public(read_json(folder / "summary.json", "a summary"))
    texts = {page: page.read_text(encoding="utf-8") for page in pages(docs)}
    filled = {page: _filled(page, text, name, summary) for page, text in texts.items()}
    to = docs / FOLDER
    to.mkdir(exist_ok=True)
    write_json(to / f"{name}.json", summary)
    for page, text in texts.items():
        for mention in _MENTION.finditer(text):
            file = mention["file"].removeprefix(f"{name}-")
            if file != mention["file"] and (folder / file).is_file():
                shutil.copyfile(folder / file, to / mention["file"])
        if filled[page] != text:
            page.write_text(filled[page], encoding="utf-8")


def _public(summary: Mapping[str, Any]) -> dict[str, Any]:
    """The summary without private rows, and without lines of tables that are of these or a case."""
    private = summary.get("private", ())

    def told(table: str) -> str:
        lines, first = [], ""
        for line in table.splitlines(keepends=True):
            first = _BORDER.split(line)[1].strip() or first  # nameless lines are of the last name
            if first not in private and not any(first.startswith(f"{of}-") for of in private):
                lines.append(line)
        return "".join(lines)

    tables = [{**table, "markdown": told(table["markdown"])} for table in summary["tables"]]
    rows = [row for row in summary["rows"] if row["name"] not in private]
    rest = {key: value for key, value in summary.items() if key != "private"}
    return {**rest, "rows": rows, "tables": tables}


def _filled(page: Path, text: str, name: str, summary: Mapping[str, Any]) -> str:
    """The text of a page with the tables of a summary in it."""

    def replaced(block: re.Match[str]) -> str:
        mine = block["name"] == name
        return block["head"] + shown(page, summary, block) + block["foot"] if mine else block[0]

    return BLOCK.sub(replaced, text)


def differences(docs: Path) -> Iterator[str]:
    """Pages whose tables are not what the summaries say, in a line each."""
    for page in pages(docs):
        for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
            name = block["name"]
            there = (docs / FOLDER / f"{name}.json").is_file()
            told = shown(page, read(docs, name), block) if there else ABSENT
            if block["body"] != told:
                yield f"{page.name}: {block['name']}/{block['title']} is not as measured"


def shown(page: Path, summary: Mapping[str, Any], block: re.Match[str]) -> str:
    """What stands between the comments of a block: the table, and how it was measured.

    Raises InputError if the summary lacks the table, or the table a column or row.
    """
    name, title, columns = block["name"], block["title"], block["columns"]
    tables = {of["title"]: of["markdown"] for of in summary["tables"]}
    if title not in tables:
        raise InputError(f"{page}: expected a table of {name} ({', '.join(tables)}), found {title}")
    table = _part(f"{page}: {name}/{title}", tables[title], columns.split(" | ")[1:])
    return f"\n{table}\n*{provenance(summary)}*\n\n"


_BORDER = re.compile(r"(?<!\\)\|")


def _part(where: str, table: str, wanted: Sequence[str]) -> str:
    """The first column of a Markdown table and those of the headings; all rows, or those named."""
    head, line, *rows = (
        [one.strip() for one in _BORDER.split(of)[1:-1]] for of in table.split("\n") if of
    )
    headings = [one for one in wanted if not one.startswith("rows: ")]
    named = [name for one in wanted if one not in headings for name in one[6:].split("; ")]
    firsts: list[str] = []
    for row in rows:
        firsts.append(row[0] or firsts[-1])
    for what, names, known in (("column", headings, head[1:]), ("row", named, firsts)):
        if lost := [name for name in names if name not in known]:
            there = ", ".join(dict.fromkeys(known))
            raise InputError(f"{where}: expected a {what} ({there}), found {lost[0]}")
    kept = [0, *(head.index(one, 1) for one in headings)] if headings else range(len(head))
    body = [row for row, first in zip(rows, firsts, strict=True) if not named or first in named]
    return "".join(f"| {' | '.join(row[i] for i in kept)} |\n" for row in (head, line, *body))


def read(docs: Path, name: str) -> Mapping[str, Any]:
    """A summary that the documentation keeps.

    Raises InputError if it is absent.
    """
    path = docs / FOLDER / f"{name}.json"
    if not path.is_file():
        raise InputError(f"{path}: expected the summary of {name}, found none")
    return dict(read_json(path, f"the summary of {name}"))


def provenance(summary: Mapping[str, Any]) -> str:
    """Command, date, version and machine, in a line of Markdown."""
    on = summary["machine"]
    return (
        f"`{summary['command']}`, {summary['date']}, pbrfit {summary['version']}, "
        f"{on['processor']}, {on['cores']} cores."
    )
