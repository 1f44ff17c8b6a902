"""The kinds of scene: which stage and which surfaces make up each.

The stage (shell, pieces and camera) is drawn before the surfaces, and neither depends on the size
or the field of view of the picture: the same generator state gives the same scene in any
resolution, and "room" and "textured" share their geometry.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from pbrfit._core import InputError
from pbrfit.synthetic.furnished import draw_furnished
from pbrfit.synthetic.stages import case_stage, room_stage
from pbrfit.synthetic.surfaces import case_surfaces, plain_surfaces, textured_surfaces
from pbrfit.synthetic.world import RayCast, World

SceneKind = Literal["room", "spheres", "textured", "furnished"]


def draw(kind: SceneKind, rng: np.random.Generator) -> World:
    """Draw a scene.

    Parameters
    ----------
    kind
        "room": furniture of constant materials, at least a third of the pieces metal.
        "spheres": a grid, roughness growing from left to right, metal and dielectric rows.
        "textured": the room with patterns in albedo, roughness and, on some pieces, metallic.
    rng
        Source of randomness; the same state gives the same scene.

    Returns
    -------
    World

    Raises
    ------
    InputError
        When `kind` is unknown.
    """
    if kind not in get_args(SceneKind):
        raise InputError(f"kind: expected one of {', '.join(get_args(SceneKind))}, found {kind!r}")
    if kind == "furnished":
        return draw_furnished(rng).world
    if kind == "spheres":
        columns, rows = rng.integers(4, 6, size=2)
        stage = case_stage(rows, columns, rng)
        surfaces = case_surfaces(rows, columns, rng)
    else:
        stage = room_stage(rng)
        cover = textured_surfaces if kind == "textured" else plain_surfaces
        surfaces = cover(len(stage.pieces), rng)
    return World(
        primitives=tuple(stage.primitives),
        surfaces=tuple(surfaces),
        walls=len(stage.walls),
        eye=stage.eye,
        turn=stage.turn,
    )


def build(kind: SceneKind, size: int, rng: np.random.Generator, fov: float = 60.0) -> RayCast:
    """Draw a scene and cast one ray through every pixel centre: `draw`, then `World.cast`.

    Parameters
    ----------
    kind
        As for `draw`.
    size
        Width and height of the picture in pixels.
    rng
        Source of randomness; the same state gives the same scene at every size.
    fov
        Horizontal field of view in degrees, 0 < fov < 180.

    Returns
    -------
    RayCast
        Every pixel valid (`mask` None) and facing the camera.

    Raises
    ------
    InputError
        When `kind` is unknown, `size` is below 1, or `fov` is outside its range.
    """
    return draw(kind, rng).cast(size, fov)
