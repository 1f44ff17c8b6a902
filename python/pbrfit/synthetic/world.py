"""A world: primitives with their surfaces and a camera, and what that camera sees of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.model.geometry import unit, view_directions
from pbrfit.model.materials import Materials
from pbrfit.synthetic.geometry import Primitive, trace
from pbrfit.synthetic.surfaces import Spots, Surface
from pbrfit.values.arrays import Array


@dataclass(frozen=True)
class RayCast:
    """What the camera sees, before any light."""

    normals: Array
    """(H, W, 3) exact unit normals in camera space (X right, Y up, Z towards the viewer)."""
    segments: NDArray[np.uint16]
    """(H, W) ids from 1, one for each piece and each wall."""
    materials: Materials
    """Ground truth; albedo in linear Rec.709."""
    fov: float
    """Horizontal field of view in degrees."""


@dataclass(frozen=True)
class World:
    """A scene before any picture of it. Scene space has Y up, in metres."""

    primitives: tuple[Primitive, ...]
    """The walls of a closed shell first, then the pieces inside it."""
    surfaces: tuple[Surface, ...]
    """What covers each primitive, in the same order."""
    walls: int
    """How many of the first primitives are the shell."""
    eye: Array
    """(3,) position of the camera."""
    turn: Array
    """(3, 3) the camera's axes (X right, Y up, Z towards the viewer) as columns, in scene space:
    x_scene = turn x_camera + eye."""

    def cast(self, size: int, fov: float = 60.0) -> RayCast:
        """Cast one ray through every pixel centre.

        Every pixel is valid and faces the camera. Its `size` is width and height in
        pixels, `fov` the horizontal field of view in degrees, 0 < fov < 180. Raises InputError when
        `size` is below 1, or `fov` is outside its range.
        """
        if size < 1:
            raise InputError(f"size: expected at least 1 pixel, found {size}")
        if not 0 < fov < 180:
            raise InputError(f"fov: expected degrees between 0 and 180, found {fov}")
        rays = -view_directions(size, size, fov).reshape(-1, 3)
        directions = rays @ self.turn.T
        hits = trace(self.primitives, self.eye, directions)
        # Pixels are squares of one size on the plane z = -1; they grow with the depth, and by
        # 1/(n·v) on a slanted surface.
        across = hits.distance * -rays[:, 2] * (2 * np.tan(np.radians(fov) / 2) / size)
        facing = -np.einsum("pi,pi->p", hits.normals, directions)
        width = across / np.sqrt(np.maximum(facing, 1e-6))
        normals = hits.normals.copy()
        albedo, roughness, metallic = np.empty((size * size, 3)), *np.empty((2, size * size))
        for i in np.unique(hits.index):
            here = hits.index == i
            turn = self.primitives[i].rotation
            finish = self.surfaces[i].at(
                Spots(hits.local[here], hits.normals[here] @ turn, width[here])
            )
            albedo[here], roughness[here] = finish.albedo, finish.roughness
            metallic[here] = finish.metallic
            if finish.normals is not None:
                normals[here] = _to_viewer(finish.normals @ turn.T, -directions[here])
        return RayCast(
            normals=(normals @ self.turn).reshape(size, size, 3),
            segments=(hits.index + 1).astype(np.uint16).reshape(size, size),
            materials=Materials(
                albedo=albedo.reshape(size, size, 3),
                roughness=roughness.reshape(size, size),
                metallic=metallic.reshape(size, size),
            ),
            fov=fov,
        )


_LEAST_FACING = 0.02


def _to_viewer(normals: Array, views: Array) -> Array:
    """Tilt normals of a relief just so far that they face the viewer: n·v is 0.02 before scaling.

    A normal map says nothing of what hides what; seen from the side, slopes of it would turn away
    from the viewer, which no visible surface does.
    """
    facing = np.einsum("pi,pi->p", normals, views)
    tilted = normals + np.maximum(_LEAST_FACING - facing, 0.0)[:, None] * views
    return unit(tilted)
