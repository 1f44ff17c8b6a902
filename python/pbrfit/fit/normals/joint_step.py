"""One joint Gauss–Newton step of lights, normals and materials of some pixels.

What is lowered, over lights, and over tangent offsets and materials of a subset's pixels, is

    Σ_p ρ_p(Σ ω (I − T)² + Σ_f a_pf (v_pf − m_pf − o_gf)²) + s Σ_gf A_gf o_gf² + offset prior

with a Gaussian prior of mean m and precision a on v = roughness and metallic (f), fitted before
(`pbrfit.fit.priors.mixture`), a common offset o of each cluster g of pixels, which is free but for
a small share s of the summed precision A, and a bounded loss ρ of each pixel, which is in the
weights here: w_p = ρ'.

Materials touch nothing but their own pixel, so they are solved for first (Schur complement). With
J_m, J_q the derivatives of a pixel's residuals r (those of the prior too) by its materials and by
all else that it feels, q = (its tangent offset, the offsets of its cluster, the lights),
A = J_mᵀ J_m and P = J_m A⁻¹ J_mᵀ,

    H = J_qᵀ (1 − P) J_q          h = J_qᵀ (1 − P) r

Then tangent offsets: the smoothness of the normals' changes ties neighbours, so their matrix is a
band as wide as two rows of the subset. It is factorised as such, and what is left is a dense system
of the lights and cluster offsets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.normal_equations import Cholesky, as_in_x, whitening
from pbrfit.fit.normals.offset_prior import TangentOffsetPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SubsetState:
    """Where lights and pixels of a subset stand."""

    x: Array
    cluster_offsets: Array
    """(clusters, F): o."""


def joint_step(
    subset: Objective,
    state: SubsetState,
    material_prior: GaussianPrior,
    offset_prior: TangentOffsetPrior,
    variance: float,
    weights: Array,
    offset_precision: Array,
    damping: float,
) -> Callable[[float], SubsetState]:
    """The step at `state`, as a function of the share of it that is taken.

    `subset` has free normals and unknown lights, `variance` is the noise's, `weights` (P,) are w,
    `offset_precision` (F,) is s of roughness and, where it is free, metallic. The share `damping`
    of their diagonals is added to the pixels' matrices.
    """
    layout, x, prior = subset.layout, state.x, material_prior
    assert layout.tangent_offsets is not None
    assert layout.lighting is not None
    assert prior.cluster is not None
    count, channels = subset.pixels, layout.channels
    unknowns = layout.materials.stop // count
    f_count = unknowns - channels
    pixels = np.arange(count, dtype=np.uint64)
    for_core = subset.for_core(x)
    by_unknowns, by_light, omega = subset.problem.derivatives(for_core, pixels)
    pictures = layout.pictures
    samples = pictures * channels
    of_samples = subset.problem.residuals(for_core, pixels).transpose(1, 0, 2).astype(np.float64)

    # Residuals and their derivatives, weighted; those of the prior come after the samples.
    root = np.sqrt(omega * weights[:, None, None]).reshape(count, samples)
    by_unknowns = by_unknowns.reshape(count, samples, -1)
    materials = np.zeros((count, samples + f_count, unknowns))
    others = np.zeros((count, samples + f_count, 2 + f_count))
    residuals = np.zeros((count, samples + f_count))
    for channel in range(channels):
        of_channel = slice(channel, samples, channels)
        materials[:, of_channel, channel] = by_unknowns[:, of_channel, 0]
    materials[:, :samples, channels:] = by_unknowns[:, :, 1 : 1 + f_count]
    materials[:, :samples] *= root[:, :, None]
    others[:, :samples, :2] = by_unknowns[:, :, 3:] * root[:, :, None]
    residuals[:, :samples] = of_samples.reshape(count, samples) * root
    values = x[layout.materials].reshape(unknowns, count).T
    offsets = x[layout.tangent_offsets].reshape(2, count).T
    root_precision = np.sqrt(prior.precision * weights[:, None])
    deviation = prior.deviation(values[:, channels:], state.cluster_offsets)
    for f in range(f_count):
        materials[:, samples + f, channels + f] = root_precision[:, f]
        others[:, samples + f, 2 + f] = -root_precision[:, f]
        residuals[:, samples + f] = root_precision[:, f] * deviation[:, f]

    # Materials are solved for: whitened rows, and what they cannot explain of all else.
    slope = np.einsum("psd,ps->pd", materials, residuals)
    held = ((values <= 0) & (slope > 0)) | ((values >= 1) & (slope < 0))
    materials *= ~held[:, None, :]
    whiten = whitening(materials.transpose(0, 2, 1) @ materials, held, damping)
    rows = whiten @ materials.transpose(0, 2, 1)
    explained = np.einsum("pds,ps->pd", rows, residuals)
    crossed = rows @ others
    rest = others - rows.transpose(0, 2, 1) @ crossed
    unexplained = residuals - np.einsum("pds,pd->ps", rows, explained)
    own = others.transpose(0, 2, 1) @ rest
    slopes = np.einsum("psq,ps->pq", rest, residuals)

    # Lights, and their ties to materials, tangent offsets and cluster offsets.
    light_channels = layout.light_channels
    size = light_channels * pictures * layout.coefficients
    of_lights = _light_matrix(rows[:, :, :samples], root, by_light, subset)
    by_lights = _onto_lights(unexplained[:, None, :samples] * root[:, None], by_light, subset).sum(
        axis=0
    )[0]
    ties = _onto_lights(rest[:, :samples].transpose(0, 2, 1) * root[:, None], by_light, subset)

    # Dense unknowns: lights, then cluster offsets.
    clusters = prior.clusters
    dense = np.zeros((size + clusters * f_count, size + clusters * f_count))
    dense[:size, :size] = of_lights
    place = size + prior.cluster[:, None] * f_count + np.arange(f_count)
    for f in range(f_count):
        np.add.at(dense[:, :size], place[:, f], ties[:, 2 + f])
        for other in range(f_count):
            np.add.at(dense, (place[:, f], place[:, other]), own[:, 2 + f, 2 + other])
    dense[:size, size:] = dense[size:, :size].T
    totals = offset_precision * prior.sums(prior.precision * weights[:, None])
    np.einsum("ii->i", dense)[size:] += totals.ravel() + np.finfo(float).tiny
    dense_gradient = np.zeros(len(dense))
    dense_gradient[:size] = by_lights
    np.add.at(dense_gradient, place, slopes[:, 2:])
    dense_gradient[size:] += (totals * state.cluster_offsets).ravel()

    # Tangent offsets have a band: solved for next.
    tied = np.zeros((2 * count, len(dense)))
    tied[:, :size] = ties[:, :2].reshape(2 * count, size)
    offset_rows = 2 * np.arange(count)[:, None] + np.arange(2)
    for f in range(f_count):
        tied[offset_rows, place[:, f, None]] += own[:, :2, 2 + f]
    offset_gradient = (slopes[:, :2] + offset_prior.half_gradient(offsets, variance)).ravel()
    right = np.concatenate([tied, offset_gradient[:, None]], axis=1)
    solved = _solve_band(own[:, :2, :2], offset_prior, variance, damping, right)
    dense -= tied.T @ solved[:, :-1]
    dense_gradient -= tied.T @ solved[:, -1]
    dense_moves = -Cholesky(dense, settings.LIGHT_DAMPING * damping).solve(dense_gradient)
    offset_moves = (-solved[:, -1] - solved[:, :-1] @ dense_moves).reshape(count, 2)
    light_moves, cluster_moves = dense_moves[:size], dense_moves[size:].reshape(clusters, f_count)

    # Back to the materials.
    light = light_moves.reshape(light_channels, pictures, layout.coefficients)
    light = np.broadcast_to(light, (channels, *light.shape[1:]))
    along = np.einsum("cnk,pck->pnc", light, by_light).reshape(count, samples) * root
    own_moves = np.concatenate([offset_moves, cluster_moves[prior.cluster]], axis=1)
    whole = explained + np.einsum("pdq,pq->pd", crossed, own_moves)
    whole += np.einsum("pds,ps->pd", rows[:, :, :samples], along)
    material_moves = -np.einsum("pij,pi->pj", whiten, whole)
    longest = settings.NORMALS_ROUGHNESS_STEP_MAX
    material_moves[:, channels] = np.clip(material_moves[:, channels], -longest, longest)
    length = np.linalg.norm(offset_moves, axis=1, keepdims=True)
    length = np.maximum(length, np.finfo(float).tiny)
    offset_moves *= np.minimum(1, settings.NORMALS_OFFSET_STEP_MAX / length)

    def after(share: float) -> SubsetState:
        moved = x.copy()
        materials = np.clip(values + share * material_moves, 0, 1)
        moved[layout.materials] = materials.T.ravel()
        moved[layout.tangent_offsets] += share * offset_moves.T.ravel()
        moved[layout.lighting] += share * as_in_x(light_moves, layout)
        return SubsetState(moved, state.cluster_offsets + share * cluster_moves)

    return after


def _onto_lights(values: Array, by_light: Array, subset: Objective) -> Array:
    """(P, Q, M): sums over samples of `values` (P, Q, samples) times their light's weights."""
    layout = subset.layout
    count, queries, _ = values.shape
    by_channel = values.reshape(count, queries, layout.pictures, layout.channels)
    found = np.empty((count, queries, layout.channels, layout.pictures, layout.coefficients))
    for channel in range(layout.channels):
        np.multiply(
            by_channel[:, :, :, channel, None],
            by_light[:, None, None, channel],
            out=found[:, :, channel],
        )
    if layout.light_channels < layout.channels:
        found = found.sum(axis=2, keepdims=True)
    return found.reshape(count, queries, -1)


