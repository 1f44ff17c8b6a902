"""Coordinates of texture maps on primitives, and the directions in which they grow.

Planes and the sides of boxes are mapped flat, the sides of cylinders and frusta are unrolled, and
spheres have longitude and latitude. A whole number of tiles goes round what is round, so that
nothing shows where they close.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.synthetic.geometry import Cylinder, Primitive, Sphere
from pbrfit_evaluation.rooms.frustum import Frustum

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chart:
    """Coordinates at P points."""

    u: Array
    v: Array
    """`u` and `v`: (P,) in tiles."""
    right: Array
    up: Array
    """`right` and `up`: (P, 3) unit vectors in object space along which u and v grow; with the
    normal they are orthogonal and right-handed."""
    squeeze: Array
    """(P,) how many times smaller a tile is there than its nominal size."""


def chart(primitive: Primitive, points: Array, normals: Array, tile: float) -> Chart:
    """Map tiles of `tile` metres onto a primitive; points and normals (P, 3) in object space."""
    flat = _flat(points, normals, tile)
    match primitive:
        case Sphere(radius=radius):
            latitude = np.arctan2(points[:, 1], np.hypot(points[:, 0], points[:, 2]))
            return _round(points, normals, tile, radius, radius * latitude)
        case Cylinder(radius=radius):
            side = _round(points, normals, tile, radius, points[:, 1])
        case Frustum(bottom=bottom, top=top):
            # The sides' normal has the cosine of their slope as its length in the xz plane.
            cosine = np.maximum(np.hypot(normals[:, 0], normals[:, 2]), 1e-6)
            side = _round(points, normals, tile, max(bottom, top), points[:, 1] / cosine)
        case _:
            return flat
    cap = np.abs(normals[:, 1]) == 1.0
    return Chart(
        u=np.where(cap, flat.u, side.u),
        v=np.where(cap, flat.v, side.v),
        right=np.where(cap[:, None], flat.right, side.right),
        up=np.where(cap[:, None], flat.up, side.up),
        squeeze=np.where(cap, 1.0, side.squeeze),
    )


def _flat(points: Array, normals: Array, tile: float) -> Chart:
    """Map along the object's axes, for the axis that the normal is closest to."""
    axis = np.argmax(np.abs(normals), axis=-1)
    sign = np.sign(np.take_along_axis(normals, axis[:, None], axis=-1))[:, 0]
    right = np.zeros_like(points)
    right[:, 0] = np.where(axis == 2, sign, np.where(axis == 1, 1.0, 0.0))
    right[:, 2] = np.where(axis == 0, -sign, 0.0)
    up = np.cross(normals, right)
    return Chart(
        u=np.einsum("pi,pi->p", points, right) / tile,
        v=np.einsum("pi,pi->p", points, up) / tile,
        right=right,
        up=up,
        squeeze=np.ones(len(points)),
    )


def _round(points: Array, normals: Array, tile: float, radius: float, height: Array) -> Chart:
    """Unroll about the y axis: u is the azimuth from +z towards +x, v the height along the side."""
    x, _, z = points.T
    distance = np.maximum(np.hypot(x, z), 1e-12)
    right = np.stack([z / distance, np.zeros_like(x), -x / distance], axis=-1)
    repeats = max(1, round(2 * np.pi * radius / tile))
    natural = repeats * tile / (2 * np.pi)  # the radius at which a tile has its nominal width
    return Chart(
        u=np.arctan2(x, z) / (2 * np.pi) * repeats,
        v=height / tile,
        right=right,
        up=np.cross(normals, right),
        squeeze=np.clip(natural / distance, 1.0, 1e3),
    )
