"""From which sides pictures are lit, in words."""

from __future__ import annotations

import numpy as np

from pbrfit.model.geometry import unit
from pbrfit.values.arrays import Array, Floats

ONE_SIDE = 0.9
"""Length of the mean of the directions that light comes from, above which it comes from one side:
all within about 25 degrees of their middle."""

ASIDE = 0.26
"""Component from which on a direction counts for a side: sine of 15 degrees off the view's axis."""


def main_directions(lighting: Floats) -> Array:
    """(N, 3): unit vectors to where most light of each picture (N, K, 3) comes from."""
    of_light, tiny = np.asarray(lighting, np.float64), np.finfo(np.float64).tiny
    directions = (of_light / max(np.abs(of_light).max(), tiny))[:, [3, 1, 2]].mean(axis=-1)  # xyz
    return unit(directions, tiny)


def one_side(directions: Floats) -> tuple[str, str] | None:
    """The side that directions (N, 3) come from, and the opposite one; None where there are more.

    Only what is across the view has an opposite side that a lamp can be carried to; of light from
    the camera these are "the sides".
    """
    middle = directions.mean(axis=0)
    if not float(np.linalg.norm(middle)) > ONE_SIDE:
        return None
    side, opposite = _across(*middle[:2]), _across(*-middle[:2])
    if side:
        return side, opposite
    return ("the camera", "the sides") if middle[2] > 0 else ("behind", "the camera's side")


def unlit_sides(directions: Floats) -> list[str]:
    """Sides from which none of the directions (N, 3) comes; below is no place for a lamp."""
    most = {
        "the left": -directions[:, 0].min(),
        "the right": directions[:, 0].max(),
        "above": directions[:, 1].max(),
    }
    return [side for side, component in most.items() if component < ASIDE]


def _across(x: float, y: float) -> str:
    """A direction in the plane of the picture; empty where it is close to the camera's axis."""
    horizontal = "" if abs(x) < ASIDE else "left" if x < 0 else "right"
    vertical = "" if abs(y) < ASIDE else "lower" if y < 0 else "upper"
    if horizontal:
        return f"the {vertical} {horizontal}" if vertical else f"the {horizontal}"
    return {"upper": "above", "lower": "below", "": ""}[vertical]
