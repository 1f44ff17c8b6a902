"""One scene under one disturbance, fitted with and without refinement.

Part "rooms" has noise. Part "exact" has none, and everything should come back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.decompose import decompose
from pbrfit.model.geometry import angles_between
from pbrfit.result.refinement import CHOICES
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.normal_errors import Array, Floats, angle_errors
from pbrfit_evaluation.normals.disturbances import Disturbance, disturbed
from pbrfit_evaluation.scores import score

REFINE = CHOICES
"""Fits of a scene: "off", with which the others are compared, "auto" and "on"."""

FIRST_SEED = 7000
"""Nothing was tuned on seeds from there on."""

PICTURES = 16
"""Of a scene, with a mean radiance of 0.4; as many are held out."""

NOISE = 0.01
"""In radiance: 1 % of a radiance of 1, 2.5 % of the mean."""

DETAILED_EVERY = 4
"""One scene in so many has textures on everything; the others are furnished rooms."""

MAPS = ("albedo", "roughness", "metallic")

MATERIAL, ANGLE = 1e-2, 0.3
"""Largest RMSE of a map, and largest mean angle in degrees, of a scene that came back."""

Name = Literal["rooms", "exact"]


@dataclass(frozen=True)
class Case:
    """A scene under one disturbance; "true" in place of one leaves the true normals."""

    part: Name
    scene: str
    seed: int
    size: int
    disturbance: Disturbance | Literal["true"]
    degrees: float
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.part}_{self.disturbance}_{self.degrees:g}_{self.scene}_{self.seed}"

    @property
    def in_words(self) -> str:
        """What normals are given."""
        return f"{self.disturbance} {self.degrees:g}°" if self.degrees else "true normals"


def room_kind(number: int) -> str:
    """Kind of the scene with this number, from 0."""
    return "detailed" if number % DETAILED_EVERY == DETAILED_EVERY - 1 else "furnished"


def run(case: Case, threads: int) -> dict[str, Any]:
    """Scores, angles and decision of each fit; without noise, whether the scene came back."""
    noisy = case.part == "rooms"
    scene = given = make_scene(
        case.scene,
        size=case.size,
        lights=PICTURES,
        held_out=PICTURES,
        seed=case.seed,
        noise=NOISE if noisy else 0.0,
    )
    if case.disturbance != "true":
        normals = disturbed(scene, case.disturbance, case.degrees, case.seed)
        given = replace(scene, normals=normals)
    found: dict[str, Any] = {"given": off(given.normals, scene.normals, scene.valid)}
    for refine in REFINE if noisy else REFINE[-1:]:
        if refine == "on" and noisy and found["auto"]["decision"]["refined"]:
            found[refine] = found["auto"]  # the same fit, but for the time before it
            continue
        result = decompose(
            given, iterations=case.iterations, threads=threads, refine_normals=refine
        )
        found[refine] = {
            "scores": score(result, scene, threads).as_json(),
            "angle": off(result.normals, scene.normals, scene.valid),
            "decision": {
                "refined": result.refinement.refined,
                "why": result.refinement.why,
                "figures": dict(result.refinement.figures),
            },
        }
    if not noisy:
        found["came_back"] = came_back(found["on"])
    return found


def came_back(values: dict[str, Any]) -> bool:
    """Whether materials and normals of a scene are what they were."""
    maps = max(values["scores"][name] for name in MAPS)
    return bool(maps <= MATERIAL and values["angle"]["mean"] <= ANGLE)


def off(found: Floats, true: Floats, valid: NDArray[np.bool_]) -> dict[str, float]:
    """Angles between normals (H, W, 3) and the true ones over valid pixels, in degrees.

    "aligned" is the mean after the turn of all normals together that brings them nearest to the
    true ones. Such a turn is hard to see, because lights can turn along.
    """
    found, true = found[valid], true[valid]
    return angle_errors(found, true) | {"aligned": float(aligned_angles(found, true).mean())}


def aligned_angles(found: Floats, true: Floats) -> Array:
    """Angles of unit vectors (P, 3) after the turn that brings them nearest in least squares.

    With H = Σ f tᵀ = U S Vᵀ it is R = V diag(1, 1, det VUᵀ) Uᵀ (Kabsch 1976). Where several turns
    are as good, such as for vectors that are all equal, it is one of them.
    """
    u, _, vt = np.linalg.svd(np.asarray(found, np.float64).T @ np.asarray(true, np.float64))
    handed = np.array([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    turn = (vt.T * handed) @ u.T
    return angles_between(found @ turn.T, true)