def _light_matrix(rows: Array, root: Array, by_light: Array, subset: Objective) -> Array:
    """(M, M): what pixels know of the lights when their materials are solved for."""
    layout = subset.layout
    channels, light_channels, n, k = (
        layout.channels,
        layout.light_channels,
        layout.pictures,
        layout.coefficients,
    )
    blocks = np.zeros((light_channels, n, k, light_channels, n, k))
    found = blocks.reshape(light_channels * n * k, -1)
    weights = np.square(root).reshape(len(root), n, channels)
    for channel in range(channels):
        w = by_light[:, channel]
        c = channel % light_channels
        for picture in range(n):
            blocks[c, picture, :, c, picture] += (w * weights[:, picture, channel, None]).T @ w
        # An albedo touches the lights of its own channel alone.
        of_albedo = rows[:, channel].reshape(len(root), n, channels)[:, :, channel]
        weighted = (of_albedo * root.reshape(len(root), n, channels)[:, :, channel])[:, :, None]
        wide = (weighted * w[:, None]).reshape(len(root), n * k)
        blocks[c, :, :, c] -= (wide.T @ wide).reshape(n, k, n, k)
    wide = _onto_lights(rows[:, channels:] * root[:, None], by_light, subset)
    wide = wide.reshape(-1, len(found))
    found -= wide.T @ wide
    return found


def _solve_band(
    own: Array, prior: TangentOffsetPrior, variance: float, damping: float, right: Array
) -> Array:
    """Solve with the matrix of the tangent offsets, (2P, 2P), which is a band."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    first, second = np.sort(prior.neighbourhood.pairs, axis=1).T
    width = 2 + 2 * int((second - first).max(initial=0))
    # Lower form: entry (i, j) of the matrix, i ≥ j, is at [i − j, j].
    band = np.zeros((width, 2 * len(own)))
    diagonal = prior.diagonal(variance)
    for i in range(2):
        band[0, i::2] = (1 + damping) * own[:, i, i] + diagonal
        np.add.at(band, (2 * (second - first), 2 * first + i), prior.coupling(variance))
    band[1, 0::2] += own[:, 1, 0]
    factor = cholesky_banded(band, lower=True, check_finite=False)
    return np.asarray(cho_solve_banded((factor, True), right, check_finite=False))
