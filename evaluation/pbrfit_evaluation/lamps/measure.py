"""One room under lamps by Cycles, explained in one way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from pbrfit.model.geometry import angles_between, positions
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.result.sheet import displayed, outside_grey
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.explained import Case
from pbrfit_evaluation.lamps.variants import BY_KEY
from pbrfit_evaluation.normal_errors import unit
from pbrfit_evaluation.panels import packed
from pbrfit_evaluation.recipes import explain, fit
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.table1 import measure as table1

ROWS: Mapping[str, str] = {
    "points-shadows": "cycles-points",
    "points": "cycles-points-unshadowed",
}
"""Rows of Table 1 that the rooms are rendered as."""

NAMES: Mapping[str, str] = {
    "points-shadows": "Point lamps with shadows",
    "points": "Point lamps without shadows",
}

FIRST_SEED = 8200
"""Nothing was tuned on seeds from there on."""

MODEL: Literal["principled"] = "principled"
"""The one whose reflection Cycles renders."""


def run(case: Case, threads: int) -> dict[str, Any]:
    """Errors of the maps, how far lamps are off, and perhaps maps.

    Of lamps: medians over them of `cm`, the distance between found and true, for near ones, and of
    `degrees`, the angle between these as seen from the middle of the scene; the share that is
    `near`. Without any, nothing.
    """
    exact, true = room(case, threads)
    variant = BY_KEY[case.variant]
    scene = exact if variant.depth else replace(exact, depth=None)
    if variant.lamps:
        scene = replace(scene, lamps=true)
    if variant.guess:
        result = explain(scene, "constant", model=MODEL, threads=threads)
    else:
        result = fit(scene, threads=threads, model=MODEL, light=variant.light)
    values: dict[str, Any] = {
        "scores": score(result, scene, threads).as_json(),
        "lamps": lamps_off(result.lamps, true, exact),
    }
    if case.picture:
        values["panels"] = maps(result.materials, exact)
    return values


def room(case: Case, threads: int) -> tuple[Scene, Lamps]:
    """Render the room, which has its true depth in metres; and its lamps."""
    of = case.of_table1(ROWS)
    return table1.cycles_scene(*of, threads), table1.cycles_lamps(*of)


def lamps_off(found: Lamps | None, true: Lamps, scene: Scene) -> dict[str, float]:
    """How far lamps are off, one a picture, in a scene whose depth is in metres."""
    if found is None:
        return {}
    assert scene.depth is not None
    middle = positions(scene.depth, scene.fov)[scene.valid].mean(axis=0)
    places = true.places[found.pictures]
    towards = np.where(found.near[:, None], unit(found.places - middle), unit(found.places))
    off = {
        "degrees": float(np.median(angles_between(towards, unit(places - middle)))),
        "near": float(found.near.mean()),
    }
    if found.near.any():
        distances = np.linalg.norm(found.places - places, axis=-1)[found.near]
        off["cm"] = float(100 * np.median(distances))
    return off


def maps(found: Materials, scene: Scene) -> dict[str, Any]:
    """Panels for a record: a picture, the true maps and those that were found."""
    assert scene.truth is not None
    true = scene.truth.materials
    shown = np.where(scene.valid[..., None], scene.images[0], np.nan)
    panels = {"picture": displayed(shown, metrics.white_of(shown))}
    for name, of in (("true ", true), ("", found)):
        panels[f"{name}albedo"] = displayed(of.albedo)
        panels[f"{name}roughness"] = outside_grey(of.roughness)
        panels[f"{name}metallic"] = outside_grey(of.metallic)
    return packed(panels)
