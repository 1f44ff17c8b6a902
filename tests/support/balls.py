"""Pictures of a ball before a patchy wall, mirror or matt, each under a far lamp of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.scene.ball import Ball, BallKind, sphere_normals

COLOR = np.array([1.0, 0.9, 0.8])
"""Radiance of a white surface that faces a lamp."""

ALBEDO = 0.5
"""Of the matt ball."""

LAMP_RADIUS = 4.0
"""Half of the angle, in degrees, that a lamp takes in a mirror."""

FINE = 3
"""Rays across a pixel."""


def far_lamps(count: int, seed: int = 0, most: float = 75.0) -> NDArray[np.float64]:
    """Directions (K, 3) up to some degrees from the viewer."""
    rng = np.random.default_rng(seed)
    tilt, turn = np.radians(rng.uniform(5, most, count)), rng.uniform(0, 2 * np.pi, count)
    across = np.sin(tilt)
    return np.stack([across * np.cos(turn), across * np.sin(turn), np.cos(tilt)], axis=-1)


def ball_pictures(
    kind: BallKind,
    ball: Ball,
    size: tuple[int, int],
    fov: float,
    lamps: NDArray[np.float64],
    noise: float = 0.005,
) -> NDArray[np.float32]:
    """Pictures (N, H, W, 3), mirror balls clipped at 1."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(1)
    height, width = size
    fine = (FINE * height, FINE * width)
    larger = Ball(FINE * (ball.x + 0.5) - 0.5, FINE * (ball.y + 0.5) - 0.5, FINE * ball.radius)
    rows, columns = np.indices(fine)
    normals, views = sphere_normals(larger, fine, fov, columns, rows)
    inside = np.isfinite(normals[..., 0])
    mirrored = 2 * np.einsum("hwx,hwx->hw", normals, views)[..., None] * normals - views
    wall = 0.3 + 0.1 * np.sign(gaussian_filter(rng.normal(size=fine), 6 * FINE))

    def of(lamp: NDArray[np.float64]) -> NDArray[Any]:
        if kind == "matt":
            shown = ALBEDO * np.maximum(normals @ lamp, 0)
        else:
            room = 0.1 + 0.05 * np.sin(6 * mirrored[..., 0]) * np.cos(5 * mirrored[..., 1])
            shown = np.where(mirrored @ lamp > np.cos(np.radians(LAMP_RADIUS)), 1.0, room)
        picture = np.where(inside, shown, wall * lamp[2])
        coarse = picture.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
        return np.asarray(coarse[..., None] * COLOR)

    pictures = np.array([of(lamp) for lamp in lamps])
    return (pictures + rng.normal(0, noise, pictures.shape)).astype(np.float32)
