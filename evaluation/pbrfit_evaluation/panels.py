"""Panels of a report that records keep: pictures of one size side by side, as one PNG."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from PIL import Image

from pbrfit.io.images import encode_png
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result
from pbrfit.result.sheet import Panel, Row, displayed, outside_grey, sheet
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Floats, known


def of_maps(of: Materials, before: str = "") -> dict[str, Floats]:
    """Albedo, roughness and metallic for the screen, by name with something before it."""
    return {
        f"{before}albedo": displayed(of.albedo),
        f"{before}roughness": outside_grey(of.roughness),
        f"{before}metallic": outside_grey(of.metallic),
    }


def of_result(
    result: Result, scene: Scene, threads: int, *, scaled: bool = False
) -> dict[str, Floats]:
    """Maps that were found and true ones, and the first held-out picture, relit and as it is.

    Beside them the first of the given pictures. `scaled`: albedo and light after the best factor a
    channel, as exposures of the pictures are not known.
    """
    truth = known(scene.truth)
    valid = scene.valid[..., None]
    materials = result.materials
    if scaled:
        albedo = metrics.scaled_per_channel(materials.albedo, truth.materials.albedo)
        materials = replace(materials, albedo=albedo)
    first = np.where(valid, scene.images[0], np.nan)
    panels = {"picture": displayed(first, metrics.white_of(first))}
    panels |= of_maps(materials) | of_maps(truth.materials, "true ")
    if truth.relight_images is not None and truth.relight_lighting is not None:
        true = np.where(valid, truth.relight_images[0], np.nan)
        relit = np.where(valid, relight(result, truth.relight_lighting[:1], threads)[0], np.nan)
        relit = metrics.scaled_per_channel(relit, true) if scaled else relit
        white = metrics.white_of(true)
        panels |= {"relit": displayed(relit, white), "true relit": displayed(true, white)}
    return panels


def packed(panels: Mapping[str, Floats]) -> dict[str, Any]:
    """(H, W, 3) values in [0, 1] by name, for JSON; `unpacked` undoes it, to 8 bits."""
    side_by_side = np.concatenate([np.clip(of, 0, 1) for of in panels.values()], axis=1)
    png = encode_png((255 * side_by_side + 0.5).astype(np.uint8), "srgb")
    return {"names": list(panels), "png": base64.b64encode(png).decode("ascii")}


def unpacked(kept: Mapping[str, Any]) -> dict[str, Array]:
    """(H, W, 3) values in [0, 1] by name."""
    with Image.open(io.BytesIO(base64.b64decode(kept["png"]))) as image:
        pixels = np.asarray(image.convert("RGB")) / 255
    return dict(zip(kept["names"], np.split(pixels, len(kept["names"]), axis=1), strict=True))


def in_lines(kept: Mapping[str, Mapping[str, Floats]]) -> bytes:
    """PNG of panels by label and name, a line each label; names stand where they are new."""
    told: set[str] = set()
    grid: list[Row] = []
    for panels in kept.values():
        grid.append([Panel("" if name in told else name, of) for name, of in panels.items()])
        told |= panels.keys()
    return encode_png(sheet(grid, labels=list(kept)), "srgb")


def beside_truth(kept: Mapping[str, Mapping[str, Floats]]) -> bytes:
    """PNG of panels by label, below the picture and the true ones, which are called "true NAME"."""
    first = next(iter(kept.values()))
    true = {name.removeprefix("true "): of for name, of in first.items() if "true " in name}
    shown = {"truth": true | {"picture": first["picture"]}}
    for label, panels in kept.items():
        shown[label] = {
            name: of for name, of in panels.items() if name != "picture" and "true " not in name
        }
    return in_lines(shown)
