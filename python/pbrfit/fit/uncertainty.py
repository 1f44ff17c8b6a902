"""Uncertainty: the posterior of each value of a fit, as deviations and intervals.

A pixel's samples are off by the variance v of `pbrfit.fit.discrepancy`. Roughness and metallic have
the covariance V of their posterior on a grid (`pbrfit.fit.priors.posterior`), where likelihoods
have the power η, and of the rest what their own curvature says, with albedo solved for:

    C = (V⁻¹ + (1 − η) h/v)⁻¹            h = A_vv − A_vρ A_ρρ⁻¹ A_ρv
    albedo: v A_ρρ⁻¹ + K C Kᵀ            K = −A_ρρ⁻¹ A_ρv

A is the Gauss–Newton matrix of the sum of squares, with the precision of a weak prior. To the
diagonal come

- of albedo what the model does not have: shade that surfaces cast is much the same in all pictures,
  and albedo takes it up whole, so that σ of misfit over the mean radiance is its relative error (of
  the mean albedo where a pixel has less: what is dark may be so by shade);
- the moves with the lights, v_noise Σ (C Bᵀ m / v)² over their modes m;
- the scale's deviation σ_s: albedo goes with its inverse, and roughness and metallic move by
  A⁻¹ Bᵀ L σ_s, because a highlight that is F₀ = 0.04 strong is a scale of its own.

Values on a bound are not held there: their deviation is what they may be off on the other side.
docs/uncertainty.md says what was measured.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.discrepancy import Discrepancy, prior_precision
from pbrfit.fit.normal_equations import RIDGE
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.pixels import taken
from pbrfit.fit.priors.population import (
    LOG_ALBEDO_DEVIATION,
    METALLIC_DEVIATION,
    ROUGHNESS_DEVIATION,
)
from pbrfit.fit.priors.posterior import Distributions, Grid, Posterior
from pbrfit.fit.sampling import Pixels, slices
from pbrfit.model.materials import Materials
from pbrfit.result.uncertainty import TWO_SIDED, Uncertainty
from pbrfit.result.verdict import by_deviations
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array, Floats


@dataclass(frozen=True, eq=False)
class Spread:
    """The posteriors of the unknowns of pixels, (P, D) each, but for the common scale.

    `by_scale` (P, F): squares of what roughness and metallic move by when the scale does, per
    square of its relative change.
    """

    value: Floats
    variance: Floats
    low: Floats
    high: Floats
    by_scale: Floats

    @classmethod
    def empty(cls, pixels: int, unknowns: int, channels: int) -> Spread:
        """To be filled, in float32."""
        by_scale = np.zeros((pixels, unknowns - channels), np.float32)
        value, variance, low, high = np.zeros((4, pixels, unknowns), np.float32)
        return cls(value, variance, low, high, by_scale)

    def put(self, pixels: NDArray[np.intp] | slice, other: Spread, of_other: Any = ...) -> None:
        """Give some pixels what some of another's have."""
        for one in fields(self):
            getattr(self, one.name)[pixels] = getattr(other, one.name)[of_other]


def spread(
    objective: Objective, x: Array, discrepancy: Discrepancy, posterior: Posterior | None
) -> Spread:
    """Of all pixels of a fit that ended at x; without a posterior that of no prior."""
    layout = objective.layout
    unknowns = layout.maps.stop // layout.pixels
    found = Spread.empty(layout.pixels, unknowns, layout.channels)
    # Where nothing is left of samples but rounding, a grid of nodes is coarse beside that.
    if posterior is None and discrepancy.of_pixel > (10 * settings.EXACT_RMSE) ** 2:
        grid = Grid(objective, x, discrepancy.of_pixel)
        posterior = Distributions.flat(grid).of_all(grid)
    mean_albedo = x[objective.albedo].reshape(layout.channels, -1).mean(axis=1)

    def fill(chunk: slice) -> None:
        pixels = np.arange(chunk.start, chunk.stop, dtype=np.uint64)
        own = None if posterior is None else posterior.part(chunk)
        found.put(chunk, _of_pixels(objective, x, discrepancy, own, pixels, mean_albedo))

    in_pieces(objective.threads, fill, slices(layout.pixels, settings.PIXELS_AT_ONCE))
    return found


