"""Joint Gauss-Newton steps for lights and the materials of some pixels with a Gaussian prior.

L-BFGS hardly moves along the valleys that the problem has: when a channel's albedo is scaled and
its lights undo it, little but the highlights of dielectrics changes, and many pixels have to
change roughness a little as well. Gauss-Newton sees these valleys. What it minimises, over albedo,
roughness and metallic of some pixels, the lights, and an offset δ for each cluster of pixels, is

    Σ ω (I − T)² + Σ_pf a_pf (v_pf − c_pf − δ_g(p)f)² + s Σ_gf (Σ_{p in g} a_pf) δ_gf²

with the prior of `GaussianPrior`. Without the offsets each step of many pixels would have to be won
against their priors.

Pixels are solved for first, which leaves a dense system in lights and offsets (Schur complement,
as in `normal_equations`). After each step albedo is put to its best value for the new lights,
roughness and metallic, which needs no iteration (`Objective.put_best_albedo`): given these, each
channel of a pixel is a polynomial in its albedo. Without this, steps overshoot, since albedo times
light is not linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.gauss_newton.normal_equations import (
    Cholesky,
    Eliminated,
    as_in_x,
    chunks,
    eliminate,
)
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.gaussian import GaussianPrior

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _State:
    """An x of the pixels alone, the offsets (clusters, F), and the sum that is minimised."""

    part: Array
    offsets: Array
    total: float


def minimize(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], prior: GaussianPrior, steps: int
) -> tuple[Array, int]:
    """At most so many steps from x that lower the sum; returns x and how many they were.

    `pixels` (Q,) with their prior (Q, F) take part, and materials of others stay. Lights are
    unknown; penalties of the objective take no part.
    """
    x = x.copy()
    offsets = np.zeros_like(prior.cluster_precision)
    state = _with_best_albedo(objective, x, pixels, prior, offsets)
    damping, done, failed = settings.DAMPING_START, 0, 0
    while done < steps and failed < settings.PRIOR_FAILED_STEPS_MAX:
        try:
            moved = _step(objective, x, state, pixels, prior, damping)
        except np.linalg.LinAlgError:
            moved = None
        if moved is None or not moved.total < state.total:
            objective.put_part(x, pixels, state.part)
            damping, failed = settings.DAMPING_GROWTH * damping, failed + 1
            continue
        gain = state.total - moved.total
        state, done, failed = moved, done + 1, 0
        damping = max(damping / settings.DAMPING_DECAY, settings.PRIOR_DAMPING_MIN)
        if gain < settings.PRIOR_GAIN_MIN * state.total:
            break
    return x, done


def _with_best_albedo(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], prior: GaussianPrior, offsets: Array
) -> _State:
    """The state of x, whose albedo is put to its best."""
    sum_sq = objective.put_best_albedo(x, pixels)
    values = np.stack([x[block][pixels] for block in objective.layout.roughness_metallic], axis=-1)
    deviation = prior.deviation(values, offsets)
    of_pixels = float((prior.precision * deviation**2).sum())
    of_offsets = settings.OFFSET_PRECISION_SHARE * float(
        (prior.cluster_precision * offsets**2).sum()
    )
    total = float(sum_sq.sum()) + of_pixels + of_offsets
    return _State(objective.part_of(x, pixels), offsets, total)


def _step(
    objective: Objective,
    x: Array,
    state: _State,
    pixels: NDArray[np.uint64],
    prior: GaussianPrior,
    damping: float,
) -> _State:
    """One damped step of x, which is in `state`. Half the sum's derivatives are used throughout."""
    layout = objective.layout
    for_core = objective.for_core(x)
    values = x[layout.maps].reshape(-1, layout.pixels)[:, pixels].T  # (Q, D)
    roughness_metallic = slice(layout.channels, None)
    deviation = prior.deviation(values[:, roughness_metallic], state.offsets)
    precision = np.zeros_like(values)
    precision[:, roughness_metallic] = prior.precision

    # Pixels: those on a bound that would leave it are held.
    _, by_materials, _ = objective.problem.normal_equations(for_core, pixels)
    by_materials[:, roughness_metallic] += prior.precision * deviation
    held = ((values <= 0) & (by_materials > 0)) | ((values >= 1) & (by_materials < 0))
    part = eliminate(
        objective.problem, for_core, layout, pixels, held, precision=precision, damping=damping
    )
    whitened = np.einsum("pij,pj->pi", part.whiten, by_materials)

    # Lights and offsets: matrix and gradient with the pixels solved for.
    of_lights, by_lights = objective.problem.schur_complement(
        for_core,
        pixels,
        damping=damping,
        mono=layout.light_channels < layout.channels,
        precision=prior.precision,
        deviation=deviation,
    )
    system = _System.of(part, of_lights, prior, layout)
    tied = np.einsum("pfg,pf->pg", system.by_offsets, whitened[:, roughness_metallic])
    by_offsets = settings.OFFSET_PRECISION_SHARE * prior.cluster_precision * state.offsets
    by_offsets -= prior.sums(prior.precision * deviation + tied)
    gradient = np.concatenate([by_lights, by_offsets.ravel()])

    moves = -Cholesky(system.matrix, settings.LIGHT_DAMPING * damping).solve(gradient)
    lights = moves[: by_lights.size].reshape(
        layout.light_channels, layout.pictures, layout.coefficients
    )
    lights = lights.transpose(1, 0, 2)
    offsets = moves[by_lights.size :].reshape(state.offsets.shape)

    # Back to the pixels.
    of_samples = np.einsum(
        "nck,pck->pnc",
        np.broadcast_to(lights, (len(lights), *part.by_light.shape[1:])),
        part.by_light,
    )
    whitened += np.einsum("pdnc,pnc->pd", part.rows, of_samples)
    whitened[:, roughness_metallic] += np.einsum(
        "pfg,pg->pf", system.by_offsets, offsets[prior.cluster]
    )
    values = np.clip(values - np.einsum("pij,pi->pj", part.whiten, whitened), 0, 1)
    x[layout.maps].reshape(-1, layout.pixels)[:, pixels] = values.T
    x[layout.lighting] += as_in_x(moves[: by_lights.size], layout)
    return _with_best_albedo(objective, x, pixels, prior, state.offsets + offsets)


