"""How well a result explains pictures that it was not fitted to, and what else was compared."""

from __future__ import annotations

from html import escape

from pbrfit.report.html import Cell, Look, Table, heads, paragraph, table
from pbrfit.report.notation import percent
from pbrfit.result.result import Result

ANCHOR = "choice"


def sentence(result: Result) -> str:
    """HTML of the sentence at the head of the page; nothing where no picture was left out."""
    if result.held_out is None:
        return ""
    said = result.held_out.in_words().replace(" %", "\N{NO-BREAK SPACE}%")
    return f'{escape(said[0].upper() + said[1:])}. <a href="#{ANCHOR}">How it was chosen</a>.'


def section(result: Result) -> str:
    """HTML of what was compared; nothing where no picture was left out."""
    held_out = result.held_out
    if held_out is None:
        return ""
    rows = []
    for one in held_out.candidates:
        chosen = one.what == held_out.chosen
        said = f"{one.what} (chosen)" if chosen else one.what
        look: Look = "best" if chosen else "number"
        rows.append((Cell(said), Cell(percent(one.error), look, one.error)))
    nearest = held_out.nearest_picture
    rows.append(
        (Cell("the nearest photograph, shown instead"), Cell(percent(nearest), "number", nearest))
    )
    count = held_out.pictures
    left = f"the {count} left-out pictures" if count > 1 else "the left-out picture"
    text = (
        "Each explanation was fitted to some of the pictures, at some of the pixels; then only the "
        f"light of {left} was fitted. The error is the RMS of what remains, relative to the RMS "
        "of the picture, in the values of its file."
    )
    order = (
        "The best stands first, by a score that also counts the numbers that describe a light. Of "
        "those that are hardly worse the simplest was chosen."
    )
    numbers = table(Table(heads("explanation", "error"), rows))
    return f'{paragraph(text)}<div class="compared">{numbers}</div>{paragraph(order, "note")}'
