"""The kinds of scene: which stage and which surfaces make up each.

The stage (shell, pieces and camera) is drawn before the surfaces, and neither depends on the size
or the field of view of the picture: the same generator state gives the same scene in any
resolution, "room" and "textured" share their geometry, and so do "furnished" and "detailed". Only
"detailed" averages its materials over what a pixel covers, as pictures of fine textures must be.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from pbrfit._core import InputError
from pbrfit.synthetic.detailed import draw_detailed
from pbrfit.synthetic.furnished import draw_furnished
from pbrfit.synthetic.stages import case_stage, room_stage
from pbrfit.synthetic.surfaces import case_surfaces, plain_surfaces, textured_surfaces
from pbrfit.synthetic.textures import MaterialSet, load_textures
from pbrfit.synthetic.world import RayCast, World

SceneKind = Literal["room", "spheres", "textured", "furnished", "detailed"]


def draw(
    kind: SceneKind, rng: np.random.Generator, textures: Path | Sequence[MaterialSet] | None = None
) -> World:
    """Draw a scene.

    Parameters
    ----------
    kind
        "room": furniture of constant materials, at least a third of the pieces metal.
        "spheres": a grid, roughness growing from left to right, metal and dielectric rows.
        "textured": the room with patterns in albedo, roughness and, on some pieces, metallic.
        "furnished": a room with furniture and things on it, 20 to 38 solids, many of several
        paints and at least a tenth of the picture metal.
        "detailed": that room with texture maps, or with finer patterns and relief.
    rng
        Source of randomness; the same state gives the same scene.
    textures
        For "detailed" alone: a folder of texture maps (see `load_textures`), or the sets that
        were read from one. None for procedural detail.

    Returns
    -------
    World

    Raises
    ------
    InputError
        When `kind` is unknown, or the textures cannot be used.
    """
    if kind not in get_args(SceneKind):
        raise InputError(f"kind: expected one of {', '.join(get_args(SceneKind))}, found {kind!r}")
    if textures is not None and kind != "detailed":
        raise InputError(f"textures: expected the kind detailed with them, found {kind}")
    if kind == "furnished":
        return draw_furnished(rng).world
    if kind == "detailed":
        sets = load_textures(textures) if isinstance(textures, Path) else textures or ()
        return draw_detailed(draw_furnished(rng), sets, rng)
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


def build(
    kind: SceneKind,
    size: int,
    rng: np.random.Generator,
    fov: float = 60.0,
    textures: Path | Sequence[MaterialSet] | None = None,
) -> RayCast:
    """Draw a scene and cast one ray through every pixel centre: `draw`, then `World.cast`.

    Parameters
    ----------
    kind, textures
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
        When `kind` is unknown, the textures cannot be used, `size` is below 1, or `fov` is outside
        its range.
    """
    return draw(kind, rng, textures).cast(size, fov)
