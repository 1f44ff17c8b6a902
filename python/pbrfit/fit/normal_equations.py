"""Normal equations of materials and lights: pixels solved for, lights left (Schur complement)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.sampling import slices

Array = NDArray[np.float64]

RIDGE = 1e-12
"""Added to matrices of unit diagonal before they are inverted; far below what data can tell."""

SCHUR_RIDGE = 1e-13
"""Share of the largest diagonal entry that is added to the diagonal of the lights' system: they may
have directions that no pixel sees."""

VARIANCE_INFLATION_MAX = 1e8
"""Factor by which the other unknowns of a pixel may raise a variance; above it rounding has decided
it, because the pictures have 7 digits, and the unknown counts as not known at all."""

WORKING_SET = 1 << 24
"""Bytes of the largest array that a piece of work may need; changes no result."""


@dataclass(frozen=True, eq=False)
class Inverse:
    """Inverse matrices of pixels, (P, D, D), and the unknowns about which they say nothing, (P, D).

    Rows and columns of the latter and of unknowns that are held are 0.
    """

    matrices: Array
    singular: NDArray[np.bool_]


def ridged(matrices: Array) -> Array:
    """Matrices (P, D, D) that can be inverted even where a pixel weighs next to nothing."""
    trace = np.einsum("pii->p", matrices)[:, None, None]
    least = RIDGE * trace + 1e-30  # of what is 0 altogether
    return np.asarray(matrices + least * np.eye(matrices.shape[1]), np.float64)


def inverse(matrices: Array, held: NDArray[np.bool_]) -> Inverse:
    """Of symmetric positive semidefinite matrices (P, D, D) without the unknowns `held` (P, D).

    An unknown is singular if radiance does not depend on it at all, or if others can make up for
    it completely.
    """
    scaled, scale = _scaled(matrices, held)
    inverted = np.linalg.inv(scaled)
    inflation = np.einsum("pii->pi", inverted)
    singular = ~held & ((scale == 0) | (inflation > VARIANCE_INFLATION_MAX))
    return Inverse(inverted * scale[:, :, None] * scale[:, None, :], singular)


def _scaled(matrices: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Matrices S A S + ridge of unit diagonal, and the diagonal of S (P, D).

    An unknown in which radiance is flat would spoil the others without this. S is 0 for those that
    are held and for those on which radiance does not depend.
    """
    diagonal = np.einsum("pii->pi", matrices)
    used = ~held & (diagonal > np.finfo(np.float64).tiny)
    scale = np.zeros_like(diagonal)
    np.divide(1, np.sqrt(diagonal, where=used, out=scale), where=used, out=scale)
    scaled = matrices * scale[:, :, None] * scale[:, None, :]
    np.einsum("pii->pi", scaled)[:] = 1 + RIDGE
    return scaled, scale


def whitening(matrices: Array, held: NDArray[np.bool_], damping: float) -> Array:
    """U with U A Uᵀ = 1 for A (P, D, D) with a share of its diagonal more; 0 for what is held."""
    scaled, scale = _scaled(matrices, held)
    np.einsum("pii->pi", scaled)[:] += damping
    # A⁻¹ = S (L Lᵀ)⁻¹ S with Cholesky's L, so U = L⁻¹ S.
    return np.asarray(np.linalg.inv(np.linalg.cholesky(scaled)) * scale[:, None, :])


def albedo_solved_for(objective: Objective, x: Array) -> tuple[Array, Array]:
    """Jᵀ(1 − P)J (P, F, F) and Jᵀ(1 − P)r (P, F) of what pixels have beside albedo.

    P projects on what albedos between their bounds can do.
    """
    pixels, c = np.arange(objective.pixels, dtype=np.uint64), objective.channels
    matrices, gradient, _ = objective.problem.normal_equations(objective.for_core(x), pixels)
    across, diagonal = matrices[:, :c, c:], np.einsum("pii->pi", matrices[:, :c, :c])
    free = ~held_at_bounds(x, objective.layout)[:, :c] & (diagonal > 0)
    inverse = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=free)
    left = matrices[:, c:, c:] - np.einsum("pca,pc,pcb->pab", across, inverse, across)
    return left, gradient[:, c:] - np.einsum("pca,pc,pc->pa", across, inverse, gradient[:, :c])


