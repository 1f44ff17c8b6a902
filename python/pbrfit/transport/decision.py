"""What a fit decided about surroundings, and what it supposed: data that a result keeps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

Kind = Literal["none", "occlusion", "bounce"]
"""Whether surroundings do nothing, block light, or also bring the light that they reflect."""


@dataclass(frozen=True)
class Extents:
    """What no picture shows, in units of the median depth."""

    thickness: float
    """Of things seen from the front, at most."""
    height: float | None
    """Of walls above the floor, or above the lowest point where no floor is seen; a wall that is
    seen higher up is higher. None = as far as they are seen."""
    behind: float | None
    """Distance of the wall behind the camera; None = open."""
    ceiling: bool
    """Whether it is closed above."""
    blocks: tuple[bool, ...]
    """For each wall that was found, whether it blocks light."""
    reach: float
    """How far a wall goes on beyond what is seen of it where no other wall ends it, and floor and
    walls behind the camera where no wall is there."""


def candidates(extents: Extents) -> Iterator[Extents]:
    """Neighbours of extents that a search may try: one thing changed in each."""
    for factor in (0.5, 2.0):
        yield replace(extents, thickness=factor * extents.thickness)
    if extents.height is not None:
        for factor in (0.8, 1.25):
            yield replace(extents, height=factor * extents.height)
        yield replace(extents, ceiling=not extents.ceiling)
    if extents.behind is not None:
        for factor in (0.6, 1.6):
            yield replace(extents, behind=factor * extents.behind)
        yield replace(extents, behind=None, reach=extents.behind)
    elif extents.height is not None:
        yield replace(extents, behind=extents.reach)
    if extents.behind is None and extents.blocks:
        for factor in (0.6, 1.6):
            yield replace(extents, reach=factor * extents.reach)
    for i, blocks in enumerate(extents.blocks):
        changed = (*extents.blocks[:i], not blocks, *extents.blocks[i + 1 :])
        yield replace(extents, blocks=changed)


@dataclass(frozen=True)
class Transport:
    """What a fit decided about surroundings, and why."""

    kind: Kind = "none"
    why: str = "no depth is given"
    extents: Extents | None = None
    figures: Mapping[str, float] = field(default_factory=dict)
    """Mean of ln(residual²/radiance²) of pixels that lights were not fitted to:
    `left_out_occlusion`, `left_out_bounce`, as far as they were tried, and `left_out_pixels`."""

    @property
    def blocks(self) -> bool:
        """Whether surroundings do anything."""
        return self.kind != "none"


NOT_TRIED = Transport()
"""The decision about a scene without depth."""
