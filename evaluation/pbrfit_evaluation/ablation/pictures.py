"""Sheets that show what priors do to the maps, after Figure 2 of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.materials import Materials
from pbrfit.model.reflection import chosen_model, render
from pbrfit.result import metrics
from pbrfit.result.result import Result
from pbrfit.result.sheet import Panel, Row, as_png, displayed, outside_grey, sheet
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.real.held_out import Split
from pbrfit_evaluation.real.pictures import masked, used_part


def room_sheet(scene: Scene, fitted: Mapping[str, Result]) -> bytes:
    """PNG: a picture of a scene with ground truth; its maps and those of each result, relit.

    Relit pictures have the first held-out light.
    """
    truth = scene.truth
    assert truth is not None
    assert truth.relight_lighting is not None
    light = truth.relight_lighting[0]
    found = {"true": truth.materials} | {name: fit.materials for name, fit in fitted.items()}
    models = {"true": chosen_model(None, scene.model)}
    models |= {name: fit.model for name, fit in fitted.items()}
    relit = {
        name: render(maps, scene.normals, light, scene.fov, model=models[name])
        for name, maps in found.items()
    }
    white = metrics.white_of(relit["true"])
    rows: list[Row] = []
    for name, materials in found.items():
        relit_panel = Panel(f"relit, {name}", displayed(relit[name], white))
        rows.append([None, *_maps(materials, name), relit_panel])
    picture = masked(scene, 0)
    rows[0][0] = Panel("picture, with noise", displayed(picture, metrics.white_of(picture)))
    return as_png(sheet(rows))


def real_sheet(
    scene: Scene, which: Split, found: Mapping[str, tuple[Materials, NDArray[np.float64]]]
) -> bytes:
    """PNG: a row for each of `found`: its maps, and a held-out picture as explained by them.

    The first column shows a kept picture and the first of the held-out pictures as they are.

    Parameters
    ----------
    scene
        All pictures.
    which
        Those that were kept.
    found
        Maps, and (H, W, 3) the first held-out picture as they explain it, by what to call them.
    """
    used = used_part(scene)
    kept, held_out = masked(scene, which.kept[0]), masked(scene, which.held_out[0])
    white = metrics.white_of(held_out)
    originals = [
        Panel("kept picture", displayed(kept[used], metrics.white_of(kept))),
        Panel("held-out picture", displayed(held_out[used], white)),
    ]
    rows: list[Row] = []
    for name, (materials, relit) in found.items():
        original = originals[len(rows)] if len(rows) < len(originals) else None
        explained = Panel(f"relit, {name}", displayed(relit[used], white))
        rows.append([original, *_maps(materials, name, used), explained])
    return as_png(sheet(rows))


def _maps(
    materials: Materials, name: str, used: tuple[slice, slice] = (slice(None), slice(None))
) -> list[Panel]:
    grey: dict[str, NDArray[np.floating[Any]]] = {
        "roughness": materials.roughness,
        "metallic": materials.metallic,
    }
    return [
        Panel(f"albedo, {name}", displayed(materials.albedo[used])),
        *(Panel(f"{map_name}, {name}", outside_grey(grey[map_name][used])) for map_name in grey),
    ]
