"""A second ray caster for worlds: slow, float64, from the definitions of the solids alone.

A solid is the set where some smooth convex functions are all negative. Along a ray their maximum
is a convex function of the distance; its least value is found by golden sections, and the entry
by bisection between the camera and there. No ray equation is solved. Normals are the gradients, by
central differences, of the function that is zero at the entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import reference
from pbrfit.synthetic import World
from pbrfit.synthetic.geometry import Box, Cylinder, Plane, Primitive, Sphere
from pbrfit.synthetic.surfaces import Layers, Paint, Spots
from pbrfit.values.arrays import Array
from pbrfit_evaluation.rooms.parts import Frustum

Field = Callable[[Array], Array]

FAR = 30.0
GOLDEN = (np.sqrt(5) - 1) / 2


def _face(axis: int, sign: int, distance: float) -> Field:
    return lambda p: sign * p[:, axis] - distance


def fields(solid: Primitive) -> list[Field]:
    """Functions of object-space points (P, 3), all negative inside and nowhere else."""
    match solid:
        case Sphere(radius=radius):
            return [lambda p: (p**2).sum(-1) - radius**2]
        case Plane():
            return [lambda p: p[:, 1]]
        case Box(half=half):
            return [_face(axis, sign, half[axis]) for axis in range(3) for sign in (-1, 1)]
        case Cylinder(radius=radius, half=tall):
            bottom = top = radius
        case Frustum(bottom=bottom, top=top, half=tall):
            pass
        case _:
            raise AssertionError(type(solid))
    return [
        lambda p: p[:, 1] - tall,
        lambda p: -p[:, 1] - tall,
        lambda p: (
            np.sqrt(p[:, 0] ** 2 + p[:, 2] ** 2)
            - bottom
            - (top - bottom) * (p[:, 1] / tall + 1) / 2
        ),
    ]


@dataclass(frozen=True)
class View:
    """What a camera sees, pixel by pixel in rows from the top, P = size².

    Attributes
    ----------
    index
        (P,) of the primitive.
    distance, points, normals
        (P,), (P, 3) and (P, 3): along the ray, in scene space, and unit normals in camera space.
    materials
        (P, 5): albedo, roughness, metallic.
    towards_camera
        (P, 3) unit vectors in camera space.
    """

    index: NDArray[np.int64]
    distance: Array
    points: Array
    normals: Array
    materials: Array
    towards_camera: Array

    def radiance(self, lighting: Array) -> Array:
        """(N, P, 3) by the tests' own model."""
        maps = (self.materials[:, :3], self.materials[:, 3], self.materials[:, 4])
        weights = reference.shade(self.normals, self.towards_camera, *maps)
        return np.asarray(np.einsum("pck,nkc->npc", weights, lighting))


def look(world: World, size: int, fov: float) -> View:
    """Find what every pixel of a square picture sees."""
    edge = np.tan(fov * np.pi / 360)
    pixel = 2 * edge / size
    rays = np.array(
        [
            [-edge + (column + 0.5) * pixel, edge - (row + 0.5) * pixel, -1.0]
            for row in range(size)
            for column in range(size)
        ]
    )
    depth_to_distance = np.sqrt((rays**2).sum(-1))
    rays /= depth_to_distance[:, None]
    in_scene = np.einsum("ij,pj->pi", world.turn, rays)

    count = len(rays)
    index, distance = np.full(count, -1), np.full(count, np.inf)
    for i, solid in enumerate(world.primitives):
        entry = _entry(solid, world.eye, in_scene)
        nearer = entry < distance
        index[nearer], distance[nearer] = i, entry[nearer]
    points = world.eye + distance[:, None] * in_scene

    normals, materials = np.zeros((count, 3)), np.zeros((count, 5))
    for i in np.unique(index):
        here, solid, surface = index == i, world.primitives[i], world.surfaces[i]
        local = np.einsum("ji,pj->pi", solid.rotation, points[here] - solid.centre)
        facing = _gradient(solid, local)
        slant = -(np.einsum("ij,pj->pi", solid.rotation, facing) * in_scene[here]).sum(-1)
        width = distance[here] / depth_to_distance[here] * pixel / np.sqrt(slant)
        finish = surface.at(Spots(local, facing, width))
        if isinstance(surface, Layers):
            materials[here] = _mix(surface, local)
        else:
            maps = (finish.albedo, finish.roughness, finish.metallic)
            materials[here] = np.column_stack(maps)
        relief = facing if finish.normals is None else finish.normals
        normals[here] = np.einsum("ij,pj->pi", solid.rotation, relief)
        if finish.normals is not None:
            short = np.maximum(0.02 + (normals[here] * in_scene[here]).sum(-1), 0.0)
            normals[here] -= short[:, None] * in_scene[here]
    normals = np.einsum("ij,pi->pj", world.turn, normals)
    normals /= np.sqrt((normals**2).sum(-1))[:, None]
    return View(index, distance, points, normals, materials, -rays)


def _mix(surface: Layers, points: Array) -> Array:
    """(P, 5) albedo, roughness, metallic: as a weighted sum of all paints."""
    shown = np.ones(len(points))  # what is left to see of the layers below
    total = np.zeros((len(points), 5))
    base: tuple[Paint, Field] = (surface.base, lambda p: np.ones(len(p)))
    for paint, pattern in (*reversed(surface.layers), base):
        share = shown * pattern(points)
        total += share[:, None] * np.array([*paint.albedo, paint.roughness, paint.metallic])
        shown = shown - share
    return total


def _entry(solid: Primitive, eye: Array, rays: Array) -> Array:
    """Distance at which each ray (P, 3) enters a solid; inf where it does not."""
    origin = solid.rotation.T @ (eye - solid.centre)
    directions = np.einsum("ji,pj->pi", solid.rotation, rays)
    terms = fields(solid)

    def height(t: Array) -> Array:
        points = origin + t[:, None] * directions
        return np.asarray(np.max([term(points) for term in terms], axis=0))

    low, high = np.zeros(len(rays)), np.full(len(rays), FAR)
    for _ in range(80):
        a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        left = height(a) < height(b)
        low, high = np.where(left, low, a), np.where(left, b, high)
    inside = (low + high) / 2
    hit = (height(inside) < 0) & (height(np.zeros(len(rays))) > 0)
    outside = np.zeros(len(rays))
    for _ in range(80):
        middle = (outside + inside) / 2
        within = height(middle) < 0
        outside, inside = np.where(within, outside, middle), np.where(within, middle, inside)
    return np.where(hit, inside, np.inf)


def _gradient(solid: Primitive, points: Array) -> Array:
    """(P, 3) unit gradients of the field that is zero at points of the surface."""
    terms = fields(solid)
    active = np.argmax([term(points) for term in terms], axis=0)
    step = 1e-6
    gradient = np.zeros_like(points)
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        slopes = [(term(points + offset) - term(points - offset)) / (2 * step) for term in terms]
        gradient[:, axis] = np.take_along_axis(np.array(slopes), active[None], axis=0)[0]
    return np.asarray(gradient / np.sqrt((gradient**2).sum(-1))[:, None])
