"""Rooms with furniture: the kinds of scene that this package adds to pbrfit's.

"furnished" has furniture and things on it, 20 to 38 solids, many of several paints and at least a
tenth of the picture metal. "detailed" is that room with texture maps, or with finer patterns and
relief; it averages its materials over what a pixel covers, as pictures of fine textures must be.
The same generator state gives the same geometry in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pbrfit._core import InputError
from pbrfit.synthetic.world import World
from pbrfit_evaluation.rooms.arrangement import draw_furnished
from pbrfit_evaluation.rooms.detailed import draw_detailed
from pbrfit_evaluation.rooms.textures import MaterialSet, load_textures

__all__ = ["MaterialSet", "detailed", "furnished", "load_textures"]

Textures = Path | Sequence[MaterialSet] | None


def furnished(rng: np.random.Generator, textures: Textures = None) -> World:
    """Draw a furnished room; it takes no textures."""
    if textures is not None:
        raise InputError("textures: expected the kind detailed with them, found furnished")
    return draw_furnished(rng)[0]


def detailed(rng: np.random.Generator, textures: Textures = None) -> World:
    """Draw a furnished room with texture maps, or with procedural detail."""
    sets = load_textures(textures) if isinstance(textures, Path) else textures or ()
    return draw_detailed(*draw_furnished(rng), sets, rng)
