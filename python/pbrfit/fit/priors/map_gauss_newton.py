"""Joint Gauss-Newton steps for lights and the materials of some pixels, pulled to given values.

L-BFGS hardly moves along the valleys that the problem has: when a channel's albedo is scaled and
its lights undo it, little but the highlights of dielectrics changes, and many pixels have to
change roughness a little as well. Gauss-Newton sees these valleys. What it minimises, over albedo,
roughness and metallic of some pixels, the lights, and an offset δ for each cluster of pixels, is

    Σ ω (I − T)² + Σ_pf a_pf (v_pf − c_pf − δ_g(p)f)² + s Σ_gf (Σ_{p in g} a_pf) δ_gf²

with v = roughness and metallic (f), pulled with precision a towards c. The offsets let a cluster
move as a whole; without them each step of many pixels would have to be won against their pulls.

Pixels are solved for first, which leaves a dense system in lights and offsets (Schur complement,
as in `normal_equations`). After each step albedo is put to its best value for the new lights,
roughness and metallic, which needs no iteration (`Objective.with_best_albedo`): given these, each
channel of a pixel is a polynomial in its albedo. Without this, steps overshoot, since albedo times
light is not linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.normal_equations import (
    Cholesky,
    Eliminated,
    as_in_x,
    chunks,
    eliminate,
)
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout

Array = NDArray[np.float64]

OFFSET_PULL = 1e-3
"""s: offsets are pulled to 0 by this share of the pull that their pixels feel."""

FIRST_DAMPING = 1e-3
"""Of the diagonal of each pixel's matrix, as in Marquardt's method."""

LIGHT_DAMPING = 1e-3
"""Damping of the lights, as a share of that of pixels: their system is what we are here for."""

SMALLEST_DAMPING = 1e-6

FAILURES = 4
"""Steps in a row that may fail, each followed by ten times the damping."""

ENOUGH = 1e-5
"""A step that lowers the sum by less than this share of it is the last."""


@dataclass(frozen=True, eq=False)
class Pull:
    """Where pixels are pulled; F = 2 for roughness and metallic, or 1 where the latter is known.

    Attributes
    ----------
    centre, precision
        (P, F): c, and a in units of squared residuals.
    cluster
        (P,): which offset a pixel has.
    clusters
        Number of clusters.
    """

    centre: Array
    precision: Array
    cluster: NDArray[np.intp]
    clusters: int

    def offset_precision(self) -> Array:
        """Σ a over the pixels of a cluster, (clusters, F)."""
        return self.sums(self.precision)

    def sums(self, values: Array) -> Array:
        """Of (P, F) over the pixels of each cluster, (clusters, F)."""
        columns = [
            np.bincount(self.cluster, weights=column, minlength=self.clusters)
            for column in values.T
        ]
        return np.stack(columns, axis=-1)


@dataclass(frozen=True, eq=False)
class _State:
    """An x of the pixels alone, the offsets (clusters, F), and the sum that is minimised."""

    part: Array
    offsets: Array
    total: float


def minimize(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], pull: Pull, steps: int
) -> tuple[Array, int]:
    """Steps from x that lower the sum; returns x and how many they were.

    Parameters
    ----------
    objective
        The problem, with unknown lights; its penalties take no part.
    x
        Where to start. Other pixels' materials stay.
    pixels
        (Q,) indices of the pixels that take part.
    pull
        Of these pixels.
    steps
        At most so many.
    """
    x = x.copy()
    state = _with_best_albedo(
        objective, x, pixels, pull, np.zeros((pull.clusters, pull.centre.shape[1]))
    )
    damping, done, failed = FIRST_DAMPING, 0, 0
    while done < steps and failed < FAILURES:
        try:
            moved = _step(objective, x, state, pixels, pull, damping)
        except np.linalg.LinAlgError:
            moved = None
        if moved is None or not moved.total < state.total:
            objective.put_part(x, pixels, state.part)
            damping, failed = 10 * damping, failed + 1
            continue
        gain = state.total - moved.total
        state, done, failed = moved, done + 1, 0
        damping = max(damping / 5, SMALLEST_DAMPING)
        if gain < ENOUGH * state.total:
            break
    return x, done


def _with_best_albedo(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], pull: Pull, offsets: Array
) -> _State:
    """The state of x, whose albedo is put to its best."""
    squares = objective.put_best_albedo(x, pixels)
    values = np.stack([x[block][pixels] for block in objective.layout.roughness_metallic], axis=-1)
    off = values - pull.centre - offsets[pull.cluster]
    pulled = float((pull.precision * off**2).sum())
    held = OFFSET_PULL * float((pull.offset_precision() * offsets**2).sum())
    return _State(objective.part_of(x, pixels), offsets, float(squares.sum()) + pulled + held)


def _step(
    objective: Objective,
    x: Array,
    state: _State,
    pixels: NDArray[np.uint64],
    pull: Pull,
    damping: float,
) -> _State:
    """One damped step of x, which is in `state`. Half the sum's derivatives are used throughout."""
    layout = objective.layout
    for_core = objective.for_core(x)
    values = x[layout.maps].reshape(-1, layout.pixels)[:, pixels].T  # (Q, D)
    finish = slice(layout.channels, None)
    off = values[:, finish] - pull.centre - state.offsets[pull.cluster]
    precision = np.zeros_like(values)
    precision[:, finish] = pull.precision

    # Pixels: those on a bound that would leave it are held.
    _, by_materials, _ = objective.problem.normal_equations(for_core, pixels)
    by_materials[:, finish] += pull.precision * off
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
        precision=pull.precision,
        deviation=off,
    )
    system = _System.of(part, of_lights, pull, layout)
    tied = np.einsum("pfg,pf->pg", system.by_offsets, whitened[:, finish])
    by_offsets = OFFSET_PULL * pull.offset_precision() * state.offsets
    by_offsets -= pull.sums(pull.precision * off + tied)
    gradient = np.concatenate([by_lights, by_offsets.ravel()])

    moves = -Cholesky(system.matrix, LIGHT_DAMPING * damping).solve(gradient)
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
    whitened[:, finish] += np.einsum("pfg,pg->pf", system.by_offsets, offsets[pull.cluster])
    values = np.clip(values - np.einsum("pij,pi->pj", part.whiten, whitened), 0, 1)
    x[layout.maps].reshape(-1, layout.pixels)[:, pixels] = values.T
    x[layout.lighting] += as_in_x(moves[: by_lights.size], layout)
    return _with_best_albedo(objective, x, pixels, pull, state.offsets + offsets)


