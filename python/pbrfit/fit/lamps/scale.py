"""The scale between lamps and albedo: how uncertain highlights leave it, or by a reference.

**By highlights.** S is what a joint fit knows of the lights, pixels eliminated, C = S⁻¹, and
t = a · (change of the lights) the relative change of the lamps' colours c, a = c/|c|². Samples
with independent errors give t the variance aᵀ C a. But what is wrong with highlights is shared by
the pixels around them. Blocks b, of scores s_b, want to move the scale by u_b = −a C s_b, so that

    variance = aᵀ C a + (Σ u_b)² + B/(B − 1) Σ (u_b − ū)²

Steps leave the scale as it is until next to nothing is left (`Freedom.scale`), so Σ u_b, which is
how far a step would take it, need not be 0. The last term is the variance of such sums (P. J.
Huber, 1967).

Albedos of pictures tell the scale, too: ln t ~ N(0, s²). Where both differ by d, more than v + s²,
one is wrong by τ, τ² = d² − v − s² (J. Mandel, R. Paule, 1970: the variance between measurements),
and t by |exp(∓τ) − 1|: an albedo that is found too dark may be many times as bright.

**By a reference.** Lights that are brighter by a factor with albedos that are darker by it leave
what a dielectric reflects diffusely as it is, so that the albedo that a fit gives pixels of known
albedo tells the factor of each channel. Highlights and ambient light go along only about, so it
takes a few steps: first with the pixels around the reference, then with all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.fit import settings
from pbrfit.fit.lamps.joint import ALBEDO_SPREAD, JointLamps
from pbrfit.fit.lamps.samples import blocks_of
from pbrfit.fit.lamps.surfaces import STEPS, Band
from pbrfit.fit.scale import reference_in_words, reference_region
from pbrfit.values.arrays import Array, Mask

SURROUNDINGS = 8
"""Rows and columns on each side of a reference that are fitted with it: what judges shadows and
metals by their neighbours sees some pixels."""

Surfaces = Callable[[Mask], list[Band]]
"""Fits the pixels of a mask (H, W) under the lights of a joint fit as it stands."""


def measure(fit: JointLamps) -> Array:
    """(M,): a, of all that pixels share."""
    lamps = fit.state.lamps
    found = np.zeros(6 * len(lamps) + 3 * fit.pixels.pictures)
    size = max(float(np.square(lamps.colors).sum()), np.finfo(np.float64).tiny)
    found[3 * len(lamps) : 6 * len(lamps)] = lamps.colors.ravel() / size
    return found


def deviation(fit: JointLamps, covariance: Array) -> float:
    """Relative, of the lamps with a covariance (M, M)."""
    a = measure(fit)
    return float(np.sqrt(np.maximum(a @ covariance @ a, 0.0)))


def with_pulls(covariance: Array, fit: JointLamps, width: int) -> Array:
    """The covariance (M, M) of a fit's lights, with what blocks of pictures of a width do."""
    a = measure(fit)
    seen = covariance @ a
    own = float(a @ seen)
    if not own > 0:  # known colours
        return covariance
    _, blocks = np.unique(blocks_of(np.divmod(fit.pixels.places, width)), return_inverse=True)
    count = int(blocks.max()) + 1
    each, of_priors = fit.scores(seen)
    pulls = np.bincount(blocks, each, count)
    more = float(pulls.sum() + of_priors) ** 2
    if count >= settings.PATCHES_MIN:
        more += count / (count - 1) * float(np.square(pulls - pulls.mean()).sum())
    apart = ALBEDO_SPREAD * float(fit.scale_of(fit.state.lamps)[0])
    between = np.sqrt(max(apart**2 - own - more - ALBEDO_SPREAD**2, 0.0))
    more += float(np.expm1(np.copysign(between, apart))) ** 2
    return covariance + more / own**2 * np.outer(seen, seen)


@dataclass(frozen=True, eq=False)
class Reference:
    """The scale that a reference tells."""

    variance: Array
    """(3,): relative, of each channel's lights."""
    said: str
    """What the scale rests on, in words."""


def refer(
    fit: JointLamps, valid: Mask, white: tuple[float, float, float], surfaces: Surfaces
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
