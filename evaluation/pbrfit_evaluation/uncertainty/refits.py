"""Refits of noisy pictures, from the ground truth to convergence, lights known or free.

Gauss-Newton in float64, damped as by Marquardt, within the bounds. With g̃ half of the slope of the
sum of squares and H the Gauss-Newton matrix, a fit is converged when g̃ᵀ H⁻¹ g̃ is below
(TOLERANCE σ)². By Cauchy and Schwarz the next step would then move no unknown by more than that
share of its predicted deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pbrfit.fit.normal_equations import eliminate, inverse
from pbrfit.fit.objective import Objective

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

TOLERANCE = 0.01

STEPS = 60
"""At most so many, failed ones included."""

DAMPING = 1e-9
"""At first and at least: nearly undamped. A fit counts as converged up to `LARGE` only."""

RAISED = 1e-5
"""After a step that failed, at least; then ten times as much each time."""

LARGE = 1e-3

POLISH = 30
"""Steps of each pixel alone after a step of all. A pixel that is hardly determined may not hold the
others up."""


@dataclass(frozen=True, eq=False)
class Refit:
    """Materials (Q, D) of some pixels, whether each has converged, and Σ ω (I − T)² of each."""

    values: Array
    converged: Flags
    sum_sq_residuals: Array


def with_known_lights(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], noise: float, steps: int = STEPS
) -> Refit:
    """Fit each of some pixels alone; `noise` is σ in units of x. Lights in x are held."""
    x = x.copy()
    planes = x[objective.layout.maps].reshape(-1, objective.pixels)
    values = planes[:, pixels].T.copy()
    equations = objective.problem.normal_equations
    matrices, gradient, sum_sq_residuals = equations(x, pixels)
    damping = np.full(len(values), DAMPING)
    converged = np.zeros(len(values), dtype=bool)
    for _ in range(steps):
        held = _pushed_out(values, gradient)
        moves, decrement = _steps(matrices, gradient, held, damping)
        converged |= (decrement <= (TOLERANCE * noise) ** 2) & (damping <= LARGE)
        if converged.all():
            break
        moved = np.clip(values + moves, 0, 1)
        planes[:, pixels] = moved.T
        found = equations(x, pixels)
        better = (found[2] < sum_sq_residuals) & ~converged
        values[better] = moved[better]
        matrices[better], gradient[better], sum_sq_residuals[better] = (of[better] for of in found)
        damping = _next(damping, better)
    return Refit(values, converged, sum_sq_residuals)


def with_free_lights(objective: Objective, x: Array, noise: float) -> tuple[Array, bool, float]:
    """Fit all pixels and the lights; x, whether it has converged, and the sum of squares."""
    pixels, maps = np.arange(objective.pixels, dtype=np.uint64), objective.layout.maps
    sum_sq_residuals = np.inf
    damping = np.full(1, DAMPING)
    converged = False
    for _ in range(STEPS):
        step, decrement = _joint_step(objective, x, pixels, float(damping[0]))
        converged = bool(decrement <= (TOLERANCE * noise) ** 2 and damping[0] <= LARGE)
        if converged:
            break
        moved = x + step
        np.clip(moved[maps], 0, 1, out=moved[maps])
        polished = with_known_lights(objective, moved, pixels, noise, POLISH)
        moved[maps] = polished.values.T.ravel()
        found = float(polished.sum_sq_residuals.sum())
        better = found < sum_sq_residuals
        if better:
            x, sum_sq_residuals = moved, found
        damping = _next(damping, np.array([better]))
    return x, converged, sum_sq_residuals


def _next(damping: Array, better: Flags) -> Array:
    lower, higher = np.maximum(damping / 10, DAMPING), np.maximum(10 * damping, RAISED)
    return np.where(better, lower, higher)


def _pushed_out(values: Array, gradient: Array) -> Flags:
    """On a bound, and the sum of squares falls beyond it."""
    return ((values <= 0) & (gradient > 0)) | ((values >= 1) & (gradient < 0))


def _steps(matrices: Array, gradient: Array, held: Flags, damping: Array) -> tuple[Array, Array]:
    """Damped steps (Q, D), and g̃ᵀ A⁻¹ g̃ (Q,) without damping; held unknowns stay."""
    downhill = np.where(held, 0, -gradient)
    decrement = np.einsum("pi,pij,pj->p", downhill, inverse(matrices, held).matrices, downhill)
    damped = matrices.copy()
    np.einsum("pii->pi", damped)[:] *= 1 + damping[:, None]
    return np.einsum("pij,pj->pi", inverse(damped, held).matrices, downhill), decrement


def _joint_step(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], damping: float
) -> tuple[Array, float]:
    """Damped step of x, and g̃ᵀ H⁻¹ g̃ with that damping.

    Materials are solved for first: with U A Uᵀ = 1, S the Schur complement of the lights, g and h
    the parts of g̃,

        S dL = −(h − Bᵀ A⁻¹ g)      dθ = −Uᵀ (U g + U B dL)
    """
    layout, problem = objective.layout, objective.problem
    _, gradient, _ = problem.normal_equations(x, pixels)
    held = _pushed_out(x[layout.maps].reshape(-1, layout.pixels).T, gradient)
    part = eliminate(problem, x, layout, pixels, held, damping=damping)
    errors = problem.residuals(x, pixels).transpose(1, 0, 2) * part.weights
    whitened = np.einsum("pij,pj->pi", part.whiten, gradient)
    errors -= np.einsum("pdnc,pd->pnc", part.rows, whitened)
    right = np.einsum("pnc,pck->nck", errors, part.by_light).ravel()
    matrix = part.information(layout)
    np.einsum("ii->i", matrix)[:] *= 1 + damping
    lights = -cho_solve(cho_factor(matrix), right)
    decrement = float(np.square(whitened).sum() - right @ lights)
    lights = lights.reshape(layout.pictures, layout.light_channels, layout.coefficients)
    by_lights = np.einsum("nck,pck->pnc", lights, part.by_light)
    whitened += np.einsum("pdnc,pnc->pd", part.rows, by_lights)
    moves = -np.einsum("pij,pi->pj", part.whiten, whitened)
    return np.concatenate([moves.T.ravel(), lights.transpose(0, 2, 1).ravel()]), decrement
