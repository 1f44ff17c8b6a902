"""Small worlds of boxes, balls and planes in camera space, seen by a camera at the origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import positions, unit, view_directions
from pbrfit.synthetic.geometry import Box, Plane, Primitive, Sphere, rotation, trace
from pbrfit.values.arrays import Array

TURN = rotation(1, 20.0) @ rotation(0, -12.0)
"""The camera's axes in the room: turned to the left, and down."""
EYE = np.array([0.3, 1.6, 0.2])


@dataclass(frozen=True)
class Seen:
    """What the camera sees of a world, and where it is blocked."""

    primitives: list[Primitive]
    eye: Array
    turn: Array
    points: Array
    normals: Array
    mask: NDArray[np.bool_]
    segments: NDArray[np.int64]
    fov: float

    @property
    def depth(self) -> Array:
        """(H, W); NaN where nothing is."""
        return -self.points[..., 2]

    def blocked(self, starts: Array, directions: Array, solid: list[int]) -> NDArray[np.bool_]:
        """Whether rays (P, 3) in camera space meet some of the primitives."""
        kept = [self.primitives[i] for i in solid]
        found = [
            trace(kept, start @ self.turn.T + self.eye, direction[None] @ self.turn.T).index[0]
            for start, direction in zip(starts, directions, strict=True)
        ]
        return np.array(found) >= 0


def look(primitives: list[Primitive], eye: Array, turn: Array, size: int, fov: float) -> Seen:
    rays = -view_directions(size, size, fov).reshape(-1, 3)
    hits = trace(primitives, eye, rays @ turn.T)
    depth = np.where(hits.index >= 0, hits.distance * -rays[:, 2], np.nan).reshape(size, size)
    mask = (hits.index >= 0).reshape(size, size)
    normals = (hits.normals @ turn).reshape(size, size, 3)
    normals[~mask] = np.nan
    segments = (hits.index + 1).reshape(size, size)
    return Seen(primitives, eye, turn, positions(depth, fov), normals, mask, segments, fov)


INWARDS = np.array([[0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]], float)
"""Normals of the walls of the box room, in the room's axes."""
INNER = np.array([0.0, -2.6, -2.0, -2.0, -3.6, -1.6])
"""normal·x of their inner faces, in metres."""


def walls() -> list[Primitive]:
    low, high = np.array([-2.0, 0.0, -3.6]), np.array([2.0, 2.6, 1.6])
    found: list[Primitive] = []
    for normal, inner in zip(INWARDS, INNER, strict=True):
        half, centre = (high - low) / 2, (high + low) / 2
        axis = int(np.argmax(np.abs(normal)))
        half[axis] = 0.1
        centre[axis] = (inner - 0.1) * normal[axis]
        found.append(Box(centre=centre, half=half))
    return found


def box_room(size: int = 48, extra: tuple[Primitive, ...] = ()) -> Seen:
    """A room 4 m wide, 2.6 m high, 3.8 m ahead and 1.4 m behind, with a chest and a ball.

    First come floor, ceiling, left, right, back and front: slabs whose inner faces end where they
    meet.
    """
    things: list[Primitive] = [
        Box(centre=np.array([-0.9, 0.4, -2.4]), half=np.array([0.3, 0.4, 0.25])),
        Sphere(centre=np.array([0.1, 0.35, -1.9]), radius=0.35),
    ]
    return look([*walls(), *things, *extra], EYE, TURN, size, 65.0)


def ball_on_floor(size: int = 48) -> Seen:
    floor = Plane(centre=np.zeros(3))
    ball = Sphere(centre=np.array([0.0, 0.5, -2.0]), radius=0.5)
    eye = np.array([0.0, 1.2, 0.5])
    return look([floor, ball], eye, rotation(0, -30.0), size, 50.0)


def ball_alone(size: int = 40) -> Seen:
    ball = Sphere(centre=np.array([0.1, 0.0, -3.0]), radius=0.6)
    return look([ball], np.zeros(3), np.eye(3), size, 30.0)


def meets(triangles: NDArray[np.float32], starts: Array, directions: Array) -> NDArray[np.int64]:
    """Which triangle each ray meets first, −1 = none; Möller and Trumbore, all pairs."""
    a, b, c = (triangles[:, i].astype(float) for i in range(3))
    along, across = b - a, c - a
    found = np.full(len(starts), -1)
    for i, (start, direction) in enumerate(zip(starts, directions, strict=True)):
        p = np.cross(direction, across)
        det = np.einsum("ti,ti->t", along, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = start - a
            u = np.einsum("ti,ti->t", s, p) / det
            q = np.cross(s, along)
            v = q @ direction / det
            t = np.einsum("ti,ti->t", across, q) / det
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6)
        if hit.any():
            found[i] = np.argmin(np.where(hit, t, np.inf))
    return found


def cosine_rays(normals: Array, rng: np.random.Generator) -> Array:
    """One direction for each normal (P, 3), as a diffuse surface weights them."""
    ball = unit(rng.normal(size=normals.shape))
    found = normals + 0.999 * ball
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))
