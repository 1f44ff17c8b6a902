"""What the report shows of a way to explain photographs: a line of panels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import positions
from pbrfit.result import metrics
from pbrfit.result.sheet import OUTSIDE, displayed, outside_grey
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.panels import packed
from pbrfit_evaluation.photographs.explanations import Explained
from pbrfit_evaluation.photographs.pictures import Photographs
from pbrfit_evaluation.real.held_out import Split
from pbrfit_evaluation.real.pictures import ERROR_SPAN, masked, used_part

Array = NDArray[np.float64]

LAMP = np.array([-1.0, 1.0, 1.0]) / np.sqrt(3)
"""Where the light comes from that relief is drawn in."""

ALBEDO_WHITE = 0.98
"""Share of samples that albedo in unknown units is drawn below white at."""


def kept_panels(photographs: Photographs, which: Split, found: Explained) -> dict[str, Any]:
    """Panels by caption, cut to the part with valid pixels, for a record (`panels.packed`)."""
    scene = photographs.scene
    used = used_part(scene)
    true = masked(scene, which.held_out[0])[used]
    white = metrics.white_of(true)
    relit = found.held_out[0][used]
    shown = {
        "photograph": displayed(true, white),
        "relit": displayed(relit, white),
        "error": outside_grey(np.abs(relit - true).mean(axis=-1) / (ERROR_SPAN * white)),
    }
    if photographs.normals is not None:
        shown["true normals"] = as_colors(photographs.normals)[used]
        shown["true height"] = height(photographs.normals, scene)[used]
    if found.normals is not None:
        shown["normals"] = as_colors(found.normals)[used]
        shown["height"] = height(found.normals, scene)[used]
    if found.albedo is not None:
        known = found.roughness is not None
        level = 1.0 if known else float(np.nanquantile(found.albedo, ALBEDO_WHITE))
        shown["albedo"] = displayed(found.albedo[used], level)
    if found.roughness is not None:
        shown["roughness"] = outside_grey(found.roughness[used])
    if found.metallic is not None:
        shown["metallic"] = outside_grey(found.metallic[used])
    return packed(shown)


def as_colors(normals: Array) -> Array:
    """Unit normals (H, W, 3) as red, green, blue from -1 to 1; grey where unknown."""
    return np.asarray(outside_grey((normals + 1) / 2))


def height(normals: Array, scene: Scene) -> Array:
    """(H, W, 3): the surface of these normals as relief; the higher the brighter, under a lamp."""
    valid = scene.valid & np.isfinite(normals).all(axis=-1)
    depth = np.asarray(
        depth_from_normals(np.where(valid[..., None], normals, np.nan), scene.fov, valid),
        np.float64,
    )
    if not np.isfinite(depth[valid]).any():
        return np.full((*valid.shape, 3), OUTSIDE)
    low, high = np.nanquantile(-depth[valid], [0.01, 0.99])
    level = np.clip((-depth - low) / max(high - low, 1e-12), 0.0, 1.0)
    points = positions(np.where(valid, depth, np.nan), scene.fov)
    across = np.cross(np.gradient(points, axis=1), -np.gradient(points, axis=0))
    length = np.linalg.norm(across, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        shading = np.maximum(across @ LAMP / length, 0.0)
    shading = np.where(np.isfinite(shading), shading, LAMP[2])  # at the outline
    drawn = (0.25 + 0.75 * level) * (0.35 + 0.65 * shading)
    return np.asarray(outside_grey(np.where(valid, drawn, np.nan)))