def _of_pixels(
    objective: Objective,
    x: Array,
    discrepancy: Discrepancy,
    posterior: Posterior | None,
    pixels: Pixels,
    mean_albedo: Array,
) -> Spread:
    problem, for_core, c = objective.problem, objective.for_core(x), objective.channels
    matrices, _, _ = problem.normal_equations(for_core, pixels)
    values = taken(objective, x, pixels)
    unknowns, v = matrices.shape[1], discrepancy.of_pixel
    rest = slice(c, unknowns)
    precision = prior_precision(unknowns, c, v)
    diagonal = np.einsum("pii->pi", matrices)
    by_albedo = 1 / (diagonal[:, :c] + precision[:c])
    slopes = -by_albedo[:, :, None] * matrices[:, :c, rest]
    curvature = matrices[:, rest, rest] + matrices[:, rest, :c] @ slopes
    # Rounding of the difference may leave less than nothing.
    np.einsum("pii->pi", curvature)[:] += RIDGE * diagonal[:, rest]
    alone = of_rest = np.linalg.inv(curvature + np.diag(precision[rest]))
    if posterior is not None:
        information = curvature * (posterior.unused[:, None, None] / v)
        information += np.linalg.inv(_covariance(posterior, unknowns - c))
        of_rest = np.linalg.inv(information) / v
    whole = np.empty_like(matrices)
    whole[:, rest, rest] = of_rest
    whole[:, :c, rest] = slopes @ of_rest
    whole[:, rest, :c] = whole[:, :c, rest].transpose(0, 2, 1)
    whole[:, :c, :c] = whole[:, :c, rest] @ slopes.transpose(0, 2, 1)
    np.einsum("pii->pi", whole)[:, :c] += by_albedo
    variance = v * np.einsum("pii->pi", whole)
    shade = np.maximum(values[:, :c], mean_albedo) * (discrepancy.misfit / settings.MEAN_RADIANCE)
    variance[:, :c] += np.square(shade)
    moves, of_scale = problem.moves_with_lights(for_core, pixels, whole, discrepancy.modes)
    variance += discrepancy.of_noise * moves
    of_scale = of_scale[:, rest] + np.einsum("pcf,pc->pf", slopes, of_scale[:, :c])
    if posterior is not None:  # a value that is not the mean of its posterior is off by that, too
        off = values[:, rest] - posterior.mean[:, : unknowns - c]
        variance[:, rest] += np.square(off) * (1 - posterior.unused[:, None])
    largest = settings.SIGMA_MAX**2
    variance = np.clip(np.nan_to_num(variance, nan=largest, posinf=largest), 0, largest)
    half = TWO_SIDED * np.sqrt(variance)
    low, high = values - half, values + half
    if posterior is not None:
        _take_over_quantiles(low[:, rest], high[:, rest], posterior, unknowns - c)
    return Spread(
        values,
        variance,
        np.clip(np.minimum(low, values), 0, 1),
        np.clip(np.maximum(high, values), 0, 1),
        np.square(np.einsum("pfg,pg->pf", alone, of_scale)),
    )


def _covariance(posterior: Posterior, unknowns: int) -> Array:
    """(Q, F, F): of roughness, and metallic where it is one of so many unknowns."""
    found = np.zeros((len(posterior.mean), 2, 2))
    found[:, 0, 1] = found[:, 1, 0] = posterior.covariance
    for i in range(2):
        found[:, i, i] = posterior.variance[:, i] + settings.PRIOR_SIGMA_MIN**2
    return found[:, :unknowns, :unknowns]


