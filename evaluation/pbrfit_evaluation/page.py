"""One self-contained HTML page: sections with sentences, tables and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from pbrfit.report.html import Cell, Look, Table, document, paragraph, png_address, table

__all__ = ["Cell", "Figure", "Look", "Section", "Table", "markdown", "write_page"]

FILE = "report.html"


@dataclass(frozen=True)
class Figure:
    """A plot: its file's name without suffix, the PNG, and what it shows."""

    name: str
    png: bytes
    caption: str


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
    body = [f"<h1>{escape(title)}</h1>", *(paragraph(text) for text in sentences)]
    for section in sections:
        body.append(f"<h2>{escape(section.title)}</h2>")
        body += [paragraph(text) for text in section.sentences]
        body += [table(content) for content in section.tables]
        body += [_figure(figure) for figure in section.figures]
    content = document(title, "\n".join(body))
    (folder / FILE).write_text(content, encoding="utf-8")


def markdown(content: Table) -> str:
    """Write a table as GitHub's Markdown, a line of text with each row."""
    right = ("number", "best")
    rule = ["---:" if cell.look in right else "---" for cell in content.columns]
    rows = [[cell.text for cell in content.columns], rule]
    rows += [[_marked(cell) for cell in row] for row in content.rows]
    lines = (" | ".join(" ".join(text.split()) for text in row) for row in rows)
    return "".join(f"| {line} |\n" for line in lines)


def _marked(cell: Cell) -> str:
    text = cell.text.replace("|", "\\|")
    return f"**{text}**" if cell.look == "best" and text else text


def _figure(figure: Figure) -> str:
    caption = escape(figure.caption)
    return (
        f'<figure><img src="{png_address(figure.png)}" alt="{caption}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
