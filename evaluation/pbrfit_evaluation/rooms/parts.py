"""Parts of furniture: a primitive, what it is made of, and which parts share a material."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.synthetic.geometry import Box, Cylinder, Primitive, Sphere, rotation
from pbrfit.synthetic.surfaces import Surface
from pbrfit_evaluation.rooms.frustum import Frustum

Array = NDArray[np.float64]
Covering = Callable[[np.random.Generator, Primitive], Surface]
"""Draws what a primitive is made of; see `coverings`."""


@dataclass(frozen=True)
class Part:
    """One primitive of a piece of furniture."""

    primitive: Primitive
    """Placed in the space of the piece, later in the room."""
    covering: Covering
    """What it is made of."""
    tag: str
    """Parts of one piece with the same tag have the same material."""


Parts = tuple[Part, ...]


def pick(rng: np.random.Generator, *options: Covering) -> Covering:
    """Draw one of these."""
    return options[rng.integers(len(options))]


def placed(
    parts: Sequence[Part],
    at: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    yaw: float = 0.0,
    tag: str | None = None,
) -> Parts:
    """Turn parts by `yaw` degrees about the vertical axis through the origin and shift them.

    A tag is put before all of theirs, so that they differ from those of other things.
    """
    turn = rotation(1, yaw)
    return tuple(
        Part(
            primitive=replace(
                part.primitive,
                centre=turn @ part.primitive.centre + np.array(at),
                rotation=turn @ part.primitive.rotation,
            ),
            covering=part.covering,
            tag=part.tag if tag is None else f"{tag}/{part.tag}",
        )
        for part in parts
    )


def box(of: Covering, tag: str, at: Sequence[float], half: Sequence[float] | Array) -> Part:
    """Cuboid with its centre `at` and half its edges `half`."""
    return Part(Box(centre=np.array(at, dtype=float), half=np.array(half, dtype=float)), of, tag)


def ball(of: Covering, tag: str, at: Sequence[float], radius: float) -> Part:
    """Sphere with its centre `at`."""
    return Part(Sphere(centre=np.array(at, dtype=float), radius=radius), of, tag)


def drum(of: Covering, tag: str, foot: Sequence[float], radius: float, height: float) -> Part:
    """Upright cylinder that stands on `foot`."""
    centre = np.array([foot[0], foot[1] + height / 2, foot[2]])
    return Part(Cylinder(centre=centre, radius=radius, half=height / 2), of, tag)


def cone(
    of: Covering, tag: str, foot: Sequence[float], bottom: float, top: float, height: float
) -> Part:
    """Upright frustum that stands on `foot`."""
    centre = np.array([foot[0], foot[1] + height / 2, foot[2]])
    return Part(Frustum(centre=centre, bottom=bottom, top=top, half=height / 2), of, tag)


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
