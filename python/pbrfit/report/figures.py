"""Figures of a page: a picture that can be enlarged, keys to colours, a grid of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pbrfit.io.color import encode_srgb
from pbrfit.report.html import address, in_base64
from pbrfit.result import differences
from pbrfit.result.differences import PALETTE
from pbrfit.result.drawing import as_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PIXELATED = 300
"""Pictures with a shorter longer side are shown with square pixels, not blurred."""


def picture(content: bytes, size: tuple[int, int], alt: str) -> str:
    """`img` of (height, width) pixels, a file, inside a button that enlarges it."""
    height, width = size
    look = ' class="pixels"' if max(size) < PIXELATED else ""
    text = escape(alt)
    return (
        f'<button type="button" class="zoom" aria-label="Enlarge: {text}">'
        f'<img{look} src="{address(content)}" alt="{text}" width="{width}" height="{height}">'
        "</button>"
    )


def figure(content: str, title: str, remark: str = "") -> str:
    """Pictures (as HTML) with a title and a remark below; both are escaped here."""
    below = f"<br><small>{escape(remark)}</small>" if remark else ""
    return f"<figure>{content}<figcaption><b>{escape(title)}</b>{below}</figcaption></figure>"


def plot(drawing: Figure, alt: str) -> str:
    """A plot of matplotlib's as a picture that stays sharp."""
    drawn = f"data:image/svg+xml;base64,{in_base64(as_svg(drawing).encode())}"
    return f'<figure class="plot"><img src="{drawn}" alt="{escape(alt)}"></figure>'


def grid(figures: Iterable[str], look: str) -> str:
    """Figures (as HTML) side by side as room allows; `look` is a class of the style sheet."""
    return f'<div class="grid {look}">{"".join(figures)}</div>'


def difference_key(what: str, marks: Mapping[str, int], *, degrees: bool = False) -> str:
    """Key to residuals, errors and deviations; `marks` are entries of the palette by label.

    With `degrees` that of angles between normals.
    """
    ticks = differences.tick_places(degrees=degrees)
    patches = {label: css(PALETTE[index]) for label, index in marks.items()}
    return _key(what, palette_stops(), ticks, patches)


def palette_stops() -> str:
    """Colours of residuals, errors and deviations, from 0.001 to 1, as a gradient's stops."""
    return ", ".join(css(PALETTE[i]) for i in np.linspace(0, differences.STEPS - 1, 17).astype(int))


def grey_key(what: str) -> str:
    """Key to maps that are shown as grey."""
    return _key(what, "#000, #fff", {0.0: "0", 0.25: "", 0.5: "0.5", 0.75: "", 1.0: "1"}, {})


def range_key(what: str, ticks: Mapping[float, str]) -> str:
    """Key to a map in `differences.blue_to_yellow`, with labels by their share of the bar."""
    colors = differences.blue_to_yellow(np.linspace(0, 1, 17))
    return _key(what, ", ".join(map(css, colors)), ticks, {})


def _key(what: str, stops: str, ticks: Mapping[float, str], patches: Mapping[str, str]) -> str:
    # Labels at the ends of the bar do not stick out of it.
    ends = {0.0: ' class="first"', 1.0: ' class="last"'}
    marks = "".join(f'<i style="{_place(share)}"></i>' for share in ticks) + "".join(
        f'<span{ends.get(share, "")} style="{_place(share)}">{escape(label)}</span>'
        for share, label in ticks.items()
        if label
    )
    beside = "".join(
        f'<span class="mark"><span class="patch" style="background:{color}"></span> '
        f"{escape(label)}</span>"
        for label, color in patches.items()
    )
    return (
        f'<div class="key"><div class="scale"><span class="what">{escape(what)}</span>'
        f'<div class="bar" style="background:linear-gradient(90deg, {stops})"></div>'
        f'<div class="ticks">{marks}</div></div>{beside}</div>'
    )


def _place(share: float) -> str:
    return f"left:{100 * share:.4g}%"


def css(color: np.ndarray) -> str:
    """A colour (3,), sRGB in [0, 1], for a style sheet."""
    red, green, blue = np.rint(255 * color).astype(int).tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"


def css_of_light(color: ArrayLike) -> str:
    """A colour (3,), linear in [0, 1], for a style sheet."""
    return css(encode_srgb(color))
