"""A world as arrays that a path tracer can take: triangles, materials, camera; no formulas.

Everything is in camera space (X right, Y up, Z towards the viewer, metres), so the renderer's
camera sits at the origin and is not turned, and normals, positions and lights need no conversion.

What blocks light. A closed shell would keep a panorama out, so the room is a stage set: the
ceiling, and the walls that the camera does not see, are there for camera rays only; they are seen
and lit, but cast no shadow and reflect nothing. The other walls and all pieces are solid. In an
"open" set that goes for all walls but the floor.

Materials that vary are given twice: as maps with one texel for each pixel, exact for what the
camera sees, and at the vertices, for what is seen in reflections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.model.geometry import view_directions
from pbrfit.synthetic.geometry import Box, Cylinder, Plane, Primitive, Sphere, trace
from pbrfit.synthetic.surfaces import Spots
from pbrfit.synthetic.world import World
from pbrfit_evaluation.rooms.frustum import Frustum

Array = NDArray[np.float64]
Shell = Literal["stage", "open"]
Patch = tuple[Array, Array]  # (m, n, 3) points and (m, n, 3) unit normals, in object space

ROUND = 128
"""Segments of a full circle: facets are within 3e-4 radii of the true surface."""

_CELL = 0.06  # metres between vertices on flat patches
_MOST_CELLS = 96
_FAR = 1000.0  # a wall that no other wall cuts ends here


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one primitive, in camera space.

    Attributes
    ----------
    vertices, normals
        (V, 3); unit normals of the true surface.
    triangles
        (T, 3) vertex indices, counter-clockwise seen from outside.
    albedo, roughness, metallic
        (V, 3), (V,), (V,); albedo in linear Rec.709.
    blocks_light
        False = there for camera rays only.
    """

    vertices: Array
    normals: Array
    triangles: NDArray[np.int32]
    albedo: Array
    roughness: Array
    metallic: Array
    blocks_light: bool

    @property
    def varies(self) -> bool:
        """Whether the material is not the same at all vertices."""
        return any(np.ptp(of, axis=0).any() for of in (self.albedo, self.roughness, self.metallic))


@dataclass(frozen=True, eq=False)
class Stage:
    """What the renderer gets of a world.

    Attributes
    ----------
    meshes
        One for each primitive, in order; the object id of the i-th is i + 1.
    maps
        By name, (H, W, 3) values at the pixels' centres: "albedo", "finish" (roughness, metallic,
        0) where a material varies, and "normal" (camera space) where a surface has relief.
    size, fov
        Width and height in pixels; horizontal field of view in degrees.
    """

    meshes: tuple[Mesh, ...]
    maps: dict[str, NDArray[np.float32]]
    size: int
    fov: float


def export(world: World, size: int, fov: float, shell: Shell = "stage") -> Stage:
    """Triangulate a world.

    Parameters
    ----------
    world
        The scene; its primitives are of the kinds in `pbrfit.synthetic.geometry`.
    size
        Width and height of the picture in pixels.
    fov
        Horizontal field of view in degrees, 0 < fov < 180.
    shell
        "stage" or "open"; see above.

    Raises
    ------
    InputError
        If a number is out of its range, or a primitive is of another kind.
    """
    check_choice("shell", shell, get_args(Shell))
    if size < 1:
        raise InputError(f"size: expected at least 1 pixel, found {size}")
    if not 0 < fov < 180:
        raise InputError(f"fov: expected degrees between 0 and 180, found {fov}")
    solid = light_blockers(world, fov, shell)
    meshes = tuple(_mesh(world, i, solid[i]) for i in range(len(world.primitives)))
    maps = {}
    if any(mesh.varies for mesh in meshes) or _has_relief(world):
        view = world.cast(size, fov)
        material = view.materials
        finish = np.stack([material.roughness, material.metallic, 0 * material.metallic], axis=-1)
        maps = {"albedo": material.albedo.astype(np.float32), "finish": finish.astype(np.float32)}
        if _has_relief(world):
            maps["normal"] = view.normals.astype(np.float32)
    return Stage(meshes=meshes, maps=maps, size=size, fov=fov)


def check_choice(name: str, value: object, choices: Sequence[str]) -> None:
    """Raise InputError unless the value is one of the choices."""
    if value not in choices:
        raise InputError(f"{name}: expected one of {', '.join(choices)}, found {value!r}")


