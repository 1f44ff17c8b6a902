"""One scene under one disturbance, fitted with or without refinement.

Part "rooms" has noise. Part "exact" has none, and everything should come back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.refinement import CHOICES
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.grid import Case, Grid, measured
from pbrfit_evaluation.normal_errors import Floats, angle_errors
from pbrfit_evaluation.normals.disturbances import DISTURBANCES, disturbed
from pbrfit_evaluation.recipes import Way
from pbrfit_evaluation.suite import Options

REFINE: Mapping[str, Way] = {
    choice: Way(words, {"refine_normals": choice})
    for choice, words in zip(
        CHOICES,
        ("not refined", "refined where it is decided to (auto)", "refined (on)"),
        strict=True,
    )
}
"""Fits of a scene: "off", with which the others are compared, "auto" and "on"."""

NOISE = 0.01
"""In radiance: 1 % of a radiance of 1, 2.5 % of the mean."""

KINDS = ("furnished", "furnished", "furnished", "detailed")
"""One scene in four has textures on everything."""

MAPS = ("albedo", "roughness", "metallic")

MATERIAL, ANGLE = 1e-2, 0.3
"""Largest RMSE of a map, and largest mean angle in degrees, of a scene that came back."""

PARTS = ("rooms", "exact")

TRUE = "true"
"""Condition of a scene with true normals."""

EXACT = ("correlated", "biased")
EXACT_DEGREES = 10.0
"""Disturbances without noise, and their θ."""


def grid_of(options: Options) -> Grid:
    """Every disturbance by every θ that is asked for, and true normals; some without noise."""
    found = {}
    if "rooms" in options.part:
        found[TRUE] = "true normals"
        for kind in DISTURBANCES:
            for theta in sorted(set(options.degrees)) if kind in options.disturbances else ():
                found[f"{kind}-{theta:g}"] = f"{kind} {theta:g}°"
    exact = [kind for kind in EXACT if kind in options.disturbances and "exact" in options.part]
    titles = {f"exact-{kind}": f"no noise, {kind} {EXACT_DEGREES:g}°" for kind in exact}
    on_alone = {condition: ["on"] for condition in titles}
    return Grid(found | titles, REFINE, of_condition=on_alone, kinds=KINDS)


def is_exact(condition: str) -> bool:
    """Whether its scenes have no noise."""
    return condition.startswith("exact-")


def turn_of(condition: str) -> tuple[str, float]:
    """Disturbance and θ of a condition."""
    kind, _, degrees = condition.removeprefix("exact-").partition("-")
    return kind, float(degrees or (EXACT_DEGREES if kind != TRUE else 0.0))


def run(case: Case, threads: int) -> dict[str, Any]:
    """Scores, angles and decision of a fit; without noise, whether the scene came back."""
    noisy = not is_exact(case.condition)
    scene = given = make_scene(
        case.kind,
        size=case.size,
        lights=case.lights,
        held_out=case.lights,
        seed=case.seed,
        noise=NOISE if noisy else 0.0,
    )
    if case.condition != TRUE:
        given = replace(scene, normals=disturbed(scene, *turn_of(case.condition), case.seed))
    result, found = measured(case, REFINE[case.way], given, threads, truth=scene)
    found["given"] = off(given.normals, scene.normals, scene.valid)
    found["angle"] = off(result.normals, scene.normals, scene.valid)
    found["decision"] = {
        "refined": result.refinement.refined,
        "why": result.refinement.why,
        "figures": dict(result.refinement.figures),
    }
    if not noisy:
        found["came_back"] = came_back(found)
    return found


def came_back(values: dict[str, Any]) -> bool:
    """Whether materials and normals of a scene are what they were."""
    maps = max(values["scores"][name] for name in MAPS)
    return bool(maps <= MATERIAL and values["angle"]["mean"] <= ANGLE)


def off(found: Floats, true: Floats, valid: NDArray[np.bool_]) -> dict[str, float]:
    """Angles between normals (H, W, 3) and the true ones over valid pixels, in degrees."""
    return angle_errors(found[valid], true[valid])
