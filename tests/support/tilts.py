"""Tilted normals again: slow, plain, written from the definition and not from the package."""

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


def turn(normals: Array, tilts: Array) -> Array:
    """Unit normals (P, 3) of tilts (P, 2) at the given ones (P, 3)."""
    first, second = tangents(normals)
    return reference.unit(normals + tilts[:, :1] * first + tilts[:, 1:] * second)


def weights_by_tilts(
    normals: Array, views: Array, tilts: Array, *material: Any
) -> tuple[Array, Array]:
    """Derivatives of the reference's weights by both tilts: (P, 3, 16) each.

    Central differences of sixth order. Masking bends the more the nearer n·v is to 0, and has a
    kink at the clamp: steps are short there, and stay on their side.
    """
    cosine = np.sum(turn(normals, tilts) * views, axis=1)
    step = np.minimum(3e-3, 0.02 * np.abs(cosine - reference.CLAMP))[:, None]

    def weights(tilt: int, steps: int) -> Array:
        moved = tilts.copy()
        moved[:, tilt] += steps * step[:, 0]
        return np.asarray(reference.shade(turn(normals, moved), views, *material))

    def slope(tilt: int) -> Array:
        one, two, three = (weights(tilt, n) - weights(tilt, -n) for n in (1, 2, 3))
        return np.asarray((45 * one - 9 * two + three) / (60 * step[..., None]))

    return slope(0), slope(1)