def held_at_bounds(x: Array, layout: ParameterLayout) -> NDArray[np.bool_]:
    """(P, D): unknowns of pixels that lie on a bound."""
    materials = x[layout.maps].reshape(-1, layout.pixels).T
    return (materials <= 0) | (materials >= 1)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Some pixels whose materials are solved for, and what that leaves for the lights.

    With J the derivatives of a pixel's radiance by its D unknowns, ω the weights of its samples and
    w_ck the derivatives by the light,

        A = Σ_ic ω_ic J_ic J_icᵀ      B[θ, ick] = ω_ic J_icθ w_ck

    The M unknowns of the lights are (N, light channels, K). Each pixel's share of what is left is
    positive semidefinite: pixels are not scaled apart, so the sum is too.
    """

    by_light: Array
    weights: Array
    """(P, C, K) and (P, N, C): w and ω."""
    whiten: Array
    """(P, D, D), lower triangular: U with U A Uᵀ = 1, so that A⁻¹ = Uᵀ U; 0 for what is held."""
    rows: Array
    """(P, D, N, C): U Jᵀ Ω. Times w they are U B, so Bᵀ A⁻¹ B is the sum of their squares."""

    def information_alone(self, layout: ParameterLayout) -> Array:
        """(N, light channels, K, K): what the pixels say about lights if materials are known."""
        w = self.by_light
        gram = np.einsum("pnc,pck,pcl->nckl", self.weights, w, w, optimize=True)
        if layout.light_channels < layout.channels:
            gram = gram.sum(axis=1, keepdims=True)
        return np.asarray(gram)

    def information(self, layout: ParameterLayout) -> Array:
        """(M, M): what is left of it when materials are solved for, G − Σ_p Bᵀ A⁻¹ B."""
        channels, unknowns = layout.channels, self.rows.shape[1]
        n, light_channels, k = layout.pictures, layout.light_channels, layout.coefficients
        blocks = np.zeros((n, light_channels, k, n, light_channels, k))
        found = blocks.reshape(n * light_channels * k, -1)
        for chunk in chunks(len(self.rows), 8 * unknowns * len(found)):
            # Row c is that of the albedo of channel c: A is diagonal in these, U triangular.
            for c in range(channels):
                rows = self.rows[chunk, c, :, c, None] * self.by_light[chunk, None, c]
                rows = rows.reshape(len(rows), -1)
                of_channel = blocks[:, c % light_channels, :, :, c % light_channels]
                of_channel -= (rows.T @ rows).reshape(n, k, n, k)
            rest = self.light_rows(chunk, layout)
            found -= rest.T @ rest
        lights = np.arange(n * light_channels)
        by_light = found.reshape(n * light_channels, k, n * light_channels, k)
        by_light[lights, :, lights, :] += self.information_alone(layout).reshape(-1, k, k)
        return found

    def imitated(self, lights: Array, layout: ParameterLayout) -> Array:
        """Σ_p Bᵀ A⁻¹ B v, the part of v that materials imitate, for `lights` (N, ·, K, R) = v."""
        n, light_channels, k, count = lights.shape
        channels = layout.channels
        found = np.zeros_like(lights)
        by_coefficient = lights.transpose(1, 2, 0, 3).reshape(light_channels, k, n * count)
        for chunk in chunks(len(self.rows), 8 * n * channels * count):
            w = self.by_light[chunk]
            rows = self.rows[chunk].transpose(0, 1, 3, 2).reshape(len(w), -1, channels * n)
            radiance = np.empty((len(w), channels, n * count))
            for c in range(channels):
                np.matmul(w[:, c], by_coefficient[c % light_channels], out=radiance[:, c])
            moved = rows.transpose(0, 2, 1) @ (rows @ radiance.reshape(len(w), -1, count))
            moved = moved.reshape(len(w), channels, n * count)
            for c in range(channels):
                by_light = (w[:, c].T @ moved[:, c]).reshape(k, n, count)
                found[:, c % light_channels] += by_light.transpose(1, 0, 2)
        return found

    def light_rows(self, chunk: slice, layout: ParameterLayout) -> Array:
        """U B of roughness and metallic, (pixels · unknowns, M)."""
        rows = self.rows[chunk, layout.channels :, ..., None] * self.by_light[chunk, None, None]
        if layout.light_channels < layout.channels:
            rows = rows.sum(axis=3)
        return rows.reshape(-1, layout.pictures * layout.light_channels * layout.coefficients)


def eliminate(
    problem: _core.Problem,
    x: Array,
    layout: ParameterLayout,
    pixels: NDArray[np.uint64],
    held: NDArray[np.bool_],
    *,
    damping: float = 0.0,
) -> Eliminated:
    """Solve some pixels' normal equations for their materials.

    The share `damping` of the diagonal of A is added to it.
    """
    by_material, by_light, weights = problem.derivatives(x, pixels)
    jacobian = by_unknowns(by_material, layout)
    jacobian *= ~held[:, None, None, :]
    matrices = products(jacobian, weights)
    whiten = whitening(matrices, held, damping)
    weighted = (jacobian * weights[..., None]).reshape(len(jacobian), -1, held.shape[1])
    rows = (whiten @ weighted.transpose(0, 2, 1)).reshape(len(weighted), -1, *weights.shape[1:])
    return Eliminated(by_light, weights, whiten, rows)


def chunks(count: int, bytes_each: int) -> list[slice]:
    """Ranges of pixels that need no more than the working set; at least one pixel each."""
    return slices(count, max(1, WORKING_SET // bytes_each))


def by_unknowns(by_material: Array, layout: ParameterLayout) -> Array:
    """(P, N, C, D) from (P, N, C, 3 or 5): the albedo of a channel changes that channel alone."""
    c = layout.channels
    others = [1] if layout.metallic_known else [1, 2]
    others += [3, 4] if layout.free_normals else []
    jacobian = np.zeros((*by_material.shape[:3], c + len(others)))
    for channel in range(c):
        jacobian[:, :, channel, channel] = by_material[:, :, channel, 0]
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


class Cholesky:
    """Solves with the matrix of some pixels, damped by a share of its `diagonal`.

    Raises LinAlgError if the matrix is not positive definite, which rounding can do to it.
    """

    def __init__(self, matrix: Array, damping: float) -> None:
        from scipy.linalg import cho_factor

        diagonal = np.einsum("ii->i", matrix)
        self.diagonal = diagonal.copy()
        diagonal += damping * np.abs(diagonal) + SCHUR_RIDGE * diagonal.max() + np.finfo(float).tiny
        self._factor = cho_factor(matrix, overwrite_a=True, check_finite=False)

    def solve(self, right: Array) -> Array:
        """The vector that the matrix takes to `right`."""
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve(self._factor, right, check_finite=False))
