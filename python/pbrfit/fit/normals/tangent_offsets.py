"""Tilts of normals that are known, the inverse of what the core does with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOWER = -0.99
"""Below this z of the given normal the tangents are those of its mirror image (docs/model.md)."""

FARTHEST = 0.1
"""Cosine of the angle between two normals from which on a tilt is as if it were that."""


def tilts_between(given: Array, turned: Array) -> Array:
    """Tilts (P, 2) that turn unit normals (P, 3) into others.

    n is along n₀ + a t₁ + b t₂ with tangents at n₀ that are unit vectors at right angles, so that
    a = n·t₁ / n·n₀ and b = n·t₂ / n·n₀.
    """
    x, y, z = given.T
    mirrored = z <= LOWER
    upper = np.where(mirrored, -z, z)
    first = np.stack([1 - x**2 / (1 + upper), -x * y / (1 + upper), -x], axis=-1)
    second = np.stack([-x * y / (1 + upper), 1 - y**2 / (1 + upper), -y], axis=-1)
    for tangent in (first, second):
        tangent[mirrored, 2] *= -1
    along = np.maximum(np.einsum("pi,pi->p", given, turned), FARTHEST)
    return np.stack(
        [np.einsum("pi,pi->p", turned, tangent) / along for tangent in (first, second)], axis=-1
    )
