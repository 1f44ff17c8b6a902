"""One joint Gauss–Newton step of lights, normals and materials of some pixels.

What is lowered, over lights, and over tilts and materials of the pixels of a lattice, is

    Σ_p ρ_p(Σ ω (I − T)² + Σ_f a_pf (v_pf − c_pf − o_gf)²) + s Σ_gf A_gf o_gf² + prior of the tilts

with v = roughness and metallic (f) drawn to what was learnt (`pbrfit.fit.priors.material`), a
common offset o of each cluster g of pixels, which is free but for a small share s, and a bounded
loss ρ of each pixel, which is in the weights here: w_p = ρ'.

Materials touch nothing but their own pixel, so they are solved for first (Schur complement). With
J_m, J_q the derivatives of a pixel's residuals r (pulls are residuals too) by its materials and by
all else that it feels, q = (its tilt, the offsets of its cluster, the lights), A = J_mᵀ J_m and
P = J_m A⁻¹ J_mᵀ,

    H = J_qᵀ (1 − P) J_q          h = J_qᵀ (1 − P) r

Then tilts: the smoothness of their changes ties neighbours, so their matrix is a band as wide as
two rows of the lattice. It is factorised as such, and what is left is a dense system of the lights
and offsets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.normal_equations import RIDGE, Cholesky, as_in_x
from pbrfit.fit.normals.offset_prior import TiltPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior

Array = NDArray[np.float64]

LIGHT_DAMPING = 1e-3
"""Damping of the lights as a share of that of pixels."""

REACH = 0.3
"""Longest step of a tilt."""

ROUGHNESS_REACH = 0.25


@dataclass(frozen=True, eq=False)
class State:
    """Where lights and pixels stand.

    Attributes
    ----------
    x
        Of the pixels' objective.
    offsets
        (clusters, F) of the pull.
    """

    x: Array
    offsets: Array


def moves(
    few: Objective,
    state: State,
    pull: GaussianPrior,
    prior: TiltPrior,
    variance: float,
    weights: Array,
    offset_pull: Array,
    damping: float,
) -> Callable[[float], State]:
    """The step at `state`, as a function of the share of it that is taken.

    Parameters
    ----------
    few
        The objective of the pixels, with free normals and unknown lights.
    pull, prior, variance
        Of roughness and metallic, of the tilts, and the noise's.
    weights
        (P,): w.
    offset_pull
        (F,): s of roughness and, where it is free, metallic.
    damping
        Share of their diagonals that is added to the pixels' matrices.
    """
    layout, x = few.layout, state.x
    assert layout.tangent_offsets is not None
    assert layout.lighting is not None
    assert pull.cluster is not None
    count, channels = few.pixels, layout.channels
    unknowns = layout.materials.stop // count
    finish = unknowns - channels
    pixels = np.arange(count, dtype=np.uint64)
    for_core = few.for_core(x)
    by_unknowns, by_light, omega = few.problem.derivatives(for_core, pixels)
    pictures = layout.pictures
    samples = pictures * channels
    residuals = few.problem.residuals(for_core, pixels).transpose(1, 0, 2).astype(np.float64)

    # Residuals and their derivatives, weighted; the pulls come after the samples.
    root = np.sqrt(omega * weights[:, None, None]).reshape(count, samples)
    by_unknowns = by_unknowns.reshape(count, samples, -1)
    materials = np.zeros((count, samples + finish, unknowns))
    others = np.zeros((count, samples + finish, 2 + finish))
    left = np.zeros((count, samples + finish))
    for channel in range(channels):
        of_channel = slice(channel, samples, channels)
        materials[:, of_channel, channel] = by_unknowns[:, of_channel, 0]
    materials[:, :samples, channels:] = by_unknowns[:, :, 1 : 1 + finish]
    materials[:, :samples] *= root[:, :, None]
    others[:, :samples, :2] = by_unknowns[:, :, 3:] * root[:, :, None]
    left[:, :samples] = residuals.reshape(count, samples) * root
    values = x[layout.materials].reshape(unknowns, count).T
    tilts = x[layout.tangent_offsets].reshape(2, count).T
    strength = np.sqrt(pull.precision * weights[:, None])
    off = values[:, channels:] - pull.mean - state.offsets[pull.cluster]
    for f in range(finish):
        materials[:, samples + f, channels + f] = strength[:, f]
        others[:, samples + f, 2 + f] = -strength[:, f]
        left[:, samples + f] = strength[:, f] * off[:, f]

    # Materials are solved for: whitened rows, and what they cannot explain of all else.
    slope = np.einsum("psd,ps->pd", materials, left)
    held = ((values <= 0) & (slope > 0)) | ((values >= 1) & (slope < 0))
    materials *= ~held[:, None, :]
    whiten = _whitened(materials, damping)
    rows = whiten @ materials.transpose(0, 2, 1)
    explained = np.einsum("pds,ps->pd", rows, left)
    crossed = rows @ others
    rest = others - rows.transpose(0, 2, 1) @ crossed
    unexplained = left - np.einsum("pds,pd->ps", rows, explained)
    own = others.transpose(0, 2, 1) @ rest
    slopes = np.einsum("psq,ps->pq", rest, left)

    # Lights, and their ties to materials, tilts and offsets.
    lit = layout.light_channels
    size = lit * pictures * layout.coefficients
    of_lights = _light_matrix(rows[:, :, :samples], root, by_light, few)
    by_lights = _onto_lights(unexplained[:, None, :samples] * root[:, None], by_light, few).sum(
        axis=0
    )[0]
    ties = _onto_lights(rest[:, :samples].transpose(0, 2, 1) * root[:, None], by_light, few)

    # Dense unknowns: lights, then offsets.
    clusters = pull.clusters
    dense = np.zeros((size + clusters * finish, size + clusters * finish))
    dense[:size, :size] = of_lights
    place = size + pull.cluster[:, None] * finish + np.arange(finish)
    for f in range(finish):
        np.add.at(dense[:, :size], place[:, f], ties[:, 2 + f])
        for other in range(finish):
            np.add.at(dense, (place[:, f], place[:, other]), own[:, 2 + f, 2 + other])
    dense[:size, size:] = dense[size:, :size].T
    totals = offset_pull * pull.sums(pull.precision * weights[:, None])
    np.einsum("ii->i", dense)[size:] += totals.ravel() + np.finfo(float).tiny
    right = np.zeros(len(dense))
    right[:size] = by_lights
    np.add.at(right, place, slopes[:, 2:])
    right[size:] += (totals * state.offsets).ravel()

    # Tilts are a band: solved for next.
    tied = np.zeros((2 * count, len(dense)))
    tied[:, :size] = ties[:, :2].reshape(2 * count, size)
    tilt_rows = 2 * np.arange(count)[:, None] + np.arange(2)
    for f in range(finish):
        tied[tilt_rows, place[:, f, None]] += own[:, :2, 2 + f]
    tilt_slope = (slopes[:, :2] + prior.slope(tilts, variance)).ravel()
    band = _Band(own[:, :2, :2], prior, variance, damping)
    solved = band.solve(np.concatenate([tied, tilt_slope[:, None]], axis=1))
    dense -= tied.T @ solved[:, :-1]
    right -= tied.T @ solved[:, -1]
    all_moves = -Cholesky(dense, LIGHT_DAMPING * damping).solve(right)
    turned = (-solved[:, -1] - solved[:, :-1] @ all_moves).reshape(count, 2)
    light_moves, offset_moves = all_moves[:size], all_moves[size:].reshape(clusters, finish)

    # Back to the materials.
    light = light_moves.reshape(lit, pictures, layout.coefficients)
    light = np.broadcast_to(light, (channels, *light.shape[1:]))
    along = np.einsum("cnk,pck->pnc", light, by_light).reshape(count, samples) * root
    own_moves = np.concatenate([turned, offset_moves[pull.cluster]], axis=1)
    whole = explained + np.einsum("pdq,pq->pd", crossed, own_moves)
    whole += np.einsum("pds,ps->pd", rows[:, :, :samples], along)
    changed = -np.einsum("pij,pi->pj", whiten, whole)
    changed[:, channels] = np.clip(changed[:, channels], -ROUGHNESS_REACH, ROUGHNESS_REACH)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    turned *= np.minimum(1, REACH / np.maximum(length, np.finfo(float).tiny))

    def taken(share: float) -> State:
        moved = x.copy()
        materials = np.clip(values + share * changed, 0, 1)
        moved[layout.materials] = materials.T.ravel()
        moved[layout.tangent_offsets] += share * turned.T.ravel()
        moved[layout.lighting] += share * as_in_x(light_moves, layout)
        return State(moved, state.offsets + share * offset_moves)

    return taken


def _whitened(materials: Array, damping: float) -> Array:
    """U with U A Uᵀ = 1, A = J_mᵀ J_m of each pixel, (P, D, D); 0 for what nothing depends on."""
    matrices = materials.transpose(0, 2, 1) @ materials
    diagonal = np.einsum("pii->pi", matrices)
    used = diagonal > np.finfo(np.float64).tiny
    scale = np.zeros_like(diagonal)
    np.divide(1, np.sqrt(diagonal, where=used, out=scale), where=used, out=scale)
    scaled = matrices * scale[:, :, None] * scale[:, None, :]
    np.einsum("pii->pi", scaled)[:] = 1 + RIDGE + damping
    return np.asarray(np.linalg.inv(np.linalg.cholesky(scaled)) * scale[:, None, :])


def _onto_lights(values: Array, by_light: Array, few: Objective) -> Array:
    """(P, Q, M): sums over samples of `values` (P, Q, samples) times their light's weights."""
    layout = few.layout
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