def _take_over_quantiles(low: Array, high: Array, posterior: Posterior, unknowns: int) -> None:
    """Put the posterior's quantiles where the grid tells more than the curvature, if farther out.

    They may be lopsided, or reach from one mode to the other; deviations have the lights beside.
    """
    told = posterior.unused[:, None] < 0.5
    used = slice(unknowns)
    sigma = np.sqrt(posterior.variance[:, used] + settings.PRIOR_SIGMA_MIN**2)
    wider = np.maximum((high - low) / (2 * TWO_SIDED * sigma), 1.0)
    mean = posterior.mean[:, used]
    np.copyto(low, mean - wider * (mean - posterior.low[:, used]), where=told)
    np.copyto(high, mean + wider * (posterior.high[:, used] - mean), where=told)


def scale_deviation(jackknife: Array | None, discrepancy: Discrepancy, *, referred: bool) -> Array:
    """(C',): relative deviation of the scale, from that by segments and patches.

    A scale that was found by highlights is off by as much more than samples as these are less than
    all light; what is known of albedos of pictures is known of it too. One that was `referred` to
    known albedo, and one of known lights, is as it is.
    """
    if jackknife is None:
        return np.full(1, LOG_ALBEDO_DEVIATION)
    if referred or not jackknife.any():
        return jackknife
    noise = settings.SCALE_NOISE_RATIO * np.sqrt(discrepancy.variance) / settings.MEAN_RADIANCE
    misfit = discrepancy.misfit / settings.MEAN_RADIANCE / settings.HIGHLIGHT_SHARE
    variance = np.square(jackknife) + noise**2 + misfit**2
    return np.asarray(1 / np.sqrt(1 / variance + 1 / LOG_ALBEDO_DEVIATION**2))


def of_spread(
    found: Spread,
    layout: ParameterLayout,
    discrepancy: Discrepancy,
    scale_deviation: Array,
    objective: Objective,
) -> Uncertainty:
    """The uncertainty, with the scale's by channel in it, 0 where lights are known.

    Noise is that of the objective, in picture units, if it has more samples than unknowns.
    """
    noise = None
    if objective.samples > objective.size:
        noise = float(np.sqrt(discrepancy.variance)) * objective.scale
    c = layout.channels
    largest = np.square([ROUGHNESS_DEVIATION, METALLIC_DEVIATION])[: found.by_scale.shape[1]]
    more = np.empty_like(found.variance)
    more[:, :c] = np.square(found.value[:, :c] * scale_deviation)
    more[:, c:] = np.minimum(found.by_scale * np.mean(np.square(scale_deviation)), largest)
    sigma = np.minimum(np.sqrt(found.variance + more), settings.SIGMA_MAX)
    widen = sigma / np.sqrt(np.maximum(found.variance, np.finfo(np.float32).tiny))
    low = np.clip(found.value - widen * (found.value - found.low), 0, 1)
    high = np.clip(found.value + widen * (found.high - found.value), 0, 1)
    deviation = _materials(sigma, layout)
    red, green, blue = np.broadcast_to(scale_deviation, 3).tolist()
    value = found.value
    return Uncertainty(
        deviation=deviation,
        low=_materials(np.where(np.isfinite(low), low, value), layout, objective.known_metallic),
        high=_materials(np.where(np.isfinite(high), high, value), layout, objective.known_metallic),
        noise=noise,
        effective_share=discrepancy.effective_share,
        albedo_scale=(red, green, blue),
        verdicts=by_deviations(deviation),
    )


def _materials(values: Floats, layout: ParameterLayout, known: float | None = 0.0) -> Materials:
    """Maps of (P, D), and a metallic that is known."""
    c = layout.channels
    metallic = np.full(layout.pixels, known) if layout.metallic_known else values[:, c + 1]
    return Materials(
        layout.whole(np.broadcast_to(values[:, :c], (layout.pixels, 3))),
        layout.whole(values[:, c]),
        layout.whole(metallic),
    )
