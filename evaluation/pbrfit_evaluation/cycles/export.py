"""A world as arrays that a path tracer can take: triangles, materials, camera; no formulas.

Everything is in camera space (X right, Y up, Z towards the viewer, metres), so the renderer's
camera sits at the origin and is not turned, and normals, positions and lights need no conversion.

What blocks light. A closed shell would keep a panorama out, so the room is a stage set: the
ceiling, and the walls that the camera does not see, are there for camera rays only; they are seen
and lit, but cast no shadow and reflect nothing. The other walls and all pieces are solid.

Materials that vary are given twice: as maps with one texel for each pixel, exact for what the
camera sees, and at the vertices, for what is seen in reflections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.model.geometry import view_directions
from pbrfit.synthetic.geometry import Box, Cylinder, Plane, Primitive, Sphere, trace
from pbrfit.synthetic.surfaces import Spots
from pbrfit.synthetic.world import World
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.rooms.parts import Frustum

Patch = tuple[Array, Array]  # (m, n, 3) points and (m, n, 3) unit normals, in object space

ROUND = 128
"""Segments of a full circle: facets are within 3e-4 radii of the true surface."""

_CELL = 0.06  # metres between vertices on flat patches
_MOST_CELLS = 96
_FAR = 1000.0  # a wall that no other wall cuts ends here


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one primitive, in camera space."""

    vertices: Array
    normals: Array
    """`vertices` and `normals`: (V, 3); unit normals of the true surface."""
    triangles: NDArray[np.int32]
    """(T, 3) vertex indices, counter-clockwise seen from outside."""
    albedo: Array
    roughness: Array
    metallic: Array
    """`albedo`, `roughness` and `metallic`: (V, 3), (V,), (V,); albedo in linear Rec.709."""
    blocks_light: bool
    """False = there for camera rays only."""

    @property
    def varies(self) -> bool:
        """Whether the material is not the same at all vertices."""
        return any(np.ptp(of, axis=0).any() for of in (self.albedo, self.roughness, self.metallic))


@dataclass(frozen=True, eq=False)
class Stage:
    """What the renderer gets of a world."""

    meshes: tuple[Mesh, ...]
    """One for each primitive, in order; the object id of the i-th is i + 1."""
    maps: dict[str, NDArray[np.float32]]
    """By name, (H, W, 3) values at the pixels' centres: "albedo", "finish" (roughness, metallic, 0)
    where a material varies, and "normal" (camera space) where a surface has relief."""
    size: int
    fov: float
    """`size` and `fov`: width and height in pixels; horizontal field of view in degrees."""


def export(world: World, size: int, fov: float) -> Stage:
    """Triangulate a world for pictures of `size` × `size` pixels, `fov` degrees wide.

    Raises InputError if a number is out of its range (0 < fov < 180), or a primitive is not of the
    kinds in `pbrfit.synthetic.geometry` and `rooms.frustum`.
    """
    view = world.cast(size, fov)
    solid = light_blockers(world, fov)
    meshes = tuple(_mesh(world, i, solid[i]) for i in range(len(world.primitives)))
    one = Spots(np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]]), np.ones(1))
    relief = any(surface.at(one).normals is not None for surface in world.surfaces)
    maps = {}
    if relief or any(mesh.varies for mesh in meshes):
        of = view.materials
        finish = np.stack([of.roughness, of.metallic, 0 * of.metallic], axis=-1)
        maps = {"albedo": of.albedo.astype(np.float32), "finish": finish.astype(np.float32)}
        if relief:
            maps["normal"] = view.normals.astype(np.float32)
    return Stage(meshes=meshes, maps=maps, size=size, fov=fov)


def light_blockers(world: World, fov: float) -> tuple[bool, ...]:
    """Which primitives are solid: pieces, and walls that the camera sees but the ceiling."""
    rays = -view_directions(64, 64, fov).reshape(-1, 3)
    seen = set(trace(world.primitives, world.eye, rays @ world.turn.T).index.tolist())
    lowest = -0.7  # how far up a wall's normal points at least
    return tuple(
        bool(i >= world.walls or (i in seen and wall.rotation[1, 1] > lowest))
        for i, wall in enumerate(world.primitives)
    )


def _mesh(world: World, index: int, blocks_light: bool) -> Mesh:
    primitive, surface = world.primitives[index], world.surfaces[index]
    points, normals, triangles = _triangulate(_patches(primitive, index, world))
    finish = surface.at(Spots(points, normals, np.full(len(points), _CELL)))
    to_camera = primitive.rotation.T @ world.turn
    place = (primitive.centre - world.eye) @ world.turn
    return Mesh(
        vertices=points @ to_camera + place,
        normals=normals @ to_camera,
        triangles=triangles,
        albedo=finish.albedo,
        roughness=finish.roughness,
        metallic=finish.metallic,
        blocks_light=blocks_light,
    )


