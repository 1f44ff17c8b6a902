"""The scale between lamps and albedo by a reference: some pixels whose albedo is known.

Lights that are brighter by a factor with albedos that are darker by it leave what a dielectric
reflects diffusely as it is, so that the albedo that a fit gives the reference tells the factor of
each channel. Highlights and ambient light go along only about, so it takes a few steps: first with
the pixels around the reference, then with all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.lamps.joint import JointLamps
from pbrfit.fit.lamps.surfaces import STEPS, Band
from pbrfit.fit.scale import reference_in_words, reference_region

Array = NDArray[np.float64]

SURROUNDINGS = 8
"""Rows and columns on each side of a reference that are fitted with it: what judges shadows and
metals by their neighbours sees some pixels."""

Surfaces = Callable[[NDArray[np.bool_]], list[Band]]
"""Fits the pixels of a mask (H, W) under the lights of a joint fit as it stands."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The scale that a reference tells."""

    variance: Array
    """(3,): relative, of each channel's lights."""
    said: str
    """What the scale rests on, in words."""


def refer(
    fit: JointLamps, valid: NDArray[np.bool_], white: tuple[float, float, float], surfaces: Surfaces
) -> tuple[list[Band], Reference]:
    """Surfaces of all pixels, with lights that give those at (column, row) the third as albedo.

    The lights of the joint fit change.
    """
    column, row, value = white
    own = reference_region(valid, column, row)
    rows, columns = (of[own] for of in np.nonzero(valid))
    window = np.zeros_like(valid)
    window[
        max(int(rows.min()) - SURROUNDINGS, 0) : int(rows.max()) + SURROUNDINGS + 1,
        max(int(columns.min()) - SURROUNDINGS, 0) : int(columns.max()) + SURROUNDINGS + 1,
    ] = True
    there = np.zeros_like(valid)
    there[rows, columns] = True
    moved = np.zeros(3)
    for mask in (window & valid, valid):
        for number in range(settings.WHITE_STEPS_MAX + 1):
            bands = surfaces(mask)
            albedo = np.concatenate([one.state.albedo for one in bands])[there[mask]]
            mean = np.maximum(albedo.mean(axis=0), settings.WHITE_ALBEDO_MIN)
            left = np.log(mean / value)  # by which lights are too dark
            if np.abs(left).max() < settings.WHITE_ERROR or number == settings.WHITE_STEPS_MAX:
                break
            moved += _brightened(fit, left)
    of_pixels = np.concatenate([one.variance[:, 2:5] for one in bands])[there[valid]]
    variance = of_pixels.mean(axis=0) / len(of_pixels)
    # What all pixels left of it, by the neighbours that they are judged with.
    off = variance / value**2 + settings.WHITE_TOLERANCE**2 + left**2
    return bands, Reference(off, reference_in_words(white, len(own), np.expm1(moved)))


def _brightened(fit: JointLamps, step: Array) -> Array:
    """Brighten all lights of a joint fit by the logarithm `step` (3,), bounded; what was done."""
    step = np.clip(step, -settings.SCALE_STEP_MAX, settings.SCALE_STEP_MAX)
    factor, state = np.exp(step), fit.state
    state = replace(
        state,
        lamps=replace(state.lamps, colors=state.lamps.colors * factor),
        ambient=state.ambient * factor,
        albedo=np.clip(state.albedo / factor, 0.0, 1.0),
    )
    fit.state, _ = fit.fitted(state, STEPS)
    return np.asarray(step)


def with_known_scale(covariance: Array, fit: JointLamps, variance: Array) -> Array:
    """(M, M): of the lights of a joint fit, where a reference tells the scale of each channel."""
    lamps = fit.state.lamps
    count = len(lamps)
    measures, directions = np.zeros((3, len(covariance))), np.zeros((3, len(covariance)))
    ambient = fit.state.ambient[:, 0]
    for c in range(3):
        colors = slice(3 * count + c, 6 * count, 3)
        measures[c, colors] = 1 / (count * np.maximum(lamps.colors[:, c], 1e-12))
        directions[c, colors] = lamps.colors[:, c]
        directions[c, 6 * count + c :: 3] = ambient[:, c]
    seen = covariance @ measures.T
    rest = covariance - seen @ np.linalg.pinv(measures @ seen, hermitian=True) @ seen.T
    return np.asarray(rest + directions.T @ (variance[:, None] * directions))
