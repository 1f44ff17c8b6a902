"""HTML that every page of the package is made of: one look, tables, pictures inside.

All text is escaped here, and nothing refers to another file or to the network. Browsers hold a page
to that: they run the scripts that it was made with and no other, and load nothing.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Literal

from pbrfit.values.quoting import visible

THEME_BUTTON = (
    '<button type="button" class="theme tool" hidden aria-label="Light or dark theme" '
    'title="Light or dark theme"><svg viewBox="0 0 24 24" aria-hidden="true">'
    '<circle cx="12" cy="12" r="8"/><path d="M12 4a8 8 0 0 1 0 16z" fill="currentColor"/></svg>'
    "</button>"
)
"""Switches between the themes; hidden where no script runs."""

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


def text_of(name: str) -> str:
    """A file of this room, such as a style sheet."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def document(
    title: str,
    body: str,
    *,
    style: str = "",
    script: str = "",
    within: Sequence[str] = (),
    look: str = "",
) -> str:
    """Whole page; `style` comes after the common one, `script` runs when the page is read.

    `within` are the scripts that stand in the body; no other runs there. A body of its own `look`,
    a class of `style`, has the theme's button in its own place. Letters that turn the direction of
    writing, and controls, are shown as \ufffd. In `page.html` the theme's script comes first of
    all, so that no page is shown in the other theme before, and an empty icon, or a browser would
    look for one beside the page.
    """
    theme, own = text_of("theme.js"), [script] if script else []
    bare = f'<body>\n<div class="page-theme">{THEME_BUTTON}</div>'
    return Template(text_of("page.html")).substitute(
        policy=policy([theme, *within, *own]),
        title=escape(visible(title)),
        theme=theme,
        style=text_of("themes.css") + text_of("base.css") + style,
        opened=f'<body class="{look}">' if look else bare,
        body=visible(body),
        script="".join(f"<script>{one}</script>\n" for one in own),
    )


def policy(scripts: Sequence[str]) -> str:
    """What a page may do (W3C, Content Security Policy Level 3): these scripts, nothing loaded."""
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    return "; ".join(
        [
            "default-src 'none'",
            "script-src " + " ".join(f"'sha256-{in_base64(digest)}'" for digest in digests),
            "style-src 'unsafe-inline'",  # widths and colours stand in attributes
            "img-src data: blob:",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )


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


def address(content: bytes) -> str:
    """The address that holds a picture, a file of PNG, JPEG or WebP."""
    kinds = {b"\x89P": "png", b"\xff\xd8": "jpeg", b"RI": "webp"}
    return f"data:image/{kinds[content[:2]]};base64,{in_base64(content)}"


def in_base64(content: bytes) -> str:
    """Bytes as letters."""
    return base64.b64encode(content).decode("ascii")


def _cell(tag: str, cell: Cell) -> str:
    text = escape(cell.text).replace("\n", "<br>")
    if cell.value is not None:
        text = f'<data value="{float(cell.value)!r}">{text}</data>'
    if cell.color:
        text = f'<span class="patch" style="background:{cell.color}"></span> {text}'
    if cell.look in ("pass", "fail", "note"):
        return f'<{tag}><span class="{cell.look}">{text}</span></{tag}>'
    if cell.look == "best":
        return f'<{tag} class="number"><b>{text}</b></{tag}>'
    return f'<{tag} class="{cell.look}">{text}</{tag}>' if cell.look else f"<{tag}>{text}</{tag}>"
