"""One self-contained HTML page: sections with sentences, tables and pictures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Literal

FILE = "report.html"

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1e1e1e; background: #fff;
       max-width: 76rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; margin-bottom: .3rem; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 .3rem; }
p { max-width: 46rem; margin: .5rem 0; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .875rem; width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .3rem .8rem .3rem 0;
         border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #888; }
td.number, th.number { text-align: right; white-space: nowrap;
                       font-variant-numeric: tabular-nums; }
td.name, th.name { white-space: nowrap; }
td.why { color: #555; max-width: 24rem; }
.pass { color: #00674b; font-weight: 600; }
.fail { color: #fff; background: #b33c00; font-weight: 600; padding: 0 .4em; border-radius: 3px; }
.note { color: #555; }
.scroll { overflow-x: auto; }
figure { margin: 1rem 0; }
img { max-width: 100%; height: auto; }
figcaption { max-width: 46rem; color: #555; font-size: .875rem; }
"""


@dataclass(frozen=True)
class Figure:
    """A plot: its file's name without suffix, the PNG, and what it shows."""

    name: str
    png: bytes
    caption: str


Look = Literal["", "name", "number", "best", "pass", "fail", "note", "why"]
"""How a cell looks: a name on one line, a figure that is aligned right, a verdict, a remark."""


@dataclass(frozen=True)
class Cell:
    """Text in a table; a line break in it stays one."""

    text: str
    look: Look = ""


@dataclass(frozen=True)
class Table:
    """Names of the columns, and rows with a cell for each. A caption stands above."""

    columns: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""


@dataclass(frozen=True)
class Section:
    """A heading, sentences, tables, pictures."""

    title: str
    sentences: Sequence[str]
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


def write_page(
    folder: Path, title: str, sentences: Sequence[str], sections: Sequence[Section]
) -> None:
    """Write `report.html`, with its plots inside, and each plot as NAME.png beside it."""
    for section in sections:
        for figure in section.figures:
            (folder / f"{figure.name}.png").write_bytes(figure.png)
    body = [f"<h1>{escape(title)}</h1>", *(_paragraph(text) for text in sentences)]
    for section in sections:
        body.append(f"<h2>{escape(section.title)}</h2>")
        body += [_paragraph(text) for text in section.sentences]
        body += [_table(table) for table in section.tables]
        body += [_figure(figure) for figure in section.figures]
    content = "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>",
            *body,
            "</body>\n</html>\n",
        ]
    )
    (folder / FILE).write_text(content, encoding="utf-8")


def _paragraph(text: str) -> str:
    return f"<p>{escape(text)}</p>"


def _table(table: Table) -> str:
    caption = _paragraph(table.caption) if table.caption else ""
    head = "".join(_cell("th", cell) for cell in table.columns)
    rows = "".join(f"<tr>{''.join(_cell('td', cell) for cell in row)}</tr>" for row in table.rows)
    return f'{caption}<div class="scroll"><table><tr>{head}</tr>{rows}</table></div>'


def _cell(tag: str, cell: Cell) -> str:
    text = escape(cell.text).replace("\n", "<br>")
    if cell.look in ("pass", "fail", "note"):
        return f'<{tag}><span class="{cell.look}">{text}</span></{tag}>'
    if cell.look == "best":
        return f'<{tag} class="number"><b>{text}</b></{tag}>'
    return f'<{tag} class="{cell.look}">{text}</{tag}>' if cell.look else f"<{tag}>{text}</{tag}>"


def markdown(table: Table) -> str:
    """Write a table as GitHub's Markdown, a line of text with each row."""
    right = ("number", "best")
    rule = ["---:" if cell.look in right else "---" for cell in table.columns]
    rows = [[cell.text for cell in table.columns], rule]
    rows += [[_marked(cell) for cell in row] for row in table.rows]
    lines = (" | ".join(" ".join(text.split()) for text in row) for row in rows)
    return "".join(f"| {line} |\n" for line in lines)


def _marked(cell: Cell) -> str:
    text = cell.text.replace("|", "\\|")
    return f"**{text}**" if cell.look == "best" and text else text


def _figure(figure: Figure) -> str:
    data = base64.b64encode(figure.png).decode("ascii")
    caption = escape(figure.caption)
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{caption}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
