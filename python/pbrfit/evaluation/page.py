"""One self-contained HTML page: sections with sentences, a table and plots."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

FILE = "report.html"

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1e1e1e; background: #fff;
       max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; margin-bottom: .3rem; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 .3rem; }
p { max-width: 46rem; margin: .5rem 0; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .875rem; width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .3rem .8rem .3rem 0;
         border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #888; }
td.number, th.number { text-align: right; white-space: nowrap;
                       font-variant-numeric: tabular-nums; }
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


@dataclass(frozen=True)
class Line:
    """A row of a table: a figure beside its bound, both as text.

    `passed` is None where there is no bound.
    """

    what: str
    figure: str
    where: str
    bound: str
    passed: bool | None
    why: str


@dataclass(frozen=True)
class Section:
    """A heading, sentences, a table, plots."""

    title: str
    sentences: Sequence[str]
    lines: Sequence[Line] = ()
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
        if section.lines:
            body.append(_table(section.lines))
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


def _table(lines: Sequence[Line]) -> str:
    head = (
        '<tr><th>What</th><th class="number">Worst</th><th class="number">Bound</th>'
        "<th>Verdict</th><th>Where</th><th>Why this bound</th></tr>"
    )
    return f'<div class="scroll"><table>{head}{"".join(map(_row, lines))}</table></div>'


def _row(line: Line) -> str:
    verdict = {
        True: '<span class="pass">pass</span>',
        False: '<span class="fail">FAIL</span>',
        None: '<span class="note">reported</span>',
    }[line.passed]
    return (
        f'<tr><td>{escape(line.what)}</td><td class="number">{escape(line.figure)}</td>'
        f'<td class="number">{escape(line.bound)}</td><td>{verdict}</td>'
        f'<td>{escape(line.where)}</td><td class="why">{escape(line.why)}</td></tr>'
    )


def _figure(figure: Figure) -> str:
    data = base64.b64encode(figure.png).decode("ascii")
    caption = escape(figure.caption)
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{caption}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
