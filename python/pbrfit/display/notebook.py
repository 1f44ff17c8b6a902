"""What a notebook shows: facts in lines, and small pictures side by side, as HTML.

It needs no network and no script.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import numpy as np
from PIL import Image

from pbrfit.display.tone import codes, encoded
from pbrfit.io.images import encode_png
from pbrfit.values.arrays import Floats, Mask

SIDE = 128
"""Longer side of a scene's picture in pixels."""

PICTURES_MAX = 24
"""Pictures that are shown: three rows in a notebook."""


def pictures(images: Floats, names: Sequence[str], valid: Mask, facts: Sequence[str]) -> str:
    """Facts, and pictures (N, H, W, 3), linear, which are clear where they are not valid."""
    # Every few rows and columns are enough for twice the size, which is then averaged down.
    step = -(-max(valid.shape) // (2 * SIDE))
    few = np.array(images[:PICTURES_MAX, ::step, ::step])
    few[:, ~valid[::step, ::step]] = np.nan
    white = float(np.nanpercentile(few, 98)) if np.isfinite(few).any() else 0.0
    shown = encoded(few / (white if white > 0 else 1.0))
    figures = [figure(name, one, SIDE, name) for name, one in zip(names, shown, strict=False)]
    more = [f"{len(names) - len(few)} more pictures"] * (len(names) > len(few))
    return page([*facts, *more], figures)


def page(facts: Sequence[str], figures: Sequence[str], below: str = "") -> str:
    """Facts a line each, figures, and more HTML; letters have the notebook's own colour."""
    return (
        '<div style="font:13px/1.5 system-ui,sans-serif;color:inherit;background:none">'
        + "".join(f"<div>{escape(fact)}</div>" for fact in facts)
        + f'<div style="display:flex;flex-wrap:wrap;gap:12px;margin:8px 0">{"".join(figures)}</div>'
        + f"{below}</div>"
    )


def figure(name: str, values: Floats, side: int, caption: str) -> str:
    """Values in [0, 1], (H, W, 1 or 3), clear where NaN, above a caption."""
    small = Image.fromarray(codes(np.broadcast_to(values, (*values.shape[:2], 3))))
    small.thumbnail((side, side), Image.Resampling.BOX)
    png = base64.b64encode(encode_png(np.asarray(small), "srgb")).decode("ascii")
    style = "width:100%;image-rendering:pixelated;outline:1px solid #8886"  # an edge around black
    return (
        f'<figure style="margin:0;width:{side}px"><img alt="{escape(name)}" '
        f'src="data:image/png;base64,{png}" style="{style}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
