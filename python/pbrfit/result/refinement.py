"""Whether the given normals were refined together with the materials, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pbrfit.scene.scene import Scene

RefineNormals = Literal["off", "auto", "on"]

CHOICES: tuple[RefineNormals, ...] = get_args(RefineNormals)

PICTURES_MIN = 3
"""Pictures from which on normals can be refined; of fewer, materials explain almost any normal."""

FROM_PICTURES = "found from the pictures"
"""How the reason begins where no normals were given."""

CHANGE_DEGREES_MIN = 1e-4
"""Angle, in degrees, below which a normal is as given: float32 in files is 1e-5 degrees off."""


@dataclass(frozen=True)
class Refinement:
    """What was decided about the normals of a fit."""

    asked: RefineNormals
    """As it was asked for."""
    refined: bool
    """Whether the normals of the result are other ones than those that were given; where none were,
    than those that pictures told before materials were fitted."""
    why: str
    """The reason in words: what can follow a colon, without a full stop."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """What the decision rests on and what it did, by name. Names that end in `_degrees` are angles,
    those that end in `_share` shares of the valid pixels; all others are radiances in the pictures'
    unit, or numbers. Infinite and NaN ones are null in a file."""

    def with_change(self, change: NDArray[np.floating[Any]]) -> Refinement:
        """Add how far normals changed: `change` (H, W) in degrees, NaN outside the mask."""
        inside = change[np.isfinite(change)]
        return replace(
            self,
            figures={
                **self.figures,
                "mean_change_degrees": float(inside.mean()),
                "largest_change_degrees": float(inside.max()),
                "changed_share": float(np.mean(inside >= CHANGE_DEGREES_MIN)),
            },
        )

    def of_normals_from_pictures(self) -> Refinement:
        """The same where none were given, and the pictures told those to begin with."""
        then = f", then refined: {self.why}" if self.refined else ""
        return replace(self, why=f"{FROM_PICTURES}{then}")

    def in_words(self) -> str:
        """What was done and why, to follow "normals: " or "the normals were "."""
        if self.why.startswith(FROM_PICTURES):
            return self.why
        if not self.refined:
            return f"left as given: {self.why}"
        mean, largest = (
            self.figures.get(f"{which}_change_degrees", math.nan) for which in ("mean", "largest")
        )
        how_far = f" by {mean:.1f} degrees in the mean, {largest:.1f} at most"
        return f"refined{how_far if math.isfinite(mean) else ''}: {self.why}"


NOT_ASKED = Refinement("off", False, "not asked for")


def hindrance(scene: Scene) -> str | None:
    """Why the pictures of a scene cannot tell what its normals should be; None if they may.

    A normal has two unknowns, which a pixel's material can make up for in one or two pictures, even
    where the lights are known.
    """
    pictures = len(scene.images)
    if pictures >= PICTURES_MIN:
        return None
    found = "a single picture does" if pictures == 1 else f"{pictures} pictures do"
    return f"{found} not determine normals, which takes at least {PICTURES_MIN}"