@dataclass(frozen=True, eq=False)
class _System:
    """Lights and offsets when the pixels are solved for."""

    matrix: Array
    """Of (light channels, N, K) and (clusters, F), one after the other."""
    by_offsets: Array
    """(Q, F, F): U ∂²/∂v∂δ, rows and columns of roughness and metallic."""

    @classmethod
    def of(
        cls, part: Eliminated, of_lights: Array, prior: GaussianPrior, layout: ParameterLayout
    ) -> _System:
        assert prior.cluster is not None
        roughness_metallic = slice(layout.channels, None)
        by_offsets = (
            -part.whiten[:, roughness_metallic, roughness_metallic] * prior.precision[:, None, :]
        )
        shape = (layout.pictures, layout.light_channels, layout.coefficients)
        in_core = np.arange(len(of_lights)).reshape(shape).transpose(1, 0, 2).ravel()
        f = prior.precision.shape[1]
        size, count = len(of_lights), prior.clusters * f
        matrix = np.zeros((size + count, size + count))
        matrix[:size, :size] = of_lights
        total = (1 + settings.OFFSET_PRECISION_SHARE) * prior.cluster_precision.ravel()
        matrix[size:, size:] = np.diag(total)
        for chunk in chunks(len(by_offsets), 8 * f * (size + count)):
            of_chunk = by_offsets[chunk]
            columns = np.zeros((len(of_chunk), f, prior.clusters, f))
            columns[np.arange(len(of_chunk)), :, prior.cluster[chunk]] = of_chunk
            by_offset = columns.reshape(-1, count)
            crossed = part.light_rows(chunk, layout).T @ by_offset
            crossed = crossed[in_core]
            matrix[:size, size:] -= crossed
            matrix[size:, :size] -= crossed.T
            matrix[size:, size:] -= by_offset.T @ by_offset
        return cls(matrix, by_offsets)
