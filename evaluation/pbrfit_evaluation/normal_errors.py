"""What makes normals wrong, for several suites: smooth random fields, turns, what cameras see."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit.model.geometry import angles_between

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]

LOWEST_COSINE = 0.05
"""Of normal and view direction: normals that are given face the camera."""

WAVES = 256


def smooth(shape: tuple[int, int], scale: float, rng: Generator) -> Array:
    """Gaussian random field of variance 1 and correlation exp(-d²/(2 scale²)) over distances d.

    A sum of plane waves whose wave vectors have the field's spectrum, a Gaussian of standard
    deviation 1/scale in each component. Distances are shares of the picture's width, so the field
    is the same at any size.

    Returns
    -------
    ndarray
        Of `shape`, (H, W).
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


def unit(vectors: Floats) -> Array:
    """Vectors (..., 3) of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def filled(vectors: Floats, valid: NDArray[np.bool_]) -> Array:
    """Vectors (H, W, 3), outside the mask those of the nearest pixel inside."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    found: Array = np.asarray(vectors, dtype=np.float64)[tuple(nearest)]
    return found
