"""Normals as a learned estimator would give them: true ones, disturbed.

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

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]

BLUR = 0.025
OBJECT_DEGREES, OBJECT_FREEDOM, LARGEST_TURN = 2.0, 2.0, 60.0
PATCH, PATCH_DEGREES = 0.06, 2.5
WHOLE, WHOLE_DEGREES = 0.4, 2.0
"""Lengths in shares of the width. Angles in degrees: the standard deviation of a component of ω,
for objects the factor of Student's t, which is cut off at `LARGEST_TURN`."""

LOWEST_COSINE = 0.05
WAVES = 256


def disturbed(
    normals: Floats, views: Floats, segments: NDArray[np.integer[Any]], rng: Generator
) -> Array:
    """True normals with the errors of an estimator.

    Parameters
    ----------
    normals
        (H, W, 3) unit vectors in camera space.
    views
        (H, W, 3) unit vectors from the surface to the camera.
    segments
        (H, W) ids of objects.
    rng
        Source of randomness; the same state gives the same errors at any picture size, but for
        what a coarser picture does not show.

    Returns
    -------
    ndarray
        (H, W, 3) unit vectors that face the camera.
    """
    from scipy.ndimage import gaussian_filter
    from scipy.spatial.transform import Rotation

    height, width = segments.shape
    y, x = np.mgrid[:height, :width] / width
    blurred = gaussian_filter(normals, BLUR * width, axes=(0, 1), mode="nearest")
    turns = OBJECT_DEGREES * rng.standard_t(OBJECT_FREEDOM, size=(int(segments.max()) + 1, 3))
    omega = np.clip(turns, -LARGEST_TURN, LARGEST_TURN)[segments]
    for scale, degrees in ((PATCH, PATCH_DEGREES), (WHOLE, WHOLE_DEGREES)):
        omega += degrees * np.stack([_smooth(x, y, scale, rng) for _ in range(3)], axis=-1)
    rotation = Rotation.from_rotvec(omega.reshape(-1, 3), degrees=True)
    turned = rotation.apply(_unit(blurred).reshape(-1, 3)).reshape(normals.shape)
    # n + (c - n·v) v has a cosine of c before it is normalised, and of more than 0 after.
    missing = np.maximum(LOWEST_COSINE - np.einsum("...i,...i->...", turned, views), 0.0)
    return _unit(turned + missing[..., None] * views)


def _smooth(x: Array, y: Array, scale: float, rng: Generator) -> Array:
    """Gaussian random field of variance 1 and correlation exp(-d²/(2 scale²)) over distances d.

    A sum of plane waves whose wave vectors have the field's spectrum, a Gaussian of standard
    deviation 1/scale in each component.
    """
    kx, ky = rng.normal(scale=1 / scale, size=(2, WAVES))
    phase = rng.uniform(0, 2 * np.pi, size=WAVES)
    total = np.zeros_like(x)
    for wave in zip(kx, ky, phase, strict=True):
        total += np.cos(wave[0] * x + wave[1] * y + wave[2])
    return np.asarray(np.sqrt(2 / WAVES) * total)


def _unit(vectors: Floats) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
