"""HTML that every page of the package is made of: one look, tables, pictures inside.

All text is escaped here, and nothing refers to another file or to the network.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

from pbrfit.result.verdict import Mark

STYLE = """
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
.disc { display: inline-block; width: .7rem; height: .7rem; border: 2px solid; border-radius: 50%;
        margin-right: .3rem; vertical-align: -.1rem; print-color-adjust: exact;
        -webkit-print-color-adjust: exact; }
a { color: #00527f; }
:focus-visible { outline: 3px solid #0072B2; outline-offset: 2px; }
.scroll { overflow-x: auto; }
figure { margin: 1rem 0; }
img { max-width: 100%; height: auto; }
figcaption { max-width: 46rem; color: #555; font-size: .875rem; }
"""


Look = Literal["", "name", "number", "best", "pass", "fail", "note", "why", "hash"]
"""How a cell looks: a name on one line, a figure that is aligned right, a verdict, a remark."""


@dataclass(frozen=True)
class Cell:
    """Text in a table; a line break in it stays one. `value`: the number in full, for programs."""

    text: str
    look: Look = ""
    value: float | None = None
    color: str = ""
    """For a style sheet: a patch of it stands before the text."""
    mark: Mark | None = None
    """Stands before the text."""


def number(text: str, value: float | None = None) -> Cell:
    """A figure, and the number in full."""
    return Cell(text, "number", value)


def heads(first: str, *others: str) -> list[Cell]:
    """Names of columns: of a name, and of figures."""
    return [Cell(first, "name"), *(Cell(name, "number") for name in others)]


@dataclass(frozen=True)
class Table:
    """Names of the columns, and rows with a cell for each. A caption stands above."""

    columns: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""


def document(title: str, body: str, *, style: str = "", script: str = "") -> str:
    """Whole page; `style` comes after the common one, `script` runs when the page is read."""
    head = [
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        # No icon: a browser would look for one beside the page.
        f'<title>{escape(title)}</title>\n<link rel="icon" href="data:,">',
        f"<style>{STYLE}{style}</style>\n</head>\n<body>",
    ]
    tail = [f"<script>{script}</script>"] if script else []
    return "\n".join([*head, body, *tail, "</body>\n</html>\n"])


def paragraph(text: str, look: str = "") -> str:
    """One paragraph of a class `look`."""
    return f'<p class="{look}">{escape(text)}</p>' if look else f"<p>{escape(text)}</p>"


def table(content: Table) -> str:
    """Caption and table; a wide one scrolls by itself."""
    caption = paragraph(content.caption) if content.caption else ""
    head = "".join(_cell("th", cell) for cell in content.columns)
    if head:
        head = f"<tr>{head}</tr>"
    rows = "".join(f"<tr>{''.join(_cell('td', c) for c in row)}</tr>" for row in content.rows)
    return f'{caption}<div class="scroll"><table>{head}{rows}</table></div>'


def png_address(png: bytes) -> str:
    """Give a picture as an address that holds it."""
    return f"data:image/png;base64,{in_base64(png)}"


def in_base64(content: bytes) -> str:
    """Bytes as letters."""
    return base64.b64encode(content).decode("ascii")


def _disc(mark: Mark) -> str:
    red, green, blue = (round(255 * part) for part in mark.color)
    color, share = f"#{red:02x}{green:02x}{blue:02x}", f"{100 * mark.filled:g}%"
    filling = f"linear-gradient(90deg, {color} {share}, transparent {share})"
    return f'<span class="disc" style="border-color:{color};background:{filling}"></span>'


def _cell(tag: str, cell: Cell) -> str:
    text = escape(cell.text).replace("\n", "<br>")
    if cell.value is not None:
        text = f'<data value="{float(cell.value)!r}">{text}</data>'
    if cell.color:
        text = f'<span class="patch" style="background:{cell.color}"></span> {text}'
    if cell.mark is not None:
        text = f"{_disc(cell.mark)}{text}"
    if cell.look in ("pass", "fail", "note"):
        return f'<{tag}><span class="{cell.look}">{text}</span></{tag}>'
    if cell.look == "best":
        return f'<{tag} class="number"><b>{text}</b></{tag}>'
    return f'<{tag} class="{cell.look}">{text}</{tag}>' if cell.look else f"<{tag}>{text}</{tag}>"
