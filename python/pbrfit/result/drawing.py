"""What all plots share: colours, a figure, a PNG or an SVG."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by all common colour vision; and a grey.
BLACK, BLUE, SKY, GREEN = "#000000", "#0072B2", "#56B4E9", "#009E73"
ORANGE, AMBER, PURPLE = "#D55E00", "#E69F00", "#CC79A7"
GREY = "#777777"


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure; width and height in inches."""
    # Imported here: matplotlib is slow to start and needed for plots alone.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def as_png(figure: Figure, dpi: int) -> bytes:
    """Draw it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def as_svg(figure: Figure) -> str:
    """Draw it, with letters as outlines, so that it looks the same everywhere."""
    import matplotlib as mpl

    buffer = io.StringIO()
    # Without a date and with names that do not vary, the same figure is the same text.
    with mpl.rc_context({"svg.hashsalt": "pbrfit", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
