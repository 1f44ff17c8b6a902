"""Furnished rooms: an arrangement with a material for each part of it.

A few of the materials are exchanged until metal has its share of the picture: `METAL_SHARE`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.synthetic.geometry import Primitive
from pbrfit.synthetic.stages import Stage
from pbrfit.synthetic.surfaces import Spots, Surface
from pbrfit.synthetic.world import World
from pbrfit_evaluation.rooms.arrangement import draw_room, look
from pbrfit_evaluation.rooms.coverings import MAY_BE_METAL, metal, shell_coverings, unmetal
from pbrfit_evaluation.rooms.parts import Parts

Rng = np.random.Generator

METAL_SHARE = (0.13, 0.3, 0.45)
"""Share of the picture with metallic >= 0.5, at 48 x 48 and 60 degrees: its least value is drawn
between the first two, its largest is the third."""

_PROBE = 48


def draw_furnished(rng: Rng) -> tuple[World, list[str]]:
    """Draw a furnished room with its materials.

    Returns the world, and for each piece after the walls a tag: pieces of one have one material.
    """
    stage, parts = draw_room(rng)
    by_tag: dict[str, Surface] = {}
    for part in parts:
        if part.tag not in by_tag:
            by_tag[part.tag] = part.covering(rng, part.primitive)
    covers = shell_coverings(tuple(stage.walls), rng)
    _balance(by_tag, stage, parts, rng)
    tags = [part.tag for part in parts]
    world = World(
        primitives=tuple(stage.primitives),
        surfaces=(*covers, *(by_tag[tag] for tag in tags)),
        walls=len(stage.walls),
        eye=stage.eye,
        turn=stage.turn,
    )
    return world, tags


def _balance(by_tag: dict[str, Surface], stage: Stage, parts: Parts, rng: Rng) -> None:
    """Change materials, the largest first, until metal has its share of the picture."""
    hits = look(stage, _PROBE)
    first: dict[str, Primitive] = {}
    seen: dict[str, NDArray[np.intp]] = {}
    for i, part in enumerate(parts, start=len(stage.walls)):
        if part.covering in MAY_BE_METAL:
            first.setdefault(part.tag, part.primitive)
            here = np.flatnonzero(hits.index == i)
            seen[part.tag] = np.concatenate([seen.get(part.tag, here[:0]), here])
    order = sorted(seen, key=lambda tag: (-len(seen[tag]), tag))

    def share(tag: str) -> float:
        points = hits.local[seen[tag]]
        spots = Spots(points, hits.normals[seen[tag]], np.zeros(len(points)))
        return float(np.sum(by_tag[tag].at(spots).metallic >= 0.5)) / len(hits.index)

    least = rng.uniform(*METAL_SHARE[:2])
    shares = {tag: share(tag) for tag in order}
    for tag in order:
        total = sum(shares.values())
        if total > METAL_SHARE[2] and shares[tag] > 0:
            by_tag[tag] = unmetal(rng)
        elif total < least and shares[tag] < 0.5 * len(seen[tag]) / len(hits.index):
            by_tag[tag] = metal(rng, first[tag])
        shares[tag] = share(tag)