def light_blockers(world: World, fov: float, shell: Shell) -> tuple[bool, ...]:
    """Which primitives are solid: the pieces, and of the walls those that `shell` leaves."""
    rays = -view_directions(64, 64, fov).reshape(-1, 3)
    seen = set(trace(world.primitives, world.eye, rays @ world.turn.T).index.tolist())
    lowest = -0.7 if shell == "stage" else 0.7  # how far up a wall's normal points at least
    return tuple(
        bool(i >= world.walls or (i in seen and wall.rotation[1, 1] > lowest))
        for i, wall in enumerate(world.primitives)
    )


def _mesh(world: World, index: int, blocks_light: bool) -> Mesh:
    primitive, surface = world.primitives[index], world.surfaces[index]
    patches = _patches(primitive, index, world)
    points, normals, triangles = _triangulate(patches)
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


def _has_relief(world: World) -> bool:
    one = Spots(np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]]), np.ones(1))
    return any(surface.at(one).normals is not None for surface in world.surfaces)


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
    if isinstance(primitive, Sphere):
        return [_ball(primitive.radius)]
    if isinstance(primitive, Box):
        return _cuboid(primitive.half)
    if isinstance(primitive, Cylinder):
        return _drum(primitive.radius, primitive.radius, primitive.half)
    if isinstance(primitive, Frustum):
        return _drum(primitive.bottom, primitive.top, primitive.half)
    if isinstance(primitive, Plane):
        return [_wall(primitive, index, world)]
    raise InputError(
        "world: expected spheres, boxes, cylinders, frustums and planes, found "
        f"{type(primitive).__name__}"
    )


def _steps(length: float) -> int:
    return int(np.clip(np.ceil(length / _CELL), 1, _MOST_CELLS)) + 1


def _circle() -> tuple[Array, Array]:
    """Cosine and sine (ROUND + 1,) around a circle whose ends are the same to the bit."""
    angle = 2 * np.pi / ROUND * (np.arange(ROUND + 1) % ROUND)
    return np.cos(angle), np.sin(angle)


def _ball(radius: float) -> Patch:
    c, s = _circle()
    polar = np.linspace(0, np.pi, ROUND // 2 + 1)[:, None]
    ring = np.sin(polar)
    ring[[0, -1]] = 0.0
    normals = np.stack(np.broadcast_arrays(ring * c, np.cos(polar), ring * s), axis=-1)
    return radius * normals, normals


def _cuboid(half: Array) -> list[Patch]:
    patches = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            u = np.linspace(-half[i], half[i], _steps(2 * half[i]))
            v = np.linspace(-half[j], half[j], _steps(2 * half[j]))
            points = np.empty((len(u), len(v), 3))
            points[..., axis], points[..., i], points[..., j] = sign * half[axis], u[:, None], v
            normal = np.zeros(3)
            normal[axis] = sign
            patches.append((points, np.broadcast_to(normal, points.shape)))
    return patches


def _drum(bottom: float, top: float, half: float) -> list[Patch]:
    """Side and caps of a cylinder, a cone or part of one."""
    c, s = _circle()
    along = np.linspace(0, 1, _steps(2 * half))[:, None]
    radius = bottom + along * (top - bottom)
    side = np.stack(np.broadcast_arrays(radius * c, half * (2 * along - 1), radius * s), axis=-1)
    slope = (top - bottom) / (2 * half)
    normals = np.stack(np.broadcast_arrays(c, -slope + 0 * radius, s), axis=-1)
    patches = [(side, normals / np.sqrt(1 + slope**2))]
    for sign, rim in ((-1.0, bottom), (1.0, top)):
        if rim > 0:
            ring = np.linspace(0, rim, _steps(rim))[:, None]
            cap = np.stack(np.broadcast_arrays(ring * c, sign * half, ring * s), axis=-1)
            patches.append((cap, np.broadcast_to(np.array([0.0, sign, 0.0]), cap.shape)))
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
    x = np.linspace(low[0], high[0], _steps(high[0] - low[0]))
    z = np.linspace(low[2], high[2], _steps(high[2] - low[2]))
    points = np.zeros((len(x), len(z), 3))
    points[..., 0], points[..., 2] = x[:, None], z
    return points, np.broadcast_to(np.array([0.0, 1.0, 0.0]), points.shape)


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
