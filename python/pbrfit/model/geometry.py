"""Camera, view directions and normal conventions.

Camera space: X right, Y up, Z towards the viewer. The field of view is horizontal, in degrees, with
square pixels and a centred principal point; 0 means an orthographic camera.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.values.arrays import Array, Floats, Mask
from pbrfit.values.checks import real_number

FOV_MIN = 1e-3
"""Least field of view in degrees: a metre seen from 57 km. Where it is less, 0 is meant."""

DIAGONAL_35MM = math.hypot(36.0, 24.0)
"""Diagonal in millimetres of the frame that EXIF's 35 mm equivalent focal length refers to."""


def unit(vectors: Floats, least: float = 0.0) -> Array:
    """Vectors (..., N) of length 1; those shorter than `least` are divided by that."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), least))


def view_directions(
    height: int,
    width: int,
    fov: float,
    rows: slice = slice(None),
    columns: slice = slice(None),
) -> NDArray[np.float64]:
    """Unit vectors v from the surface seen in each pixel to the camera.

    Of a picture of `height` × `width` pixels, `rows` and `columns` are those that are wanted.
    Returns (height, width, 3) float64, camera space, or as many rows and columns as are wanted. The
    ray through a pixel's centre runs along -v. Raises InputError if fov, in degrees, is outside
    [0, 180).
    """
    check_fov(fov)
    return views_at((height, width), fov, np.arange(width)[columns], np.arange(height)[rows, None])


def views_at(size: tuple[int, int], fov: float, columns: Any, rows: Any) -> Array:
    """Those vectors (..., 3) at places of a picture of `size` (height, width), also between pixels.

    `columns` and `rows` (...) are x and y in pixels; the centre of the first pixel is at 0, 0.
    """
    height, width = size
    half_width = math.tan(math.radians(fov) / 2)
    x = (2 * np.asarray(columns) + 1 - width) / width * half_width
    y = (height - 1 - 2 * np.asarray(rows)) / width * half_width
    length = np.sqrt(x * x + y * y + 1)
    return np.stack([-x / length, -y / length, 1 / length], axis=-1)


def positions(depth: NDArray[Any], fov: float, rows: slice = slice(None)) -> Array:
    """Points that pixels show, from their depth (height, width) along the camera's axis.

    Returns (height, width, 3) float64, or some rows, camera space, in the unit of the depth, with
    an orthographic camera half of the picture's width: the camera is the origin, and z = −depth.
    NaN where depth is. Raises InputError if fov, in degrees, is outside [0, 180).
    """
    check_fov(fov)
    (height, width), there = depth.shape, np.asarray(depth[rows], np.float64)
    x = (2 * np.arange(width) + 1 - width) / width
    y = (height - 1 - 2 * np.arange(height)[rows]) / width
    scale = np.ones(there.shape) if fov == 0 else math.tan(math.radians(fov) / 2) * there
    return np.stack([x * scale, y[:, None] * scale, -there], axis=-1)


def check_fov(fov: float) -> None:
    """Raise InputError unless it is 0 or from `FOV_MIN` to below 180."""
    expected = f"0 or degrees in [{FOV_MIN:g}, 180)"
    if not FOV_MIN <= real_number("fov", fov, expected) < 180 and fov != 0:
        raise InputError(f"fov: expected {expected}, found {fov}")


def fov_from_focal_length(focal_length_35mm: float, height: int, width: int) -> float:
    """Horizontal field of view in degrees from a 35 mm equivalent focal length in millimetres.

    Lenses are equivalent when their pictures cover the same angle along the diagonal, so the
    answer depends on the shape of the picture, (height, width) in pixels as it is looked at.
    """
    half_width = DIAGONAL_35MM / 2 * width / math.hypot(height, width)
    return math.degrees(2 * math.atan(half_width / focal_length_35mm))


def facing_away(normals: NDArray[Any], views: NDArray[Any]) -> Mask:
    """Which pixels' normals point away from the camera, n·v <= 0: (...,) from two (..., 3)."""
    return np.asarray(np.einsum("...i,...i->...", normals, views) <= 0)


def angles_between(found: Floats, true: Floats) -> Array:
    """Angle between unit vectors (..., 3), (...,) in degrees; NaN stays NaN.

    2 asin(|n - n'| / 2): arccos of n·n' would lose half of the digits of small angles.
    """
    chord = np.linalg.norm(found - true, axis=-1)
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(chord / 2, 0.0, 1.0))))


def likely_convention_error(normals: NDArray[Any], views: NDArray[Any]) -> str | None:
    """Name the flip of an axis that would turn most of the normals that face away to the camera.

    Both are (M, 3) unit vectors in camera space. Returns a sentence fragment for a warning, or None
    when no flip helps clearly.
    """
    flips = {
        "Z points away from the viewer instead of towards it": (1, 1, -1),
        "Y points down (the DirectX convention) instead of up": (1, -1, 1),
        "X points left instead of right": (-1, 1, 1),
        "all three axes are reversed": (-1, -1, -1),
    }
    now = np.mean(facing_away(normals, views))
    best = min(flips, key=lambda name: np.mean(facing_away(normals * flips[name], views)))
    after = np.mean(facing_away(normals * flips[best], views))
    return best if after < 0.5 * now else None