def _triangulate(patches: Sequence[Patch]) -> tuple[Array, Array, NDArray[np.int32]]:
    """Two triangles a cell; those without area (at poles) left out, all wound by the normals."""
    points, normals, triangles, first = [], [], [], 0
    for grid, of in patches:
        m, n = grid.shape[:2]
        index = first + np.arange(m * n, dtype=np.int32).reshape(m, n)
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        for corners in ((a, b, c), (a, c, d)):
            triangles.append(np.stack(corners, axis=-1).reshape(-1, 3))
        points.append(grid.reshape(-1, 3))
        normals.append(of.reshape(-1, 3))
        first += m * n
    p, n, t = np.concatenate(points), np.concatenate(normals), np.concatenate(triangles)
    across = np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])
    area = np.linalg.norm(across, axis=-1)
    inward = np.einsum("ti,ti->t", across, n[t].sum(axis=1)) < 0
    t[inward] = t[inward][:, ::-1]
    return p, n, t[area > 1e-9 * area.max()]


# ------------------------------------------------------------------------------ patches, by shape


def _patches(primitive: Primitive, index: int, world: World) -> list[Patch]:
    match primitive:
        case Sphere(radius=radius):
            polar = np.linspace(0, np.pi, ROUND // 2 + 1)[:, None]
            ring = np.sin(polar)
            ring[[0, -1]] = 0.0
            normals = _turned(ring, np.cos(polar))
            return [(radius * normals, normals)]
        case Box(half=half):
            sides = [(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]
            return [_sheet((a + 1) % 3, (a + 2) % 3, sign, -half, half) for a, sign in sides]
        case Cylinder(radius=radius, half=tall):
            return _drum(radius, radius, tall)
        case Frustum(bottom=bottom, top=top, half=tall):
            return _drum(bottom, top, tall)
        case Plane():
            return [_wall(primitive, index, world)]
    raise InputError(
        "world: expected spheres, boxes, cylinders, frustums and planes, found "
        f"{type(primitive).__name__}"
    )


def _steps(length: float) -> int:
    return int(np.clip(np.ceil(length / _CELL), 1, _MOST_CELLS)) + 1


def _turned(radius: Array, height: Array | float) -> Array:
    """(m, ROUND + 1, 3): a profile (m, 1) about the y axis; first and last are equal to the bit."""
    angle = 2 * np.pi / ROUND * (np.arange(ROUND + 1) % ROUND)
    circles = np.broadcast_arrays(radius * np.cos(angle), height, radius * np.sin(angle))
    return np.stack(circles, axis=-1)


def _sheet(i: int, j: int, sign: float, low: Array, high: Array) -> Patch:
    """Rectangle along the axes i and j at the low or high end, by `sign`, of the third."""
    axis = 3 - i - j
    u, v = (np.linspace(low[k], high[k], _steps(high[k] - low[k])) for k in (i, j))
    points = np.empty((len(u), len(v), 3))
    points[..., axis] = (low if sign < 0 else high)[axis]
    points[..., i], points[..., j] = u[:, None], v
    return points, _facing(axis, sign, points)


def _facing(axis: int, sign: float, points: Array) -> Array:
    """The same normal everywhere, along an axis."""
    normals = np.zeros_like(points)
    normals[..., axis] = sign
    return normals


def _drum(bottom: float, top: float, half: float) -> list[Patch]:
    """Side and caps of a cylinder, a cone or part of one."""
    along = np.linspace(0, 1, _steps(2 * half))[:, None]
    slope = (top - bottom) / (2 * half)
    side = _turned(bottom + along * (top - bottom), half * (2 * along - 1))
    normals = _turned(np.ones_like(along), -slope) / np.sqrt(1 + slope**2)
    patches = [(side, normals)]
    for sign, rim in ((-1.0, bottom), (1.0, top)):
        if rim > 0:
            cap = _turned(np.linspace(0, rim, _steps(rim))[:, None], sign * half)
            patches.append((cap, _facing(1, sign, cap)))
    return patches


def _wall(plane: Plane, index: int, world: World) -> Patch:
    """Rectangle along the plane's x and z axes about the part that the other walls leave of it."""
    corners = _FAR * np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    polygon = corners @ plane.rotation.T + plane.centre
    for i in range(world.walls):
        other = world.primitives[i]
        if i != index:
            polygon = _cut(polygon, other.rotation[:, 1], other.centre)
    if len(polygon) < 3:
        raise InputError(f"world: expected walls around a room, found nothing left of wall {index}")
    local = (polygon - plane.centre) @ plane.rotation
    low, high = local.min(axis=0), local.max(axis=0)
    low[1] = high[1] = 0.0
    return _sheet(0, 2, 1.0, low, high)


def _cut(polygon: Array, normal: Array, point: Array) -> Array:
    """Return the part of a convex polygon (K, 3) on the side of a plane its normal points to."""
    height = (polygon - point) @ normal
    kept: list[Array] = []
    for k in range(len(polygon)):
        a, b = polygon[k - 1], polygon[k]
        if (height[k - 1] < 0) != (height[k] < 0):
            t = height[k - 1] / (height[k - 1] - height[k])
            kept.append(a + t * (b - a))
        if height[k] >= 0:
            kept.append(b)
    return np.array(kept).reshape(-1, 3)