def _light_matrix(rows: Array, root: Array, by_light: Array, few: Objective) -> Array:
    """(M, M): what pixels know of the lights when their materials are solved for."""
    layout = few.layout
    channels, lit, n, k = (
        layout.channels,
        layout.light_channels,
        layout.pictures,
        layout.coefficients,
    )
    blocks = np.zeros((lit, n, k, lit, n, k))
    found = blocks.reshape(lit * n * k, -1)
    squares = np.square(root).reshape(len(root), n, channels)
    for channel in range(channels):
        w = by_light[:, channel]
        c = channel % lit
        for picture in range(n):
            blocks[c, picture, :, c, picture] += (w * squares[:, picture, channel, None]).T @ w
        # An albedo touches the lights of its own channel alone.
        of_albedo = rows[:, channel].reshape(len(root), n, channels)[:, :, channel]
        weighted = (of_albedo * root.reshape(len(root), n, channels)[:, :, channel])[:, :, None]
        wide = (weighted * w[:, None]).reshape(len(root), n * k)
        blocks[c, :, :, c] -= (wide.T @ wide).reshape(n, k, n, k)
    wide = _onto_lights(rows[:, channels:] * root[:, None], by_light, few)
    wide = wide.reshape(-1, len(found))
    found -= wide.T @ wide
    return found


class _Band:
    """The matrix of the tilts, (2P, 2P), which is a band: solves with it."""

    def __init__(self, own: Array, prior: TiltPrior, variance: float, damping: float) -> None:
        from scipy.linalg import cholesky_banded

        count = len(own)
        first, second = np.sort(prior.around.pairs, axis=1).T
        width = 2 + 2 * int((second - first).max(initial=0))
        # Lower form: entry (i, j) of the matrix, i ≥ j, is at [i − j, j].
        band = np.zeros((width, 2 * count))
        diagonal = prior.diagonal(variance)
        for i in range(2):
            band[0, i::2] = (1 + damping) * own[:, i, i] + diagonal
            np.add.at(band, (2 * (second - first), 2 * first + i), prior.coupling(variance))
        band[1, 0::2] += own[:, 1, 0]
        self._factor = cholesky_banded(band, lower=True, check_finite=False)

    def solve(self, right: Array) -> Array:
        from scipy.linalg import cho_solve_banded

        return np.asarray(cho_solve_banded((self._factor, True), right, check_finite=False))
