"""Depth of scenes whose geometry is known: beside the scene as long as `Scene` has no such field.

Once it has one, `with_depth` and `depth_of` are `replace(scene, depth=depth)` and `scene.depth`.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pbrfit.scene.scene import Scene

Depth = NDArray[np.float32]
"""(H, W): distance from the camera along its axis; NaN = unknown."""

OF_SCENES = "depth" in {one.name for one in fields(Scene)}
"""Whether scenes have the field."""

_BESIDE: WeakKeyDictionary[Scene, Depth] = WeakKeyDictionary()


def with_depth(scene: Scene, depth: NDArray[np.floating[Any]] | None) -> Scene:
    """Return the same scene with this depth; with None, without any."""
    if OF_SCENES:
        return replace(scene, depth=depth)  # type: ignore[call-arg]
    made = replace(scene)
    if depth is not None:
        _BESIDE[made] = depth.astype(np.float32)
    return made


def depth_of(scene: Scene) -> Depth | None:
    """Depth that a scene was given; None = none."""
    found: Depth | None = getattr(scene, "depth", None) if OF_SCENES else _BESIDE.get(scene)
    return found