@dataclass(frozen=True, eq=False)
class _System:
    """Lights and offsets when the pixels are solved for.

    Attributes
    ----------
    matrix
        Of (light channels, N, K) and (clusters, F), one after the other.
    by_offsets
        (Q, F, F): U ∂²/∂v∂δ, rows and columns of roughness and metallic.
    """

    matrix: Array
    by_offsets: Array

    @classmethod
    def of(cls, part: Eliminated, of_lights: Array, pull: Pull, layout: ParameterLayout) -> _System:
        finish = slice(layout.channels, None)
        by_offsets = -part.whiten[:, finish, finish] * pull.precision[:, None, :]
        shape = (layout.pictures, layout.light_channels, layout.coefficients)
        in_core = np.arange(len(of_lights)).reshape(shape).transpose(1, 0, 2).ravel()
        f = pull.precision.shape[1]
        size, count = len(of_lights), pull.clusters * f
        matrix = np.zeros((size + count, size + count))
        matrix[:size, :size] = of_lights
        total = (1 + OFFSET_PULL) * pull.offset_precision().ravel()
        matrix[size:, size:] = np.diag(total)
        for chunk in chunks(len(by_offsets), 8 * f * (size + count)):
            of_chunk = by_offsets[chunk]
            columns = np.zeros((len(of_chunk), f, pull.clusters, f))
            columns[np.arange(len(of_chunk)), :, pull.cluster[chunk]] = of_chunk
            by_offset = columns.reshape(-1, count)
            crossed = part.light_rows(chunk, layout).T @ by_offset
            crossed = crossed[in_core]
            matrix[:size, size:] -= crossed
            matrix[size:, :size] -= crossed.T
            matrix[size:, size:] -= by_offset.T @ by_offset
        return cls(matrix, by_offsets)
