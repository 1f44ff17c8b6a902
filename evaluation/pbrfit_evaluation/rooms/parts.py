"""Parts of furniture: a primitive, what it is made of, and which parts share a material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.synthetic.geometry import Box, Cylinder, Primitive, Sphere, rotation
from pbrfit_evaluation.rooms.frustum import Frustum

Array = NDArray[np.float64]

Role = Literal[
    "wood",
    "lacquer",
    "metal",
    "frame",
    "vessel",
    "textile",
    "shade",
    "stone",
    "books",
    "paper",
    "leaves",
    "canvas",
    "rug",
]
"""What a part is used as. "frame" (legs, poles, rails), "vessel", "shade" and "lacquer" (bodies of
furniture) may be of metal or not; "metal" always is, the others never."""


@dataclass(frozen=True)
class Part:
    """One primitive of a piece of furniture.

    Attributes
    ----------
    primitive
        Placed in the space of the piece, later in the room.
    role
        What it is used as.
    tag
        Parts of one piece with the same tag have the same material.
    """

    primitive: Primitive
    role: Role
    tag: str


Parts = tuple[Part, ...]


def moved(parts: Sequence[Part], x: float, y: float, z: float) -> Parts:
    """Shift parts by (x, y, z)."""
    offset = np.array([x, y, z])
    return tuple(
        replace(part, primitive=replace(part.primitive, centre=part.primitive.centre + offset))
        for part in parts
    )


def turned(parts: Sequence[Part], degrees: float) -> Parts:
    """Turn parts about the vertical axis through the origin."""
    turn = rotation(1, degrees)
    return tuple(
        replace(
            part,
            primitive=replace(
                part.primitive,
                centre=turn @ part.primitive.centre,
                rotation=turn @ part.primitive.rotation,
            ),
        )
        for part in parts
    )


def retagged(parts: Sequence[Part], prefix: str) -> Parts:
    """Put a prefix before all tags, so that they differ from those of other things."""
    return tuple(replace(part, tag=f"{prefix}/{part.tag}") for part in parts)


def box(role: Role, tag: str, at: Sequence[float], half: Sequence[float] | Array) -> Part:
    """Cuboid with its centre `at` and half its edges `half`."""
    return Part(Box(centre=np.array(at, dtype=float), half=np.array(half, dtype=float)), role, tag)


def ball(role: Role, tag: str, at: Sequence[float], radius: float) -> Part:
    """Sphere with its centre `at`."""
    return Part(Sphere(centre=np.array(at, dtype=float), radius=radius), role, tag)


def drum(role: Role, tag: str, foot: Sequence[float], radius: float, height: float) -> Part:
    """Upright cylinder that stands on `foot`."""
    centre = np.array([foot[0], foot[1] + height / 2, foot[2]])
    return Part(Cylinder(centre=centre, radius=radius, half=height / 2), role, tag)


def cone(
    role: Role, tag: str, foot: Sequence[float], bottom: float, top: float, height: float
) -> Part:
    """Upright frustum that stands on `foot`."""
    centre = np.array([foot[0], foot[1] + height / 2, foot[2]])
    return Part(Frustum(centre=centre, bottom=bottom, top=top, half=height / 2), role, tag)


def reach(parts: Sequence[Part], direction: Array) -> float:
    """How far parts extend along a unit vector, from the origin of their space, in metres."""
    farthest = -np.inf
    for part in parts:
        solid = part.primitive
        x, y, z = np.abs(solid.rotation.T @ direction)
        match solid:
            case Sphere(radius=radius):
                extent = radius
            case Box(half=half):
                extent = float(x * half[0] + y * half[1] + z * half[2])
            case Cylinder(radius=radius, half=tall):
                extent = float(y * tall + np.hypot(x, z) * radius)
            case Frustum(bottom=bottom, top=top, half=tall):
                extent = float(y * tall + np.hypot(x, z) * max(bottom, top))
            case _:
                raise AssertionError(type(solid))
        farthest = max(farthest, float(solid.centre @ direction) + extent)
    return farthest
