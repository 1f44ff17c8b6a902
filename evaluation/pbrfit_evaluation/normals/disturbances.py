"""Wrong normals of a chosen size: true ones, turned.

Every normal is turned by a vector ω, axis times angle. A size θ, in degrees, means:

correlated
    ω is a Gaussian random field over `PATCH` of the width and, with `BIAS_SHARE` of its variance, a
    bias that varies smoothly over `WHOLE` of the width. The root mean square over the picture of
    each of its three components is θ. A turn about the normal itself changes nothing, so the mean
    angle is that of two components, √(π/2) θ = 1.25 θ.
biased
    One ω of length θ for the whole picture, about an axis that is drawn evenly from all.
estimator
    The errors of a learned estimator (`normal_errors.as_estimated`): outlines that are washed out,
    whole objects turned, patches. All of it is made as much stronger or weaker as it takes for a
    mean angle of 1.25 θ, that of a correlated disturbance.

At the end normals that would face away from the camera are bent until they do not.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit.model.geometry import angles_between
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normal_errors import Array, as_estimated, facing, filled, smooth, turned

DISTURBANCES = ("correlated", "biased", "estimator")

PATCH, WHOLE = 0.06, 0.4
"""Lengths of fields in shares of the picture's width."""

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


def _correlated(valid: NDArray[np.bool_], degrees: float, rng: Generator) -> Array:
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
