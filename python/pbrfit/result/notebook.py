"""A result as a notebook shows it: what it explains, small maps, verdicts, what to do next."""

from __future__ import annotations

from html import escape

from pbrfit.display.notebook import figure, page
from pbrfit.display.tone import encoded
from pbrfit.result.advice import next_steps
from pbrfit.result.data import ResultData
from pbrfit.result.verdict import MARKS, in_short

SIDE = 176
"""Longer side of a map in pixels: four of them stand side by side in a notebook."""


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
        "albedo": encoded(result.albedo),
        "roughness": result.roughness,
        "metallic": result.metallic,
        "normals": 0.5 + 0.5 * result.normals,
    }
    figures = []
    for name, values in maps.items():
        caption = name
        if (verdict := result.verdicts.get(name)) is not None:
            caption = f"{MARKS[verdict.level].sign} {in_short(name, verdict)}"
        figures.append(figure(name, values.reshape(height, width, -1), SIDE, caption))
    lines = ["; ".join(facts)]
    if result.held_out is not None:
        lines.append(result.held_out.in_words())
    steps = "".join(f"<li>{escape(step)}</li>" for step in next_steps(result))
    below = f"<div>What to do next:</div><ul>{steps}</ul>" if steps else ""
    return page(lines, figures, below)
