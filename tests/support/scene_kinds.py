"""Every kind of problem that a scene can be made: fewer unknowns, other weights, known lights."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import Objective, Scene
from scene_files import truth_of


def weighted(scene: Scene) -> Scene:
    """Samples count from 0.2 to 1, and a tenth of them nothing."""
    rng = np.random.default_rng(0)
    weights = rng.uniform(0.2, 1, scene.images.shape[:3])
    weights[rng.random(weights.shape) < 0.1] = 0
    return dataclasses.replace(scene, weights=weights)


def grey(scene: Scene) -> Scene:
    """All channels are the red one."""
    images = np.repeat(scene.images[..., :1], 3, axis=-1)
    return dataclasses.replace(scene, images=images, truth=None)


def known_lights(scene: Scene) -> Scene:
    """Those of the truth."""
    return dataclasses.replace(scene, lighting=truth_of(scene).lighting)


def same(scene: Scene) -> Scene:
    """No change."""
    return scene


KINDS: dict[str, tuple[Callable[[Scene], Scene], dict[str, Any]]] = {
    "colour": (same, {}),
    "order 2": (same, {"sh_order": 2}),
    "known metallic": (same, {"metallic": 0.3}),
    "mono light": (same, {"mono_light": True}),
    "weights": (weighted, {}),
    "grey": (grey, {}),
    "known lights": (known_lights, {}),
}
"""How a scene is changed, and options of `Objective` and `decompose`."""

ALL_KINDS = KINDS | {
    "grey, weights, order 2, known metallic": (
        lambda scene: weighted(grey(scene)),
        {"sh_order": 2, "metallic": 0.0},
    ),
    "weights, known lights, known metallic": (
        lambda scene: weighted(known_lights(scene)),
        {"metallic": 0.4},
    ),
    "mono light, order 2": (same, {"mono_light": True, "sh_order": 2}),
}
"""And some of these together."""

FREE_LIGHTS = tuple(kind for kind in KINDS if kind != "known lights")


def of_kind(scene: Scene, kind: str) -> tuple[Scene, dict[str, Any]]:
    """The scene as that kind of problem, and the options."""
    change, options = ALL_KINDS[kind]
    return change(scene), options


def objective_of(scene: Scene, kind: str) -> Objective:
    """The objective of the scene as that kind of problem."""
    changed, options = of_kind(scene, kind)
    return Objective(changed, **options)


def at_truth(objective: Objective, scene: Scene) -> NDArray[np.float64]:
    """X of the true materials and lights."""
    maps = truth_of(scene).materials
    return objective.pack(maps.albedo, maps.roughness, maps.metallic, truth_of(scene).lighting)


def all_pixels(objective: Objective) -> NDArray[np.uint64]:
    """Their indices."""
    return np.arange(objective.pixels, dtype=np.uint64)


def sum_sq_at(objective: Objective, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Σ ω (I − T)² of each pixel (P,) at x, from its normal equations."""
    return objective.problem.normal_equations(objective.for_core(x), all_pixels(objective))[2]


def holed(height: int, width: int) -> NDArray[np.bool_]:
    valid = np.ones((height, width), bool)
    valid[1, 1:-1] = valid[2:4, 2] = False
    return valid


def with_entry(array: NDArray[Any], value: float) -> Any:
    """The array with another last entry."""
    changed = array.copy()
    changed.reshape(-1)[-1] = value
    return changed
