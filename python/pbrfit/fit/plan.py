"""FitPlan: which parts the fit of a scene has, what is left out, and the weights chosen by rule."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.penalties import tied_neighbours
from pbrfit.fit.settings import GREY_WEIGHT, NEAR_GREY
from pbrfit.result.options import ROBUST_LOSSES, Priors, prior_names
from pbrfit.scene.scene import Scene


@dataclass(frozen=True)
class FitPlan:
    """Which parts the fit of a scene has."""

    priors: Priors
    """Weights: 0 where a prior has nothing to act on. `monochrome` is None where it waits for
    lights to be measured."""
    used: tuple[str, ...]
    """The parts, in words."""
    left_out: tuple[str, ...]
    """What a fit by default would have had, but the scene did not need or the options ruled out, in
    words."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        layout: ParameterLayout,
        *,
        priors: Priors | None = None,
        robust: str = "none",
        uncertainty: bool = True,
        lighting: NDArray[np.float64] | None = None,
    ) -> FitPlan:
        """Of a fit with these options, as given to `decompose`.

        By `lighting` (N, ..., 3), that of a fit without priors, an automatic weight is chosen.
        """
        given = Priors.none() if priors is None else priors
        idle = _idle_priors(layout, given, lighting)
        chosen = replace(given, **dict.fromkeys(idle, 0.0))
        chosen = replace(chosen, material=chosen.material_strength)
        if chosen.monochrome is None and lighting is not None:
            chosen = replace(chosen, monochrome=GREY_WEIGHT)
        return cls(
            priors=chosen,
            used=tuple(_used(layout, chosen, robust, uncertainty)),
            left_out=(
                *_data_left_out(scene, layout),
                *_unknowns_left_out(scene, layout),
                *_priors_left_out(priors, idle),
                *(() if uncertainty else ("uncertainty: not asked for",)),
            ),
        )


def color_deviation(lighting: NDArray[np.float64]) -> float:
    """How far lights (..., 3) are from grey: √(Σ (L − L̄)² / Σ L²), L̄ the mean over channels.

    0 where all channels are equal, 0.82 where there is light in one channel only.
    """
    largest = np.abs(lighting).max()
    if not largest:
        return 0.0
    lighting = lighting / largest  # squares of lights in picture units may overflow
    deviation = lighting - lighting.mean(axis=-1, keepdims=True)
    return float(np.sqrt(np.square(deviation).sum() / np.square(lighting).sum()))


def _idle_priors(
    layout: ParameterLayout, priors: Priors, lighting: NDArray[np.float64] | None
) -> dict[str, str]:
    """Names of priors that are asked for but cannot or must not act, with the reason."""
    idle = {}
    if priors.cohesion and not layout.segment_count:
        idle["cohesion"] = "no pixel has a segment"
    if priors.smoothness and not tied_neighbours(layout).size:
        idle["smoothness"] = "no two neighbours that could be alike"
    if priors.sparsity and layout.metallic is None:
        idle["sparsity"] = "metallic is given"
    if priors.monochrome is None or priors.monochrome > 0:
        if layout.lighting is None:
            idle["monochrome"] = "lights are known"
        elif layout.light_channels == 1:
            idle["monochrome"] = "lights have one channel"
    if priors.monochrome is None and lighting is not None and "monochrome" not in idle:
        found = color_deviation(lighting)
        if found > NEAR_GREY:
            idle["monochrome"] = f"lights are {found:.2g} off grey, above {NEAR_GREY:g}"
    return idle


def _used(layout: ParameterLayout, priors: Priors, robust: str, uncertainty: bool) -> Iterator[str]:
    weighted = ", with weights" if layout.weighted else ""
    yield f"{layout.pixels} pixels of {layout.pictures} pictures{weighted}"
    yield "albedo in three channels" if layout.channels == 3 else "albedo in one channel"
    yield "roughness"
    if layout.metallic is not None:
        yield "metallic"
    if layout.lighting is not None:
        channels = "three channels" if layout.light_channels == 3 else "one channel"
        yield f"lights of order {layout.sh_order} in {channels}"
    if priors.material:
        groups = layout.segment_count or 1
        segments = "one segment" if groups == 1 else f"{groups} segments"
        yield f"prior material, weight {priors.material:g}: learnt for {segments}"
    for name in ("cohesion", "smoothness", "sparsity", "monochrome"):
        weight = getattr(priors, name)
        if weight:
            yield f"prior {name}, weight {weight:g}"
        elif weight is None:
            yield f"prior {name}, if the fitted lights are near grey"
    if robust in ROBUST_LOSSES:
        yield f"robust loss: {robust}"
    if uncertainty:
        yield "uncertainty"


def _data_left_out(scene: Scene, layout: ParameterLayout) -> Iterator[str]:
    masked = 0 if scene.mask is None else int(np.count_nonzero(~scene.mask))
    if masked:
        yield f"{masked} pixels outside the mask"
    without = scene.valid.size - masked - layout.pixels
    if without:
        bounded = "" if scene.limits is None else " or at limits"
        yield f"{without} pixels of weight 0{bounded} in all pictures"
    if scene.limits is not None:
        values = sum(int(np.count_nonzero(of[scene.valid])) for of in scene.limits)
        yield f"{values} values at a limit"
    if scene.weights is None:
        return
    single = int(np.count_nonzero(scene.weights[:, scene.valid] == 0))
    if single:
        yield f"{single} values of weight 0 at other pixels"


def _unknowns_left_out(scene: Scene, layout: ParameterLayout) -> Iterator[str]:
    if layout.channels == 1:
        yield "second and third colour channel: equal to the first"
    elif layout.light_channels == 1 and layout.lighting is not None:
        yield "colour of the lights: one light for all channels was asked for"
    if layout.sh_order < 3:
        known = scene.lighting is not None
        why = "the known lights have none" if known else "order 2 was asked for"
        yield f"band 3 of the lights: {why}"
    if layout.metallic is None:
        yield "metallic: given, so it was not fitted"
    if layout.lighting is None:
        yield "lights and their gradient: known, so only materials were fitted"


def _priors_left_out(priors: Priors | None, idle: dict[str, str]) -> Iterator[str]:
    if priors is None or priors == Priors.none():
        yield "priors: none asked for"
        return
    for name in prior_names():
        ruled_out = getattr(priors, name) == 0 and getattr(Priors(), name) != 0
        if ruled_out:
            yield f"prior {name}: weight 0"
        elif name in idle:
            yield f"prior {name}: {idle[name]}"
