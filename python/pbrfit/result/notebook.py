"""A result as a notebook shows it: what it explains, small maps, verdicts, what to do next."""

from __future__ import annotations

import base64
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.io.images import encode_png
from pbrfit.result import metrics
from pbrfit.result.advice import next_steps
from pbrfit.result.data import ResultData
from pbrfit.result.verdict import MARKS, in_short

SIDE = 176
"""Longer side of a map in pixels: four of them stand side by side in a notebook."""

STYLE = "font:13px/1.5 system-ui,sans-serif;color:inherit;background:none"
"""Letters have the notebook's own colour, on its own paper, dark or light."""

PICTURE = "width:100%;image-rendering:pixelated;outline:1px solid #8886"
"""An edge that shows on both, around black maps on dark paper."""


def html(result: ResultData) -> str:
    """A piece of HTML with everything in it; it needs no network and no script."""
    height, width = result.mask.shape
    facts = [
        f"{len(result.pictures)} pictures of {width} × {height}",
        f"model {result.model}",
        f"{str(result.status).replace('_', ' ')}, {result.seconds:.3g} s",
    ]
    if "recon_rmse" in result.metrics:
        facts.append(f"residual {result.metrics['recon_rmse']:.2g}")
    maps = {
        "albedo": metrics.display(result.albedo, 1.0),
        "roughness": result.roughness,
        "metallic": result.metallic,
        "normals": 0.5 + 0.5 * result.normals,
    }
    figures = []
    for name, values in maps.items():
        caption = escape(name)
        if name in result.verdicts:
            mark = MARKS[result.verdicts[name].level]
            color = f"rgb({','.join(map(str, mark.ink))})"
            said = escape(in_short(name, result.verdicts[name]))
            caption = f'<span style="color:{color}">{mark.sign}</span> {said}'
        figures.append(
            f'<figure style="margin:0;width:{SIDE}px"><img alt="{escape(name)}" '
            f'src="{_inline(values)}" style="{PICTURE}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    explains = "" if result.held_out is None else result.held_out.in_words()
    steps = "".join(f"<li>{escape(step)}</li>" for step in next_steps(result))
    return (
        f'<div style="{STYLE}"><div>{escape("; ".join(facts))}</div>'
        + (f"<div>{escape(explains)}</div>" if explains else "")
        + f'<div style="display:flex;flex-wrap:wrap;gap:12px;margin:8px 0">{"".join(figures)}</div>'
        + (f"<div>What to do next:</div><ul>{steps}</ul>" if steps else "")
        + "</div>"
    )


def _inline(values: NDArray[Any]) -> str:
    """A map in [0, 1], (H, W) or (H, W, 3), as a small PNG in a URL; transparent where NaN."""
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=-1)
    inside = np.isfinite(values).all(axis=-1)
    codes = np.zeros((*inside.shape, 4), np.uint8)
    codes[inside, :3] = np.rint(255 * np.clip(values[inside], 0, 1))
    codes[..., 3] = np.where(inside, 255, 0)
    small = Image.fromarray(codes)
    small.thumbnail((SIDE, SIDE), Image.Resampling.BOX)
    encoded = base64.b64encode(encode_png(np.asarray(small), "srgb")).decode("ascii")
    return f"data:image/png;base64,{encoded}"
