"""Priors: what is thought likely of materials and lights, as penalties beside the data term."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.sampling import pairs_apart, pixel_index
from pbrfit.fit.settings import GREY_WEIGHT, NEAR_GREY
from pbrfit.result.options import Priors
from pbrfit.values.arrays import Array

SMOOTHNESS_STEP = 0.01
"""Share of the picture's side over which differences of neighbours are taken; see `smoothness`."""


class Penalty(Protocol):
    """A term of the objective beside the data."""

    @property
    def name(self) -> str:
        """Of the prior that it belongs to."""

    def value_and_grad(self, x: Array, gradient: Array) -> float:
        """Value at x; its gradient is added to `gradient`, (size,) like x."""


def penalties(layout: ParameterLayout, priors: Priors) -> list[Penalty]:
    """Penalties of weight above 0 that have something to act on.

    The mixture prior on materials is none of them: it changes while a fit runs. Nor is a monochrome
    weight that is to be chosen.
    """
    made: dict[str, Callable[[ParameterLayout, float], Penalty]] = {
        "cohesion": cohesion,
        "smoothness": smoothness,
        "sparsity": sparsity,
        "monochrome": Monochrome,
    }
    idle = idle_priors(layout, priors)
    weights = {name: getattr(priors, name) for name in made if name not in idle}
    return [made[name](layout, weight) for name, weight in weights.items() if weight]


def idle_priors(
    layout: ParameterLayout, priors: Priors, lighting: Array | None = None
) -> dict[str, str]:
    """Names of priors that are asked for but cannot or must not act, with the reason.

    `lighting` as for `chosen_priors`.
    """
    idle = {}
    if priors.cohesion and not layout.segment_count:
        idle["cohesion"] = "no pixel has a segment"
    if priors.smoothness and not tied_neighbours(layout).size:
        idle["smoothness"] = "no two neighbours that could be alike"
    if priors.sparsity and layout.metallic is None:
        idle["sparsity"] = "metallic is given"
    if priors.monochrome != 0:
        if layout.lighting is None:
            idle["monochrome"] = "lights are known"
        elif layout.light_channels == 1:
            idle["monochrome"] = "lights have one channel"
        elif priors.monochrome is None and lighting is not None:
            found = color_deviation(lighting)
            if found > NEAR_GREY:
                idle["monochrome"] = f"coloured lights, {found:.2g} from grey, above {NEAR_GREY:g}"
    return idle


def chosen_priors(layout: ParameterLayout, priors: Priors, lighting: Array | None = None) -> Priors:
    """Weights, 0 where a prior has nothing to act on.

    An automatic weight of `monochrome` is chosen by `lighting` (N, ..., 3), that of a fit without
    it; None until that is known.
    """
    chosen = replace(priors, **dict.fromkeys(idle_priors(layout, priors, lighting), 0.0))
    chosen = replace(chosen, material=chosen.material_strength)
    if chosen.monochrome is None and lighting is not None:
        chosen = replace(chosen, monochrome=GREY_WEIGHT)
    return chosen


def color_deviation(lighting: Array) -> float:
    """How far lights (..., 3) are from grey: √(Σ (L − L̄)² / Σ L²), L̄ the mean over channels.

    0 where all channels are equal, 0.82 where there is light in one channel only.
    """
    largest = np.abs(lighting).max()
    if not largest:
        return 0.0
    lighting = lighting / largest  # squares of lights in picture units may overflow
    deviation = lighting - lighting.mean(axis=-1, keepdims=True)
    return float(np.sqrt(np.square(deviation).sum() / np.square(lighting).sum()))


@dataclass(frozen=True)
class _OnMaps:
    """A multiple of a sum over roughness and metallic."""

    name: str
    factor: float
    blocks: tuple[slice, ...]
    sum_of: Callable[[Array], tuple[float, Array]]
    """Of one map, (P,): the sum, and half of its gradient."""

    def value_and_grad(self, x: Array, gradient: Array) -> float:
        """See `Penalty`."""
        total = 0.0
        for block in self.blocks:
            of_map, half_slope = self.sum_of(x[block])
            gradient[block] += 2 * self.factor * half_slope
            total += self.factor * of_map
        return total


