"""Conjugate gradients of joint steps, and their preconditioner, made of few pixels and sums.

A channel's radiance in N pictures is L w, with its lights L (N, K) and the weights w of a pixel. So
is what materials do to it, for they change w alone: it lies in the span of the K columns of L. With
an orthonormal basis Q (N, J) of that, the pixels that are solved for take nothing from the rest:

    S = Q S' Qᵀ + (1 − Q Qᵀ) G (1 − Q Qᵀ)        S⁻¹ = Q S'⁻¹ Qᵀ + (1 − Q Qᵀ) G⁻¹ (1 − Q Qᵀ)

where samples have the same weight in all pictures. S' is the system of J sums Qᵀ I of the pictures
under the lights Qᵀ L, and G, with a block for each picture, that of known materials. So where there
are more than 2 K pictures the system that is factored has the size of K. With other weights the
left out products of both parts are small, and S' is with the mean weights.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pbrfit.fit import settings
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.normal_equations import known_materials, solver_of
from pbrfit.fit.objective import Objective
from pbrfit.values.arrays import Array

Solve = Callable[[Array], Array]


def preconditioner(
    objective: Objective,
    x: Array,
    times: float,
    lights: LightPrior,
    others: Array,
    options: dict[str, Any],
) -> tuple[Solve, int]:
    """S⁻¹ v of one pixel, for v of the lights and what else is shared; and the size of S'.

    Of pixels that stand for so many times as many, with the prior on the lights. `others` is added
    to the diagonal of what is no light, and `options` are for the core. The prior is for all
    `lights.pixels`, which the system is divided by.
    """
    problem, basis = objective.problem, objective.light_basis(x)
    for_core = objective.for_core(x)
    if basis is not None:
        problem, for_core = objective.combined(x, basis)
    matrix, _ = problem.schur_complement(for_core, objective.everything, **options)
    matrix *= times
    end = len(matrix) - len(others)
    matrix[:end, :end] += lights.matrix(basis)
    np.einsum("ii->i", matrix)[end:] += others + np.finfo(float).tiny
    matrix /= lights.pixels
    in_span = solver_of(matrix, settings.LIGHT_RIDGE)  # S'⁻¹, and of what is no light
    size = len(matrix)
    if basis is None:
        return in_span, size
    blocks = times * known_materials(objective, x) + lights.of_pictures()
    ridge = settings.LIGHT_RIDGE * np.einsum("nii->n", blocks) + np.finfo(float).tiny
    np.einsum("nii->ni", blocks)[:] += ridge[:, None]
    beyond = np.asarray(np.linalg.inv(blocks / lights.pixels), np.float64)  # G⁻¹
    channels, pictures, rank = basis.shape

    def solve(v: Array) -> Array:
        end = pictures * beyond.shape[1]
        of_lights = v[:end].reshape(channels, pictures, -1)
        inside = basis.transpose(0, 2, 1) @ of_lights
        solved = in_span(np.concatenate([inside.ravel(), v[end:]]))
        outside = (of_lights - basis @ inside).transpose(1, 0, 2)
        found = (beyond @ outside.reshape(pictures, -1, 1)).reshape(outside.shape)
        found = found.transpose(1, 0, 2)
        count = inside.size
        inside = solved[:count].reshape(channels, rank, -1)
        found = found + basis @ (inside - basis.transpose(0, 2, 1) @ found)
        return np.concatenate([found.ravel(), solved[count:]])

    return solve, size


def conjugate_gradients(
    right: Array,
    product: Callable[[Array], Array],
    solved: Callable[[Array], Array],
    *,
    ratio: float,
    enough: float,
    at_most: int,
    stop: Callable[[], bool],
) -> tuple[Array, int]:
    """S⁻¹ `right` (M,), and the number of products with S, which is positive definite.

    `product` gives S v, `solved` M⁻¹ v of the preconditioner M. It ends at `ratio` of the first
    error, in the norm of M; after `at_most` products; by `stop`; or where a share of `enough`,
    r·M⁻¹r, is left to gain (`settings.CG_GAIN_SHARE`). Where less than `enough` is to gain, nothing
    is done.
    """
    residual, found = right.copy(), np.zeros_like(right)
    direction = preconditioned = solved(residual)
    first = size_now = float(residual @ preconditioned)
    if not first >= enough:
        return found, 0
    number = 0
    while number < at_most and not stop():
        number += 1
        along = product(direction)
        curvature = float(direction @ along)
        if not curvature > 0:
            break
        length = size_now / curvature
        found += length * direction
        residual -= length * along
        preconditioned = solved(residual)
        size_before, size_now = size_now, float(residual @ preconditioned)
        if size_now <= max(ratio**2 * first, settings.CG_GAIN_SHARE * enough):
            break
        direction = preconditioned + size_now / size_before * direction
    return found, number
