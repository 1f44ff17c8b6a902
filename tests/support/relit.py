"""Results with known surfaces, for the tests of relighting."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import Materials, Result, decompose
from pbrfit.transport.decision import Transport
from scene_files import room
from small_worlds import ball_on_floor

SIDE = 32


@functools.cache
def fitted() -> Result:
    """The tiny room, whose pixels were fitted once."""
    return decompose(room(), iterations=0, priors=None)


def ball(like: Result, albedo: float = 0.8, roughness: float = 0.6) -> Result:
    """A dielectric sphere that fills the picture, seen straight on; outside it there is no mask."""
    at = (2 * np.arange(SIDE) + 1 - SIDE) / SIDE
    x, y = np.meshgrid(at, -at)
    inside = x**2 + y**2 < 0.95
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normals = np.where(inside[..., None], np.stack([x, y, z], axis=-1), np.nan)
    materials = even(inside, albedo, roughness)
    return dataclasses.replace(
        like, materials=materials, normals=normals, mask=inside, fov=0.0, uncertainty=None
    )


def card(like: Result, normals: NDArray[np.float64], fov: float) -> Result:
    """A grey card with these normals (H, W, 3)."""
    mask = np.ones(normals.shape[:2], bool)
    materials = even(mask, 0.25, 0.5)
    return dataclasses.replace(
        like, materials=materials, normals=normals, mask=mask, fov=fov, uncertainty=None
    )


def even(mask: NDArray[np.bool_], albedo: float, roughness: float = 1.0) -> Materials:
    """One material in a mask."""

    def of(value: float) -> NDArray[np.float64]:
        return np.where(mask, value, np.nan)

    return Materials(np.repeat(of(albedo)[..., None], 3, axis=-1), of(roughness), of(0.0))


@functools.cache
def shaded_ball() -> Result:
    """A light ball on a light floor, which block light."""
    seen = ball_on_floor()
    depth = -seen.points[..., 2].astype(np.float32)
    materials = even(seen.mask, 0.7)
    return dataclasses.replace(
        fitted(),
        materials=materials,
        normals=seen.normals,
        mask=seen.mask,
        fov=50.0,
        uncertainty=None,
        depth=depth,
        segments=seen.segments,
        transport=Transport("occlusion", "asked for"),
    )


def side_lit(picture: NDArray[np.floating[Any]]) -> str:
    """Where a ball is brightest: right, left, up, down or front."""
    bright = np.nan_to_num(picture[..., 1])
    at = (2 * np.arange(SIDE) + 1 - SIDE) / SIDE
    x, y = (float(np.sum(bright * a) / np.sum(bright)) for a in (at, -at[:, None]))
    if max(abs(x), abs(y)) < 0.03:
        return "front"
    if abs(x) > abs(y):
        return "right" if x > 0 else "left"
    return "up" if y > 0 else "down"
