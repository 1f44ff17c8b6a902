"""Scenes with wrong normals of a chosen size, true ones turned; fitted with and without refinement.

Part "rooms" has noise. Part "exact" has none, and everything should come back.

Every normal is turned by a vector ω, axis times angle. A size θ, in degrees, means:

correlated
    ω is a Gaussian random field over `PATCH` of the width and, with `BIAS_SHARE` of its variance, a
    bias that varies smoothly over `WHOLE` of the width. The root mean square over the picture of
    each of its three components is θ. A turn about the normal itself changes nothing, so the mean
    angle is that of two components, √(π/2) θ = 1.25 θ.
biased
    One ω of length θ for the whole picture, about an axis that is drawn evenly from all.
estimator
    The errors of a learned estimator (`estimator_errors`): outlines that are washed out, whole
    objects turned, patches. All of it is made as much stronger or weaker as it takes for a mean
    angle of 1.25 θ, that of a correlated disturbance.

At the end normals that would face away from the camera are bent until they do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator

from pbrfit._core import InputError
from pbrfit.model.geometry import angles_between
from pbrfit.result.refinement import CHOICES
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Mask, filled
from pbrfit_evaluation.estimator_errors import (
    PATCH,
    WHOLE,
    angle_errors,
    as_estimated,
    facing,
    smooth,
    turned,
)
from pbrfit_evaluation.grid import NOISE, Case, Grid, measured
from pbrfit_evaluation.recipes import Way
from pbrfit_evaluation.scores import MAPS
from pbrfit_evaluation.suite import Options

DISTURBANCES = ("correlated", "biased", "estimator")

BIAS_SHARE = 0.25

MEAN_OF_THETA = float(np.sqrt(np.pi / 2))
"""Mean angle by θ of a correlated disturbance, as long as angles are small."""

STRONGEST = 64.0
"""Times the errors of the estimator as it is."""


def disturbed(scene: Scene, kind: str, degrees: float, seed: int) -> Array:
    """Wrong normals (H, W, 3) for a scene whose normals are true; NaN outside the mask.

    By a disturbance and its θ in degrees, of which 0 gives the normals back as they are. The same
    seed gives the same pattern at every θ.
    """
    if not degrees:
        return np.asarray(scene.normals, dtype=np.float64)
    # A stream of its own, apart from those of the scene and of the table's estimator.
    rng = np.random.default_rng([seed, 2, DISTURBANCES.index(kind)])
    valid, views = scene.valid, filled(scene.views, scene.valid)
    normals = filled(scene.normals, valid)
    match kind:
        case "correlated":
            found = facing(turned(normals, _correlated(valid, degrees, rng)), views)
        case "biased":
            axis = rng.normal(size=3)
            omega = np.broadcast_to(degrees * axis / np.linalg.norm(axis), normals.shape)
            found = facing(turned(normals, omega), views)
        case _:
            found = _estimated(scene, normals, views, degrees, int(rng.integers(2**32)))
    return np.where(valid[..., None], found, np.nan)


def _correlated(valid: Mask, degrees: float, rng: Generator) -> Array:
    omega = np.empty((*valid.shape, 3))
    for i in range(3):
        patch, whole = (smooth(valid.shape, scale, rng) for scale in (PATCH, WHOLE))
        field = np.sqrt(1 - BIAS_SHARE) * patch + np.sqrt(BIAS_SHARE) * whole
        # One picture shows few patches, whose mean square is not that of all pictures.
        omega[..., i] = field * (degrees / np.sqrt(np.mean(field[valid] ** 2)))
    return omega


def _estimated(scene: Scene, normals: Array, views: Array, degrees: float, seed: int) -> Array:
    from scipy.optimize import brentq

    valid, aim = scene.valid, MEAN_OF_THETA * degrees
    segments = np.zeros(valid.shape, int) if scene.segments is None else scene.segments

    def by(strength: float) -> Array:
        rng = np.random.default_rng(seed)  # the same errors at any strength
        return as_estimated(normals, views, segments, rng, strength=strength)

    def above(strength: float) -> float:
        return float(angles_between(by(strength), normals)[valid].mean()) - aim

    high = 1.0
    while above(high) < 0 and high < STRONGEST:
        high *= 2
    return by(float(brentq(above, 0.0, high, xtol=1e-3)))


REFINE: Mapping[str, Way] = {
    choice: Way(words, {"refine_normals": choice})
    for choice, words in zip(
        CHOICES,
        ("not refined", "refined where it is decided to (auto)", "refined (on)"),
        strict=True,
    )
}
"""Fits of a scene: "off", with which the others are compared, "auto" and "on"."""

KINDS = ("furnished", "furnished", "furnished", "detailed")
"""One scene in four has textures on everything."""

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
    scene = given = case.drawn(noise=NOISE if noisy else 0.0)
    if case.condition != TRUE:
        given = replace(scene, normals=disturbed(scene, *turn_of(case.condition), case.seed))
    result, found = measured(case, REFINE[case.way], given, threads, truth=scene)
    for name, of in (("given", given), ("angle", result)):
        found[name] = angle_errors(of.normals[scene.valid], scene.normals[scene.valid])
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


LARGEST = 45.0
"""Degrees of a disturbance, at most."""


def cases(options: Options) -> list[Case]:
    """Scenes under every disturbance that is asked for; InputError if a size makes no sense."""
    for theta in options.degrees:
        if not 0 < theta <= LARGEST:
            expected = f"expected more than 0 and at most {LARGEST:g}"
            raise InputError(f"--degrees: {expected}, found {theta:g}")
    return grid_of(options).cases(options)
