"""Normals at tangent offsets again: slow, plain, from the definition and not from the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference

Array = NDArray[np.float64]


def tangents(normals: Array) -> tuple[Array, Array]:
    """The axes x and y, turned as +z is turned into each normal by the smallest rotation.

    By Rodrigues' formula with the axis k = z × n, sin θ = |k| and cos θ = n_z; beyond z = -0.99 the
    frame of the normal with its z turned round, whose third components are turned round again.
    """
    mirrored = normals[:, 2] <= -0.99
    upper = normals * np.where(mirrored[:, None], [1, 1, -1], [1, 1, 1])
    axis = np.cross([0.0, 0.0, 1.0], upper)
    cosine = upper[:, 2:]

    def turned(v: Array) -> Array:
        crossed = np.cross(axis, v)
        along = (axis @ v)[:, None] * axis / (1 + cosine)
        found = cosine * v + crossed + along
        found[mirrored, 2] *= -1
        return np.asarray(found, dtype=np.float64)

    return turned(np.array([1.0, 0, 0])), turned(np.array([0, 1.0, 0]))


def changed(normals: Array, offsets: Array) -> Array:
    """Unit normals (P, 3) of tangent offsets (P, 2) at the given ones (P, 3)."""
    first, second = tangents(normals)
    return reference.unit(normals + offsets[:, :1] * first + offsets[:, 1:] * second)


def weights_by_offsets(
    normals: Array, views: Array, offsets: Array, *material: Any
) -> tuple[Array, Array]:
    """Derivatives of the reference's weights by both tangent offsets: (P, 3, 16) each.

    Central differences of sixth order. Masking bends the more the nearer n·v is to 0, and has a
    kink at the clamp: steps are short there, and stay on their side.
    """
    cosine = np.sum(changed(normals, offsets) * views, axis=1)
    step = np.minimum(3e-3, 0.02 * np.abs(cosine - reference.CLAMP))[:, None]

    def weights(axis: int, steps: int) -> Array:
        moved = offsets.copy()
        moved[:, axis] += steps * step[:, 0]
        return np.asarray(reference.shade(changed(normals, moved), views, *material))

    def slope(axis: int) -> Array:
        one, two, three = (weights(axis, n) - weights(axis, -n) for n in (1, 2, 3))
        return np.asarray((45 * one - 9 * two + three) / (60 * step[..., None]))

    return slope(0), slope(1)
