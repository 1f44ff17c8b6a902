"""Point lights inside a room: where they are and what colour they have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.synthetic.lights import random_colors
from pbrfit_evaluation.cycles.export import Stage

Array = NDArray[np.float64]

_CLEARANCE = 0.5  # metres to the nearest surface
_TRIES = 2000


def random_point_lights(
    stage: Stage, walls: int, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw lights like lamps: half of them anywhere in the upper half of the room, half at hand.

    Parameters
    ----------
    stage
        The scene in camera space.
    walls
        How many of its first meshes are the shell; 0 = the pieces alone, with the camera's
        surroundings as room.
    count
        Number of lights N.
    rng
        Source of randomness.

    Returns
    -------
    positions : ndarray
        (N, 3) in camera space, at least 0.5 m from every surface.
    colors : ndarray
        (N, 3) linear Rec.709, the largest channel 1.

    Raises
    ------
    InputError
        If the room leaves no place for them.
    """
    around = stage.meshes[:walls] or stage.meshes
    corners = np.concatenate([mesh.vertices for mesh in around] + [np.zeros((1, 3))])
    low, high = corners.min(axis=0), corners.max(axis=0)
    positions: list[Array] = []
    for attempt in range(_TRIES * count):
        if len(positions) == count:
            break
        if attempt % 2:
            place = rng.normal(scale=(0.8, 0.5, 0.4), size=3) + np.array([0.0, 0.3, 0.0])
        else:
            place = low + (high - low) * rng.uniform([0, 0.5, 0], 1)
        if _is_free(place, stage, walls):
            positions.append(place)
    if len(positions) < count:
        raise InputError(f"world: expected room for {count} point lights, found {len(positions)}")
    return np.array(positions), random_colors((count,), rng)


def _is_free(place: Array, stage: Stage, walls: int) -> bool:
    """Whether a place is inside the shell, outside of all pieces and far enough from both.

    Every piece is convex: a point is inside if it is behind the surface at all of its vertices.
    So is the shell, and its normals point inwards.
    """
    for i, mesh in enumerate(stage.meshes):
        towards = place - mesh.vertices
        height = np.einsum("vi,vi->v", towards, mesh.normals)
        if i < walls:
            if height.min() < _CLEARANCE:
                return False
        elif height.max() < 0 or np.linalg.norm(towards, axis=-1).min() < _CLEARANCE:
            return False
    return True
