"""What the parts share: scenes, the fit with and without refinement, and what is told of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.decompose import decompose
from pbrfit.model.geometry import angles_between
from pbrfit.result.refinement import CHOICES, RefineNormals
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.normal_errors import Array, Floats

REFINE = CHOICES
"""Fits of a scene: "off", with which the others are compared, "auto" and "on"."""

FIRST_SEED = 7000
"""Nothing was tuned on seeds from there on."""

PICTURES = 16

NOISE = 0.01
"""In radiance: 1 % of a radiance of 1, 2.5 % of the mean."""

DETAILED_EVERY = 4
"""One scene in so many has textures on everything; the others are furnished rooms."""


def room_kind(number: int) -> str:
    """Kind of the scene with this number, from 0."""
    return "detailed" if number % DETAILED_EVERY == DETAILED_EVERY - 1 else "furnished"


def room(kind: str, seed: int, size: int, *, noise: float, held_out: int = PICTURES) -> Scene:
    """Render a scene with true normals: 16 pictures of mean radiance 0.4, as many held out."""
    return make_scene(kind, size=size, lights=PICTURES, held_out=held_out, seed=seed, noise=noise)


def fit(scene: Scene, refine: RefineNormals, *, iterations: int, threads: int) -> Result:
    """`pbrfit.decompose` as it is, but for whether normals are refined."""
    return decompose(scene, iterations=iterations, threads=threads, refine_normals=refine)


def off(found: Floats, true: Floats, valid: NDArray[np.bool_]) -> dict[str, float]:
    """Angles between normals (H, W, 3) and the true ones over valid pixels, in degrees.

    "aligned" is the mean after the turn of all normals together that brings them nearest to the
    true ones. Such a turn is hard to see, because lights can turn along.
    """
    angles = angles_between(found, true)[valid]
    aligned = aligned_angles(found[valid], true[valid])
    return {
        "mean": float(angles.mean()),
        "median": float(np.median(angles)),
        "aligned": float(aligned.mean()),
    }


def aligned_angles(found: Floats, true: Floats) -> Array:
    """Angles of unit vectors (P, 3) after the turn that brings them nearest in least squares.

    With H = Σ f tᵀ = U S Vᵀ it is R = V diag(1, 1, det VUᵀ) Uᵀ (Kabsch 1976). Where several turns
    are as good, such as for vectors that are all equal, it is one of them.
    """
    u, _, vt = np.linalg.svd(np.asarray(found, np.float64).T @ np.asarray(true, np.float64))
    handed = np.array([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    turn = (vt.T * handed) @ u.T
    return angles_between(found @ turn.T, true)


def decision(result: Result) -> dict[str, Any]:
    """What was decided about the normals and why, and the figures it rests on."""
    return {
        "refined": result.refinement.refined,
        "why": result.refinement.why,
        "figures": dict(result.refinement.figures),
    }
