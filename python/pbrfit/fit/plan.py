"""Which priors act in the fit of a scene, and what of a fit by default is left out, in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.penalties import idle_penalties
from pbrfit.fit.settings import GREY_WEIGHT, NEAR_GREY
from pbrfit.result.options import Priors, prior_names
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]


def chosen_priors(layout: ParameterLayout, priors: Priors, lighting: Array | None = None) -> Priors:
    """Weights, 0 where a prior has nothing to act on.

    An automatic weight of `monochrome` is chosen by `lighting` (N, ..., 3), that of a fit without
    it; None until that is known.
    """
    chosen = replace(priors, **dict.fromkeys(_idle(layout, priors, lighting), 0.0))
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


def _idle(layout: ParameterLayout, priors: Priors, lighting: Array | None) -> dict[str, str]:
    """Names of priors that are asked for but cannot or must not act, with the reason."""
    idle = idle_penalties(layout, priors)
    if priors.monochrome is None and lighting is not None and "monochrome" not in idle:
        found = color_deviation(lighting)
        if found > NEAR_GREY:
            idle["monochrome"] = f"coloured lights, {found:.2g} from grey, above {NEAR_GREY:g}"
    return idle


def left_out(
    scene: Scene,
    layout: ParameterLayout,
    priors: Priors,
    *,
    uncertainty: bool = True,
    lighting: Array | None = None,
) -> Iterator[str]:
    """What the scene did not need or the options ruled out, in words; `lighting` as above."""
    masked = 0 if scene.mask is None else int(np.count_nonzero(~scene.mask))
    if masked:
        yield f"{masked} pixels outside the mask"
    without = scene.valid.size - masked - layout.pixels
    if without:
        yield f"{without} pixels without a usable sample"
    if scene.limits is not None:
        counted = ... if scene.all_valid else scene.valid
        exposed = sum(np.count_nonzero(of[counted]) for of in scene.limits)
        yield f"{exposed:,} over- or underexposed values"
    if scene.weights is not None:
        single = int(np.count_nonzero(scene.weights[:, scene.valid] == 0))
        if single:
            yield f"{single} values of weight 0 at other pixels"
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
    if priors == Priors.none():
        yield "priors: none asked for"
    else:
        idle = _idle(layout, priors, lighting)
        for name in prior_names():
            if getattr(priors, name) == 0 and getattr(Priors(), name) != 0:
                yield f"prior {name}: weight 0"
            elif name in idle:
                yield f"prior {name}: {idle[name]}"
    if not uncertainty:
        yield "uncertainty: not asked for"
