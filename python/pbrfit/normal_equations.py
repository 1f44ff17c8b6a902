"""Normal equations of materials and lights: pixels solved for, lights left (Schur complement)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.layout import Layout

Array = NDArray[np.float64]

RIDGE = 1e-12
"""Added to matrices of unit diagonal before they are inverted; far below what data can tell."""

SINGULAR = 1e8
"""Where the other unknowns of a pixel raise a variance by more than this, rounding has decided it:
the matrices are sums of float64 products, and the pictures have 7 digits."""

WORKING_SET = 1 << 26
"""Bytes of the largest array that a piece of work may need."""


@dataclass(frozen=True, eq=False)
class Inverse:
    """Inverse matrices of pixels, (P, D, D), and the unknowns about which they say nothing, (P, D).

    Rows and columns of the latter and of unknowns that are held are 0.
    """

    matrices: Array
    singular: NDArray[np.bool_]


def inverse(matrices: Array, held: NDArray[np.bool_]) -> Inverse:
    """Of symmetric positive semidefinite matrices (P, D, D) without the unknowns `held` (P, D).

    An unknown is singular if radiance does not depend on it at all, or if others can make up for
    it completely.
    """
    scaled, scale = _scaled(matrices, held)
    inverted = np.linalg.inv(scaled)
    inflation = np.einsum("pii->pi", inverted)
    singular = ~held & ((scale == 0) | (inflation > SINGULAR))
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


def held_at_bounds(x: Array, layout: Layout) -> NDArray[np.bool_]:
    """(P, D): unknowns of pixels that lie on a bound."""
    materials = x[layout.maps].reshape(-1, layout.pixels).T
    return (materials <= 0) | (materials >= 1)


@dataclass(frozen=True, eq=False)
class LightInformation:
    """What a set of pixels says about the lights. The M unknowns are (N, light channels, K).

    Attributes
    ----------
    alone
        (N, light channels, K, K): if the materials were known. Blocks of one light each, in one
        channel; all others are 0.
    shared
        (M, M): if they are fitted too, the Schur complement alone − Σ_p Bᵀ A⁻¹ B.
    unknowns
        Number of unknown materials that were solved for.
    """

    alone: Array
    shared: Array
    unknowns: int


def light_information(
    problem: _core.Problem,
    x: Array,
    layout: Layout,
    pixels: NDArray[np.uint64],
    held: NDArray[np.bool_],
) -> LightInformation:
    """Sum over pixels, in their order; `held` (P', D) are unknowns that are no unknowns.

    With J the derivatives of a pixel's radiance by its D unknowns, ω the weights of its samples and
    w_ck the derivatives by the light,

        A = Σ_ic ω_ic J_ic J_icᵀ      B[θ, ick] = ω_ic J_icθ w_ck

    Each pixel's share is positive semidefinite: pixels are not scaled apart, so the sum is too.
    """
    lit, k = layout.light_channels, layout.coefficients
    size = layout.pictures * lit * k
    alone = np.zeros((layout.pictures, lit, k, k))
    solved_for = np.zeros((size, size))
    unknowns = held.shape[1]
    for chunk in chunks(len(pixels), 8 * unknowns * size):
        by_material, by_light, weights = problem.derivatives(x, pixels[chunk])
        jacobian = _by_unknowns(by_material, layout)
        jacobian *= ~held[chunk, None, None, :]
        scaled, scale = _scaled(_products(jacobian, weights), held[chunk])
        gram = np.einsum("pnc,pck,pcl->nckl", weights, by_light, by_light, optimize=True)
        # A⁻¹ = S (L Lᵀ)⁻¹ S with Cholesky's L, so Bᵀ A⁻¹ B = rowsᵀ rows with rows = L⁻¹ S B.
        jacobian *= weights[..., None]
        jacobian *= scale[:, None, None, :]
        rows = np.linalg.solve(
            np.linalg.cholesky(scaled),
            jacobian.reshape(len(jacobian), -1, unknowns).transpose(0, 2, 1),
        ).reshape(-1, layout.pictures, layout.channels, 1)
        rows = rows * np.repeat(by_light, unknowns, axis=0)[:, None]
        if lit < layout.channels:
            rows, gram = rows.sum(axis=2), gram.sum(axis=1, keepdims=True)
        rows = rows.reshape(-1, size)
        solved_for += rows.T @ rows
        alone += gram
    shared = -solved_for
    blocks = shared.reshape(layout.pictures * lit, k, layout.pictures * lit, k)
    diagonal = np.arange(layout.pictures * lit)
    blocks[diagonal, :, diagonal, :] += alone.reshape(-1, k, k)
    return LightInformation(alone, shared, int(np.count_nonzero(~held)))


def chunks(count: int, bytes_each: int) -> list[slice]:
    """Ranges of pixels that need no more than the working set; at least one pixel each."""
    step = max(1, WORKING_SET // bytes_each)
    return [slice(first, min(first + step, count)) for first in range(0, count, step)]


def _by_unknowns(by_material: Array, layout: Layout) -> Array:
    """(P, N, C, D) from (P, N, C, 3): the albedo of a channel changes that channel alone."""
    c = layout.channels
    unknowns = c + (1 if layout.metallic_known else 2)
    jacobian = np.zeros((*by_material.shape[:3], unknowns))
    for channel in range(c):
        jacobian[:, :, channel, channel] = by_material[:, :, channel, 0]
    jacobian[..., c:] = by_material[..., 1 : 1 + unknowns - c]
    return jacobian


def _products(jacobian: Array, weights: Array) -> Array:
    """Jᵀ Ω J, (P, D, D)."""
    pixels, unknowns = len(jacobian), jacobian.shape[-1]
    rows = jacobian.reshape(pixels, -1, unknowns)
    weighted = rows * weights.reshape(pixels, -1, 1)
    return np.asarray(weighted.transpose(0, 2, 1) @ rows)