def cohesion(layout: ParameterLayout, weight: float) -> Penalty:
    """Roughness and metallic near the mean of their segment.

    w/P Σ_i (v_i − v̄_s(i))² for v = r and v = m, over the classified pixels i. P counts all valid
    pixels, as in the data term, so that what a pixel feels beside its own data does not depend on
    how many others are classified.

    The mean moves with its pixels, but contributes nothing to the gradient:

        ∂/∂v_j Σ_i (v_i − v̄)² = 2 (v_j − v̄) − 2 ∂v̄/∂v_j Σ_i (v_i − v̄),  where Σ_i (v_i − v̄) = 0.

    A segment of one pixel is its own mean and gives 0.
    """
    assert layout.segments is not None
    segments = layout.segments.astype(np.int64)
    counts = np.maximum(np.bincount(segments), 1)

    def squares(values: Array) -> tuple[float, Array]:
        deviations = values - (np.bincount(segments, values) / counts)[segments]
        deviations[segments == 0] = 0
        return float(np.square(deviations).sum()), deviations

    return _OnMaps("cohesion", weight / layout.pixels, layout.roughness_metallic, squares)


def smoothness(layout: ParameterLayout, weight: float) -> Penalty:
    """Little change of roughness and metallic between neighbours.

    In the plane, ∫ |∇v|² dA has no unit of length, and its discrete form is Σ_edges (v_i − v_j)²
    over 4-connected neighbours: a finer picture has more edges with smaller differences, and the
    sum stays. The data term is a mean, an integral over the valid area divided by that area. So
    with a fixed weight the sum, not the mean over edges, tends to a fixed problem as pictures get
    finer: what is smoothed over is a fixed share of the picture, not a fixed number of pixels.

    To give the weight a size like that of the others, the picture's side √P is the unit of length
    and differences are taken over a hundredth of it, ε = 0.01:

        w/P Σ_i |ε √P ∇v_i|² = w ε² Σ_edges (v_i − v_j)²

    for v = r and v = m. Albedo is left alone: textures are mostly in albedo.

    Neighbours in different segments are not tied; an unclassified pixel is tied to all of its
    neighbours. Pixels outside the mask have no edges.
    """
    first, second = tied_neighbours(layout)

    def squares(values: Array) -> tuple[float, Array]:
        changes = values[second] - values[first]
        inwards = np.zeros(layout.pixels)
        inwards += np.bincount(second, changes, layout.pixels)
        inwards -= np.bincount(first, changes, layout.pixels)
        return float(np.square(changes).sum()), inwards

    factor = weight * SMOOTHNESS_STEP**2
    return _OnMaps("smoothness", factor, layout.roughness_metallic, squares)


def sparsity(layout: ParameterLayout, weight: float) -> Penalty:
    """Little metal: w/P Σ_i |m_i|, which is linear because metallic is never negative."""
    assert layout.metallic is not None
    half_slope = np.full(layout.pixels, 0.5)
    return _OnMaps(
        "sparsity",
        weight / layout.pixels,
        (layout.metallic,),
        lambda metallic: (float(metallic.sum()), half_slope),
    )


class Monochrome:
    """Grey lights: w/(N K C) Σ (L_nkc − L̄_nk)², with the mean L̄ over the channels.

    Lights are in units of the scene scale, as in x, so that exposure does not matter. The mean
    drops out of the gradient as in `cohesion`.
    """

    name = "monochrome"

    def __init__(self, layout: ParameterLayout, weight: float) -> None:
        assert layout.lighting is not None
        self.weight = weight
        self._block = layout.lighting
        self._channels = layout.light_channels
        self._factor = weight / (self._block.stop - self._block.start)

    def value_and_grad(self, x: Array, gradient: Array) -> float:
        """See `Penalty`."""
        lights = x[self._block].reshape(-1, self._channels)
        deviations = lights - lights.mean(axis=-1, keepdims=True)
        gradient[self._block] += 2 * self._factor * deviations.ravel()
        return float(self._factor * np.square(deviations).sum())


def tied_neighbours(layout: ParameterLayout) -> NDArray[np.int64]:
    """(2, E) pairs of valid pixels, below one another or side by side, by their index in a plane.

    Both pixels are in the same segment, or one of them is unclassified.
    """
    found = np.concatenate(pairs_apart(pixel_index(layout.valid))[::-1], axis=1)
    if layout.segments is None:
        return found
    a, b = layout.segments[found]
    return found[:, (a == b) | (a == 0) | (b == 0)]
