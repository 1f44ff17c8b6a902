"""Convex primitives and planes, and the nearest hit of every ray.

A primitive is described in its own object space and placed by a rotation and a centre,
x_scene = R x_object + c. Every solid is convex, so a ray is inside it for one interval of
distances, and the ray meets it where that interval begins: at the largest of the distances at
which the ray enters each of its bounding surfaces. The normal is the one of the surface entered
last, which makes it exact, and front-facing by construction.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import unit
from pbrfit.values.arrays import Array


def rotation(axis: int, degrees: float) -> Array:
    """(3, 3) right-handed rotation about the coordinate axis 0, 1 or 2 (x, y or z)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return matrix


@dataclass(frozen=True, kw_only=True)
class Primitive(ABC):
    """A surface placed in the scene."""

    centre: Array
    """(3,) position of the object-space origin."""
    rotation: Array = field(default_factory=lambda: np.eye(3))
    """(3, 3), from object space to the scene."""

    @abstractmethod
    def enter(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Distance at which rays enter the primitive, and the surface they enter through.

        Rays start at `origin` (3,), and `directions` are (P, 3) unit vectors, in object space.
        Returns distance: (P,); inf where the ray misses, or starts inside; normals: (P, 3) unit
        normals in object space, on the side the ray comes from; without meaning where it misses.
        """


@dataclass(frozen=True, kw_only=True)
class Sphere(Primitive):
    """A ball; `radius` in scene units."""

    radius: float

    def enter(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Find where rays enter the ball; see `Primitive.enter`."""
        # |o + t d|² = radius² with |d| = 1: t = -b ± sqrt(b² - (|o|² - radius²)), b = o·d.
        # b² - |o|² is minus the squared distance of the centre from the ray; written as the
        # square of that offset it does not cancel.
        b = directions @ origin
        offset = origin - b[:, None] * directions
        discriminant = self.radius**2 - np.einsum("pi,pi->p", offset, offset)
        distance = -b - np.sqrt(np.maximum(discriminant, 0.0))
        hit = (discriminant > 0.0) & (distance > 0.0)
        points = origin + distance[:, None] * directions
        normals = unit(points)
        return np.where(hit, distance, np.inf), normals


@dataclass(frozen=True, kw_only=True)
class Box(Primitive):
    """A cuboid; `half` (3,) is half its edge lengths."""

    half: Array

    def enter(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Find where rays enter the cuboid; see `Primitive.enter`."""
        near, far = slabs(origin, directions, self.half)
        face = np.argmax(near, axis=-1)[:, None]
        distance = np.take_along_axis(near, face, axis=-1)[:, 0]
        normals = np.zeros_like(directions)
        entered = -np.sign(np.take_along_axis(directions, face, axis=-1))
        np.put_along_axis(normals, face, entered, axis=-1)
        hit = (distance < far.min(axis=-1)) & (distance > 0.0)
        return np.where(hit, distance, np.inf), normals


@dataclass(frozen=True, kw_only=True)
class Cylinder(Primitive):
    """A capped cylinder along the object's y axis; `radius`, and half its height `half`."""

    radius: float
    half: float

    def enter(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Find where rays enter the cylinder; see `Primitive.enter`."""
        cap_near, cap_far = slabs(origin[1:2], directions[:, 1:2], np.array([self.half]))
        # The side: the sphere's equation in the xz plane, where |d|² = a < 1; a ray along the axis
        # is inside for ever (a = 1e-300) or never (the root of a negative number, NaN, a miss).
        across, start = directions[:, ::2], origin[::2]
        with np.errstate(invalid="ignore"):
            a = np.maximum(np.einsum("pi,pi->p", across, across), 1e-300)
            middle = -(across @ start) / a
            offset = start + middle[:, None] * across
            half_chord = np.sqrt((self.radius**2 - np.einsum("pi,pi->p", offset, offset)) / a)
            side = middle - half_chord
            distance = np.maximum(side, cap_near[:, 0])
            hit = (distance < np.minimum(middle + half_chord, cap_far[:, 0])) & (distance > 0.0)
            round_side = side >= cap_near[:, 0]
        normals = np.zeros_like(directions)
        normals[:, ::2] = start + np.where(round_side, distance, 0.0)[:, None] * across
        normals = unit(normals, 1e-300)
        caps = np.stack([0 * a, -np.sign(directions[:, 1]), 0 * a], axis=-1)
        return np.where(hit, distance, np.inf), np.where(round_side[:, None], normals, caps)


@dataclass(frozen=True, kw_only=True)
class Plane(Primitive):
    """The infinite plane y = 0 of the object space, seen from the side y > 0 only."""

    def enter(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """Find where rays enter the half-space y < 0; see `Primitive.enter`."""
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origin[1] / directions[:, 1]
        hit = (directions[:, 1] < 0.0) & (distance > 0.0)
        normals = np.broadcast_to(np.array([0.0, 1.0, 0.0]), directions.shape)
        return np.where(hit, distance, np.inf), normals


def slabs(origin: Array, directions: Array, half: Array) -> tuple[Array, Array]:
    """Distances at which rays enter and leave the slabs |x_i| <= half_i, axis by axis: (P, K)."""
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel to the slab: -inf, inf
        middle = -origin / directions
        reach = half / np.abs(directions)
        parallel = directions == 0.0
        within = np.where(np.abs(origin) < half, np.inf, -np.inf)
        near = np.where(parallel, -within, middle - reach)
        far = np.where(parallel, within, middle + reach)
    return near, far


@dataclass(frozen=True)
class Hits:
    """What a bundle of rays sees."""

    index: NDArray[np.int64]
    """(P,) which primitive each ray meets first; -1 where it meets none."""
    distance: Array
    """(P,) along the ray, in scene units; inf where it meets none."""
    normals: Array
    """(P, 3) unit normals in scene space that face the ray's origin; 0 where it meets none."""
    local: Array
    """(P, 3) hit points in the object space of the primitive that was met; 0 where it meets
    none."""


def trace(primitives: Sequence[Primitive], origin: Array, directions: Array) -> Hits:
    """Nearest hit of each ray.

    Rays start at `origin` (3,), and `directions` are (P, 3) unit vectors, in scene space.
    """
    index = np.full(len(directions), -1, dtype=np.int64)
    distance = np.full(len(directions), np.inf)
    normals = np.zeros_like(directions)
    local = np.zeros_like(directions)
    for i, primitive in enumerate(primitives):
        local_origin = (origin - primitive.centre) @ primitive.rotation
        local_directions = directions @ primitive.rotation
        entry, local_normals = primitive.enter(local_origin, local_directions)
        nearer = entry < distance
        index[nearer] = i
        distance[nearer] = entry[nearer]
        normals[nearer] = local_normals[nearer] @ primitive.rotation.T
        local[nearer] = local_origin + entry[nearer, None] * local_directions[nearer]
    return Hits(index=index, distance=distance, normals=normals, local=local)
