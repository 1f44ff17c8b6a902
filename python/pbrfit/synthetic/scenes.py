"""The kinds of scene: which stage and which surfaces make up each.

The stage (shell, pieces and camera) is drawn before the surfaces, and neither depends on the size
or the field of view of the picture: the same generator state gives the same scene in any
resolution, and "room" and "textured" share their geometry. Other packages add kinds through the
entry point group `pbrfit.scenes`: functions of the random source and of textures that give a
`World`. pbrfit-evaluation has two, "furnished" and "detailed".
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

import numpy as np

from pbrfit._core import InputError
from pbrfit.synthetic.stages import case_stage, room_stage
from pbrfit.synthetic.surfaces import case_surfaces, plain_surfaces, textured_surfaces
from pbrfit.synthetic.world import World

KINDS = ("room", "spheres", "textured")
"""Kinds that are always there."""

ADDED_KINDS = ("furnished", "detailed")
"""Kinds that pbrfit-evaluation adds."""

GROUP = "pbrfit.scenes"


def draw(kind: str, rng: np.random.Generator, textures: Any = None) -> World:
    """Draw a scene; the same state of `rng` gives the same.

    Kinds: "room", furniture of constant materials, at least a third of the pieces metal; "spheres",
    a grid, roughness growing from left to right, metal and dielectric rows; "textured", the room
    with patterns in albedo, roughness and, on some pieces, metallic. With pbrfit-evaluation also
    "furnished", a room with furniture and things on it, and "detailed", that room with texture
    maps, or with finer patterns and relief. `textures` are for kinds that take some: a folder of
    texture maps, or the sets that were read from one; None for procedural detail. Raises InputError
    when the kind is unknown, its package is not installed, or the textures cannot be used.
    """
    if kind not in KINDS:
        world = _added(kind)(rng, textures)
        assert isinstance(world, World)
        return world
    if textures is not None:
        raise InputError(f"textures: expected the kind detailed with them, found {kind}")
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


def _added(kind: str) -> Any:
    """Look up what another package draws a kind with."""
    for point in entry_points(group=GROUP, name=kind):
        return point.load()
    if kind in ADDED_KINDS:
        raise InputError(
            f"kind: {kind} is drawn by pbrfit-evaluation: pip install pbrfit-evaluation"
        )
    expected = ", ".join((*KINDS, *ADDED_KINDS))
    raise InputError(f"kind: expected one of {expected}, found {kind!r}")
