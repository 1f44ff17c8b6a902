"""Normal equations of materials and lights: pixels solved for, lights left (Schur complement)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.values.arrays import Array, Mask

RIDGE = 1e-12
"""Added to matrices of unit diagonal before they are inverted; far below what data can tell."""


def inverted(matrices: Array, precision: Array) -> Array:
    """Inverses of matrices (P, D, D) with a diagonal precision (D,), which is above 0.

    Unknowns are brought to one scale: what no sample tells keeps its precision beside what many do.
    """
    whole = matrices + np.diag(precision)
    scale = 1 / np.sqrt(np.einsum("pii->pi", whole))
    products = scale[:, :, None] * scale[:, None, :]
    whole *= products
    np.einsum("pii->pi", whole)[:] = 1 + RIDGE
    return np.asarray(np.linalg.inv(whole) * products, np.float64)


def whitening(matrices: Array, held: Mask) -> Array:
    """U with U A Uᵀ = 1 for A (P, D, D); 0 for what is held.

    A is scaled to S A S of unit diagonal: an unknown in which radiance is flat would spoil the
    others without. S is 0 for those that are held and for those on which radiance does not depend.
    """
    diagonal = np.einsum("pii->pi", matrices)
    used = ~held & (diagonal > np.finfo(np.float64).tiny)
    scale = np.zeros_like(diagonal)
    np.divide(1, np.sqrt(diagonal, where=used, out=scale), where=used, out=scale)
    scaled = matrices * scale[:, :, None] * scale[:, None, :]
    np.einsum("pii->pi", scaled)[:] = 1 + RIDGE
    # A⁻¹ = S (L Lᵀ)⁻¹ S with Cholesky's L, so U = L⁻¹ S.
    return np.asarray(np.linalg.inv(np.linalg.cholesky(scaled)) * scale[:, None, :])


def albedo_solved_for(objective: Objective, x: Array) -> tuple[Array, Array]:
    """Jᵀ(1 − P)J (P, F, F) and Jᵀ(1 − P)r (P, F) of what pixels have beside albedo.

    P projects on what albedos between their bounds can do.
    """
    pixels, c = objective.everything, objective.channels
    matrices, gradient, _ = objective.problem.normal_equations(objective.for_core(x), pixels)
    across, diagonal = matrices[:, :c, c:], np.einsum("pii->pi", matrices[:, :c, :c])
    albedo = x[objective.albedo].reshape(c, -1).T
    free = (albedo > 0) & (albedo < 1) & (diagonal > 0)
    inverse = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=free)
    left = matrices[:, c:, c:] - np.einsum("pca,pc,pcb->pab", across, inverse, across)
    return left, gradient[:, c:] - np.einsum("pca,pc,pc->pa", across, inverse, gradient[:, :c])


def known_materials(objective: Objective, x: Array) -> Array:
    """(N, light channels K, light channels K): information on the lights if materials are known."""
    layout = objective.layout
    channels, k = layout.light_channels, layout.coefficients
    grams, _ = objective.problem.light_equations(x[layout.maps])
    found = np.zeros((layout.pictures, channels, k, channels, k))
    for c, gram in enumerate(grams):
        found[:, c % channels, :, c % channels] += gram
    return found.reshape(layout.pictures, channels * k, channels * k)


def by_unknowns(by_material: Array, layout: ParameterLayout) -> Array:
    """(P, N, C, D) from (P, N, C, 3 or 5): the albedo of a channel changes that channel alone."""
    c = layout.channels
    others = [1] if layout.metallic_known else [1, 2]
    others += [3, 4] if layout.free_normals else []
    jacobian = np.zeros((*by_material.shape[:3], c + len(others)))
    np.einsum("pncc->pnc", jacobian[..., :c])[:] = by_material[..., 0]
    jacobian[..., c:] = by_material[..., others]
    return jacobian


def products(jacobian: Array, weights: Array) -> Array:
    """Jᵀ Ω J, (P, D, D)."""
    pixels, unknowns = len(jacobian), jacobian.shape[-1]
    rows = jacobian.reshape(pixels, -1, unknowns)
    weighted = rows * weights.reshape(pixels, -1, 1)
    return np.asarray(weighted.transpose(0, 2, 1) @ rows)


def as_in_x(moves: Array, layout: ParameterLayout) -> Array:
    """From (light channel, picture, coefficient), as the core has them, to the order in x."""
    shape = (layout.light_channels, layout.pictures, layout.coefficients)
    return moves.reshape(shape).transpose(1, 2, 0).ravel()


def solver_of(matrix: Array, damping: float) -> Callable[[Array], Array]:
    """Solves with a matrix, which is lost, damped by a share of its diagonal.

    A shorter right side is solved with the leading part of the matrix, whose Cholesky factor is the
    leading part of the whole one's.

    Where it is not positive definite for rounding, next to nothing is known of the lights, and its
    diagonal stands for it.
    """
    from scipy.linalg import cho_factor, cho_solve

    diagonal = np.einsum("ii->i", matrix)
    sizes = np.abs(diagonal) + np.finfo(float).tiny
    # 1e-13 of the largest is for directions nobody sees.
    diagonal += damping * np.abs(diagonal) + 1e-13 * diagonal.max() + np.finfo(float).tiny
    try:
        factor, lower = cho_factor(matrix, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return lambda right: right / sizes[: len(right)]

    def solve(right: Array) -> Array:
        part = factor[: len(right), : len(right)]
        return np.asarray(cho_solve((part, lower), right, check_finite=False))

    return solve
