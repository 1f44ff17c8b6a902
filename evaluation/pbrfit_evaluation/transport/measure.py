"""One room by Cycles, and what a fit is given of its geometry and lamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import angles_between, positions, unit
from pbrfit.model.lamps import Lamps
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import cycles
from pbrfit_evaluation.estimator_errors import ROUGH, estimated_depth
from pbrfit_evaluation.grid import Case, Grid, measured
from pbrfit_evaluation.recipes import GUESS, Way
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.table1.measure import ROWS as TABLE1

Depth = Literal["none", "true", "network", "rough", "integrated"]
"""The true one; with the errors of a network, or of something worse; integrated from normals."""


@dataclass(frozen=True)
class Variant(Way):
    """A way to explain a room, with what the fit is given."""

    depth: Depth = "none"
    """As it is called above."""
    segments: bool = True
    """Whether it is given the true ones."""
    lamps: bool = False
    """Whether it is given the true ones."""


CONSTANT = Variant(**vars(GUESS))


def _among(words: str, depth: Depth, *, segments: bool = True) -> Variant:
    return Variant(words, {"transport": "auto"}, depth=depth, segments=segments)


OF_GEOMETRY: Mapping[str, Variant] = {
    "constant": CONSTANT,
    "default": Variant("default model, no depth", {"model": None}),
    "without": Variant("no depth"),
    "true": _among("true depth", "true"),
    "network": _among("depth of a network", "network"),
    "rough": _among("rough depth", "rough"),
    "integrated": _among("integrated normals", "integrated"),
    "unsegmented": _among("true depth, no segments", "true", segments=False),
}


def _lit(words: str, light: str, depth: Depth = "none", *, lamps: bool = False) -> Variant:
    return Variant(words, {"light": light}, depth=depth, lamps=lamps)


OF_LAMPS: Mapping[str, Variant] = {
    "constant": CONSTANT,
    "sh": _lit("environment light, no depth", "sh"),
    "sh-depth": _lit("environment light, depth", "sh", "true"),
    "lamps": _lit("lamps, no depth", "lamps"),
    "lamps-depth": _lit("lamps, depth", "lamps", "true"),
    "auto": _lit("auto, no depth", "auto"),
    "auto-depth": _lit("auto, depth", "auto", "true"),
    "known": _lit("known lamps, depth", "lamps", "true", lamps=True),
}

VARIANTS = {**OF_GEOMETRY, **OF_LAMPS}

ROWS: Mapping[str, tuple[str, str]] = {
    "brdf": ("cycles-brdf", "BRDF alone"),
    "shadows": ("cycles-shadows", "and shadows"),
    "bounces": ("cycles-panorama", "all bounces"),
    "detailed": ("cycles-detailed", "all bounces, detailed"),
    "points-shadows": ("cycles-points", "Point lamps with shadows"),
    "points": ("cycles-points-unshadowed", "Point lamps without shadows"),
}
"""Rows of Table 1 that rooms of a setup are rendered as, and what the setups are called."""


def _why_not(*_: object) -> str:
    return cycles.why_not() or ""


GEOMETRY = Grid(
    {setup: ROWS[setup][1] for setup in ("brdf", "shadows", "bounces", "detailed")},
    OF_GEOMETRY,
    pictured=("without", "true"),
    few=("shadows",),
    few_ways=("constant", "without", "true"),
    why_not=_why_not,
)
LAMPS = Grid(
    {setup: ROWS[setup][1] for setup in ("points-shadows", "points")},
    OF_LAMPS,
    pictured=tuple(OF_LAMPS),
    few_ways=("constant", "sh", "lamps-depth"),
    why_not=_why_not,
)


def run(case: Case, threads: int) -> dict[str, Any]:
    """Errors, how far lamps are off, what was chosen, and perhaps maps.

    Cycles renders the principled model, which is fitted unless a variant says otherwise.
    """
    exact, lamps = room(case, threads)
    variant = VARIANTS[case.way]
    scene = told(exact, variant, case.seed)
    if variant.lamps:
        scene = replace(scene, lamps=lamps)
    result, found = measured(case, variant, scene, threads, model="principled")
    return {
        **found,
        "lamps": {} if lamps is None else lamps_off(result.lamps, lamps, exact),
        "choice": result.transport.kind,
    }


def room(case: Case, threads: int) -> tuple[Scene, Lamps | None]:
    """Render the room, which has its true depth in metres; and its lamps, where it has some."""
    row = TABLE1[ROWS[case.condition][0]]
    lamps = table1.cycles_lamps(case, row) if row.light == "points" else None
    return table1.cycles_scene(case, row, threads), lamps


def lamps_off(found: Lamps | None, true: Lamps, scene: Scene) -> dict[str, float]:
    """How far lamps are off, one a picture, in a scene whose depth is in metres.

    Medians over them of `cm`, the distance between found and true, for near ones, and of `degrees`,
    the angle between these as seen from the middle of the scene; the share that is `near`. Without
    any, nothing.
    """
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


def told(exact: Scene, variant: Variant, seed: int) -> Scene:
    """What a fit is told of a room."""
    true = exact.depth
    assert true is not None
    segments = exact.segments if variant.segments else None
    depth: NDArray[Any] | None = None
    match variant.depth:
        case "true":
            depth = true
        case "network":
            depth = estimated_depth(true, seed)
        case "rough":
            depth = estimated_depth(true, seed, noise=ROUGH)
        case "integrated":
            depth = depth_from_normals(exact.normals, exact.fov, segments=segments)
    return replace(exact, segments=segments, depth=depth)
