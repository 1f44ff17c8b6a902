"""What makes normals wrong, for several suites: smooth random fields, turns, what cameras see.

**Normals as a learned estimator would give them**: true ones, disturbed.

Errors of such estimators are not noise. They are alike over neighbouring pixels, over whole
objects and over the picture, they grow at outlines, and a few are large: on indoor photographs
with measured depth, DSINE (Bae and Davison 2024) has a mean error of 16.4 degrees and a median of
8.4 (NYUv2), 16.2 and 8.3 (ScanNet), and other estimators of these years are near. The model has
four parts, in this order:

1. outlines are washed out: a Gaussian blur of the normals, `BLUR` wide;
2. each object is seen turned as a whole, by a random rotation with the heavy tail of Student's t;
3. shape is misjudged locally: a random rotation that varies smoothly, over `PATCH` of the width;
4. and over the picture: the same, over `WHOLE` of the width.

A rotation is a vector ω (axis times angle) whose three components are drawn alike. After all, a
normal that would face away from the camera is bent back until it does not: estimators do not give
such ones. Lengths are shares of the picture's width, so the errors are the same at any size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit.model.geometry import angles_between
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Floats, filled, unit

LOWEST_COSINE = 0.05
"""Of normal and view direction: normals that are given face the camera."""

WAVES = 256


def smooth(shape: tuple[int, int], scale: float, rng: Generator) -> Array:
    """Gaussian random field of variance 1 and correlation exp(-d²/(2 scale²)) over distances d.

    A sum of plane waves whose wave vectors have the field's spectrum, a Gaussian of standard
    deviation 1/scale in each component. Distances are shares of the picture's width, so the field
    is the same at any size.
    """
    height, width = shape
    y, x = np.mgrid[:height, :width] / width
    kx, ky = rng.normal(scale=1 / scale, size=(2, WAVES))
    phase = rng.uniform(0, 2 * np.pi, size=WAVES)
    total = np.zeros_like(x)
    for wave in zip(kx, ky, phase, strict=True):
        total += np.cos(wave[0] * x + wave[1] * y + wave[2])
    return np.asarray(np.sqrt(2 / WAVES) * total)


def turned(normals: Floats, omega: Floats) -> Array:
    """Normals (H, W, 3), each turned by a vector ω (H, W, 3): axis times angle, in degrees."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_rotvec(omega.reshape(-1, 3), degrees=True)
    return np.asarray(rotation.apply(normals.reshape(-1, 3)).reshape(normals.shape))


def angle_errors(found: Floats, true: Floats) -> dict[str, float]:
    """`mean` and `median` angle between normals (..., 3) in degrees, of those that are known."""
    off = angles_between(found, true)
    off = off[np.isfinite(off)]
    return {"mean": float(off.mean()), "median": float(np.median(off))}


def facing(normals: Floats, views: Floats) -> Array:
    """Normals (H, W, 3) bent until none faces away from the camera: estimators give no such ones.

    With a cosine below c = `LOWEST_COSINE`, n becomes n + (c - n·v) v, normalised: its cosine is c
    before it is normalised, and more than 0 after.
    """
    missing = np.maximum(LOWEST_COSINE - np.einsum("...i,...i->...", normals, views), 0.0)
    return unit(normals + missing[..., None] * views)


# ------------------------------------------------------------------------------- an estimator

BLUR = 0.025
OBJECT_DEGREES, OBJECT_FREEDOM, LARGEST_TURN = 2.0, 2.0, 60.0
PATCH, PATCH_DEGREES = 0.06, 2.5
WHOLE, WHOLE_DEGREES = 0.4, 2.0
"""Lengths in shares of the width. Angles in degrees: the standard deviation of a component of ω,
for objects the factor of Student's t, which is cut off at `LARGEST_TURN`."""


def as_estimated(
    normals: Floats,
    views: Floats,
    segments: NDArray[np.integer[Any]],
    rng: Generator,
    *,
    strength: float = 1.0,
) -> Array:
    """True normals (H, W, 3) with the errors of an estimator: unit vectors that face the camera.

    `views` (H, W, 3) are unit vectors from the surface to the camera, `segments` (H, W) ids of
    objects. The same state of `rng` gives the same errors at any picture size, but for what a
    coarser picture does not show. `strength` is a factor of all angles and of the blur, but not of
    the lengths over which errors are alike.
    """
    from scipy.ndimage import gaussian_filter

    width = segments.shape[1]
    blurred = gaussian_filter(normals, strength * BLUR * width, axes=(0, 1), mode="nearest")
    turns = rng.standard_t(OBJECT_FREEDOM, size=(int(segments.max()) + 1, 3))
    turns = np.clip(strength * OBJECT_DEGREES * turns, -LARGEST_TURN, LARGEST_TURN)
    omega = turns[segments]
    for scale, degrees in ((PATCH, PATCH_DEGREES), (WHOLE, WHOLE_DEGREES)):
        fields = [smooth(segments.shape, scale, rng) for _ in range(3)]
        omega += strength * degrees * np.stack(fields, axis=-1)
    return facing(turned(unit(blurred), omega), views)


def estimated(scene: Scene, seed: int) -> Array:
    """Normals of a synthetic scene as an estimator would give them, by the scene's seed.

    NaN outside the mask.
    """
    assert scene.segments is not None
    # A stream of its own, apart from those of the scene.
    rng = np.random.default_rng([seed, 1])
    valid = scene.valid
    normals, views = (filled(vectors, valid) for vectors in (scene.normals, scene.views))
    found = as_estimated(normals, views, scene.segments, rng)
    return np.where(valid[..., None], found, np.nan)
