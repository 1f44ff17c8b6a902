"""A sheet a source: the maps of every explanation, and a held-out picture as explained by them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pbrfit.result import metrics
from pbrfit.result.sheet import Panel, Row, as_png, displayed, outside_grey, sheet
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.real.held_out import IN_WORDS, Explained, Split

ERROR_SPAN = 0.2
"""Error, as a share of white, that is drawn white."""


def draw_sheet(scene: Scene, which: Split, explained: Sequence[Explained]) -> bytes:
    """PNG: the first held-out picture as it is; below a row an explanation."""
    used = used_part(scene)
    true = masked(scene, which.held_out[0])[used]
    white = metrics.white_of(true)
    rows: list[Row] = [[None] * 3 + [Panel("held-out picture", displayed(true, white))]]
    for one in explained:
        row: Row = [None] * 3
        if one.materials is not None:
            row = [
                Panel("albedo", displayed(one.materials.albedo[used], 1.0)),
                Panel("roughness, white = 1", outside_grey(one.materials.roughness[used])),
                Panel("metallic, white = 1", outside_grey(one.materials.metallic[used])),
            ]
        found = one.rendered[0][used]
        error = np.abs(found - true).mean(axis=-1) / white
        row.append(Panel("explained", displayed(found, white)))
        row.append(Panel(f"|error|, white = {ERROR_SPAN:g}", outside_grey(error / ERROR_SPAN)))
        rows.append(row)
    return as_png(sheet(rows, labels=["", *(IN_WORDS[one.explanation] for one in explained)]))


def used_part(scene: Scene) -> tuple[slice, slice]:
    """Rows and columns of the smallest rectangle that holds all valid pixels."""
    rows, columns = (np.flatnonzero(scene.valid.any(axis=axis)) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def masked(scene: Scene, picture: int) -> NDArray[np.float64]:
    """A picture, NaN where it is not used."""
    used, weights = scene.valid, scene.channel_weights(picture)
    if weights is not None:
        used = used & (weights > 0).all(axis=-1)
    return np.where(used[..., None], scene.images[picture].astype(np.float64), np.nan)
