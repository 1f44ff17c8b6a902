"""Parts of furniture: a primitive, what it is made of, and which parts share a material.

Lamp shades, pots and cups are cones and parts of cones, `Frustum`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.model.geometry import unit
from pbrfit.synthetic.geometry import Box, Cylinder, Primitive, Sphere, rotation, slabs
from pbrfit.synthetic.surfaces import Surface
from pbrfit_evaluation.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Frustum(Primitive):
    """A capped, upright cone or part of one along the object's y axis.

    Its radius is `bottom` at y = -half and `top` at y = +half; one of them may be 0.
    """

    bottom: float
    top: float
    half: float

    def enter(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Find where rays enter the frustum; see `Primitive.enter`."""
        # The radius at height y is m + s y. Within the infinite double cone
        #     x² + z² <= (m + s y)²   =>   a t² + 2 b t + c <= 0   along the ray o + t d.
        # For a > 0 that is an interval, of one nappe. For a < 0 the ray is steeper than the sides:
        # it leaves one nappe at the first root and enters the other at the second, so it has the
        # nappe that widens upwards (s > 0) ahead of it when it rises, else behind it. The caps
        # cut off the nappe that is no part of the solid, where m + s y < 0.
        slope = (self.top - self.bottom) / (2 * self.half)
        across, start = directions[:, ::2], origin[::2]
        rise = slope * directions[:, 1]
        radius = (self.top + self.bottom) / 2 + slope * origin[1]
        a = np.einsum("pi,pi->p", across, across) - rise**2
        a = np.where(np.abs(a) < 1e-300, 1e-300, a)
        b = across @ start - rise * radius
        c = start @ start - radius**2
        cap_near, cap_far = slabs(origin[1:2], directions[:, 1:2], np.array([self.half]))
        with np.errstate(invalid="ignore", divide="ignore"):
            # Both roots without cancellation; NaN, a miss, where there are none.
            q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
            first, last = np.minimum(q / a, c / q), np.maximum(q / a, c / q)
            side = np.where(a > 0, first, np.where(rise > 0, last, -np.inf))
            leave = np.where(a > 0, last, np.where(rise > 0, np.inf, first))
            distance = np.maximum(side, cap_near[:, 0])
            hit = (distance < np.minimum(leave, cap_far[:, 0])) & (distance > 0.0)
            round_side = side >= cap_near[:, 0]
        # The side's normal is the gradient of sqrt(x² + z²) - (m + s y).
        normals = np.empty_like(directions)
        normals[:, ::2] = start + np.where(round_side, distance, 0.0)[:, None] * across
        normals[:, ::2] = unit(normals[:, ::2], 1e-300)
        normals[:, 1] = -slope
        normals /= np.sqrt(1 + slope**2)
        caps = np.stack([0 * a, -np.sign(directions[:, 1]), 0 * a], axis=-1)
        return np.where(hit, distance, np.inf), np.where(round_side[:, None], normals, caps)


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
