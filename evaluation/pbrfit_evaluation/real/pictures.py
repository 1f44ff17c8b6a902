"""A sheet of pictures a source: maps, a held-out picture, its explanations and errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.result import metrics
from pbrfit.result.sheet import Panel, Row, as_png, displayed, outside_grey, sheet
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.real.held_out import EXPLANATIONS, Explained, Explanation, Split

ERROR_SPAN = 0.2
"""Error, as a share of white, that is drawn white."""

CAPTIONS: dict[Explanation, str] = {
    "default": "by our default",
    "plain": "by ours without priors",
    "paper": "by the paper's recipe",
    "lambertian": "by albedo alone (r = 1)",
    "start": "by our start",
    "constant": "by a constant guess",
    "combination": "as sum of kept pictures",
}


def draw_sheet(scene: Scene, which: Split, explained: Sequence[Explained]) -> bytes:
    """PNG: maps of the default; a held-out picture, its explanations and their errors."""
    by_name = {one.explanation: one for one in explained}
    maps = by_name["default"].materials
    assert maps is not None
    kept, held_out = which.kept[0], which.held_out[0]
    true = masked(scene, held_out)
    white = metrics.white_of(true)
    of_kept = masked(scene, kept)
    shown: list[Explanation] = [name for name in EXPLANATIONS if name != "start"]
    used = used_part(scene)

    def panel(caption: str, pixels: NDArray[np.floating[Any]]) -> Panel:
        return Panel(caption, pixels[used])

    first: Row = [
        panel(f"kept picture {scene.names[kept]}", displayed(of_kept, metrics.white_of(of_kept))),
        panel("albedo", displayed(maps.albedo, 1.0)),
        panel("roughness, white = 1", outside_grey(maps.roughness)),
        panel("metallic, white = 1", outside_grey(maps.metallic)),
        panel("normals, as given", outside_grey(0.5 + 0.5 * scene.normals)),
    ]
    second: Row = [panel(f"held out: {scene.names[held_out]}", displayed(true, white))]
    third: Row = [None]
    for name in shown:
        found = by_name[name].rendered[0]
        second.append(panel(CAPTIONS[name], displayed(found, white)))
        error = np.abs(found - true).mean(axis=-1) / white
        third.append(panel(f"|error|, white = {ERROR_SPAN:g}", outside_grey(error / ERROR_SPAN)))
    return as_png(sheet([first, second, third]))


def used_part(scene: Scene) -> tuple[slice, slice]:
    """Rows and columns of the smallest rectangle that holds all valid pixels."""
    rows, columns = (np.flatnonzero(scene.valid.any(axis=axis)) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def masked(scene: Scene, picture: int) -> NDArray[np.float64]:
    """A picture, NaN where it is not used."""
    used = scene.valid.copy()
    if scene.weights is not None:
        used &= scene.weights[picture] > 0
    return np.where(used[..., None], scene.images[picture].astype(np.float64), np.nan)
