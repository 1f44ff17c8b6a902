"""The picture as geometry, and the camera that sees it as the pictures were taken.

Both kinds of geometry are seen alike from the camera and lie about a card 1 wide and H/W high in
z = 0, which faces +Z; +X is the right of the picture. The camera is at distance d on the Z axis.
The point of the card that pixel (i, j) shows is then seen along

    −v ∝ ( (2j + 1 − W)/(2W),  (H − 1 − 2i)/(2W),  −d )

which is what `geometry.view_directions` has, times 1/(2 tan(fov/2)), if

    d = 1 / (2 tan(fov/2)),      yfov = 2 atan(tan(fov/2) · H/W).

A field of view of 0 becomes an orthographic camera.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Geometry = Literal["card", "facets"]
"""One rectangle with a normal texture, or a small one a pixel, turned to its normal."""

NEAREST, FARTHEST = 0.5, 2.0
"""How far a corner of a facet may come out of the card, in distances from the camera."""


@dataclass(frozen=True)
class ViewMesh:
    """Triangles, counter-clockwise as seen from the camera."""

    attributes: Mapping[str, NDArray[np.float32]]
    """(V, 2 to 4) float32 by glTF name; v of texture coordinates grows downwards."""
    triangles: NDArray[np.uint32]
    """(T, 3) indices of vertices."""


def camera(height: int, width: int, fov: float) -> tuple[dict[str, Any], float]:
    """The glTF camera of a picture, and its distance from the card."""
    if fov == 0:
        orthographic = {"xmag": 0.5, "ymag": 0.5 * height / width, "znear": 0.01, "zfar": 100.0}
        return {"name": "view", "type": "orthographic", "orthographic": orthographic}, 1.0
    half_width = math.tan(math.radians(fov) / 2)
    distance = 0.5 / half_width
    perspective = {
        "aspectRatio": width / height,
        "yfov": 2 * math.atan(half_width * height / width),
        "znear": 0.01 * distance,
        "zfar": 100 * distance,
    }
    return {"name": "view", "type": "perspective", "perspective": perspective}, distance


def card(height: int, width: int) -> ViewMesh:
    """A rectangle whose tangent space is camera space.

    The tangent is X and the bitangent, cross(normal, tangent) · 1, is Y, up, as glTF has it. So
    normals are a normal texture as they are.
    """
    corners = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])  # u, v; from the lower left
    position = np.zeros((4, 3))
    position[:, 0] = corners[:, 0] - 0.5
    position[:, 1] = (0.5 - corners[:, 1]) * height / width
    attributes = {
        "POSITION": position,
        "NORMAL": np.tile([0, 0, 1], (4, 1)),
        "TANGENT": np.tile([1, 0, 0, 1], (4, 1)),
        "TEXCOORD_0": corners,
    }
    return _mesh(attributes, 1)


def facets(normals: NDArray[np.float64], mask: NDArray[np.bool_], fov: float) -> ViewMesh:
    """A rectangle for each pixel in the mask, turned to its normal n.

    It keeps its centre p on the card and what it covers of the picture: a corner c of the card's
    pixel goes to where the ray from the camera C through it meets the plane through p,

        q = C + t (c − C),   t = n·(p − C) / n·(c − C)

    (of an orthographic camera, q = c − Z n·(c − p)/n_z). Seen from the camera there are no gaps.
    t is limited, and 1 where the surface faces away.
    """
    height, width = mask.shape
    i, j = np.nonzero(mask)
    n = normals[mask][:, None]

    def on_card(down: float, right: float) -> NDArray[np.float64]:
        x, y = (j + right) / width - 0.5, (0.5 * height - i - down) / width
        return np.stack([x, y, np.zeros(len(x))], axis=-1)

    centre = on_card(0.5, 0.5)[:, None]
    corner = np.stack([on_card(1, 0), on_card(1, 1), on_card(0, 1), on_card(0, 0)], axis=1)
    if fov == 0:
        facing = np.maximum(n[..., 2], 1e-9)
        depth = -np.sum(n * (corner - centre), axis=-1) / facing
        corner[..., 2] = np.where(n[..., 2] > 0, np.clip(depth, NEAREST - 1, FARTHEST - 1), 0)
    else:
        eye = np.array([0, 0, camera(height, width, fov)[1]])
        ahead = np.sum(n * (centre - eye), axis=-1)
        along = np.minimum(np.sum(n * (corner - eye), axis=-1), -1e-9)
        factor = np.where(ahead < 0, np.clip(ahead / along, NEAREST, FARTHEST), 1)
        corner = eye + factor[..., None] * (corner - eye)
    # One texel for all four corners: no neighbour's material mixes in.
    texel = np.stack([(j + 0.5) / width, (i + 0.5) / height], axis=-1)
    attributes = {
        "POSITION": corner.reshape(-1, 3),
        "NORMAL": np.repeat(n[:, 0], 4, axis=0),
        "TEXCOORD_0": np.repeat(texel, 4, axis=0),
    }
    return _mesh(attributes, len(i))


def _mesh(attributes: Mapping[str, NDArray[Any]], rectangles: int) -> ViewMesh:
    """Two triangles for every four corners."""
    first = 4 * np.arange(rectangles)[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    floats = {name: values.astype(np.float32) for name, values in attributes.items()}
    return ViewMesh(floats, triangles.astype(np.uint32))
