"""Pictures of a ball and of a relief, each under a far lamp of its own, made by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.model import geometry
from pbrfit.values.arrays import Array


@dataclass(frozen=True, eq=False)
class LampScene:
    """What a fit is given, and the truth."""

    samples: Array
    usable: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    views: Array
    normals: Array
    albedo: Array
    directions: Array
    strengths: Array
    fov: float

    def error(self, found: Array) -> float:
        """Mean angle to the true normals, in degrees."""
        return float(geometry.angles_between(found, self.normals)[self.mask].mean())

    def lamp_error(self, found: Array) -> float:
        """Mean angle to the true directions of lamps, in degrees."""
        return float(geometry.angles_between(found, self.directions).mean())


def around(count: int, slant: float, spread: float = 0.0, seed: int = 0) -> Array:
    """Directions (N, 3) at about some degrees from the camera's axis."""
    rng = np.random.default_rng(seed)
    theta = np.radians(slant + rng.uniform(-spread, spread, count))
    phi = 2.4 * np.arange(count)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack([x, y, np.cos(theta)], axis=1)


def ball(
    directions: Array,
    *,
    size: int = 72,
    albedos: int = 2,
    gloss: float = 0.0,
    strengths: Array | None = None,
    coded: bool = True,
) -> LampScene:
    """A ball of stripes before black, far away; the pixels at its very edge are left out."""
    y, x = np.mgrid[:size, :size]
    x, y = (x - (size - 1) / 2) / (0.42 * size), ((size - 1) / 2 - y) / (0.42 * size)
    mask = x**2 + y**2 < 0.98
    normals = geometry.unit(np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 1e-9))], axis=-1))
    stripe = np.floor((x + 1) * 2.5).astype(int) % albedos
    colors = np.array([[0.6, 0.5, 0.4], [0.25, 0.3, 0.5], [0.5, 0.2, 0.15]])
    return _rendered(normals, mask, colors[stripe], directions, strengths, gloss, coded, 0.0)


def relief(directions: Array, *, size: int = 72, fov: float = 0.0, coded: bool = True) -> LampScene:
    """Waves that fill the picture, of two albedos."""
    views = geometry.view_directions(size, size, fov)
    y, x = np.mgrid[:size, :size] * (2 * np.pi / size)
    slope_x = 0.6 * np.cos(2 * x + 0.5) + 0.3 * np.cos(x - 2 * y)
    slope_y = 0.5 * np.sin(2 * y + 1.0) - 0.6 * np.cos(x - 2 * y)
    if fov > 0:
        # ∂ ln z/∂x = m₁/M with M = m₃ - x m₁ - y m₂; of ln z, in units of the focal length.
        right, up = (-views[..., i] / views[..., 2] for i in (0, 1))
        facing = 1 + right * slope_x - up * slope_y
    else:
        facing = np.ones_like(slope_x)
    normals = geometry.unit(np.stack([slope_x, -slope_y, facing], axis=-1))
    albedo = np.where((x + y < 6)[..., None], [0.6, 0.55, 0.5], [0.3, 0.35, 0.5])
    return _rendered(
        normals, np.ones((size, size), bool), albedo, directions, None, 0.0, coded, fov
    )


def _rendered(
    normals: Array,
    mask: NDArray[np.bool_],
    albedo: Array,
    directions: Array,
    strengths: Array | None,
    gloss: float,
    coded: bool,
    fov: float,
) -> LampScene:
    height, width = mask.shape
    views = geometry.view_directions(height, width, fov)
    strengths = np.ones(len(directions)) if strengths is None else strengths
    pictures = []
    for direction, strength in zip(directions, strengths, strict=True):
        half = geometry.unit(views + direction)
        shading = np.maximum(normals @ direction, 0.0)[..., None]
        shine = gloss * np.maximum(np.einsum("hwi,hwi->hw", normals, half), 0.0) ** 80
        pictures.append(strength * (albedo * shading + shine[..., None] * (shading > 0)))
    samples = np.stack(pictures)
    if coded:
        samples = decode_srgb(np.round(encode_srgb(np.clip(samples, 0, 1)) * 255) / 255)
    usable = (samples < 0.99) & mask[..., None]
    return LampScene(samples, usable, mask, views, normals, albedo, directions, strengths, fov)
