"""Strengths of lamps: of known directions, and of each colour channel.

If the directions d are known but not the strengths, a factorisation gives lamps S up to a matrix A
with S A = σ d. So (S A)×d = 0 for each lamp: linear in A, which is the vector of the least singular
value, and σ = (S A)·d. Four lamps, no three of them in a plane, tell A up to a factor; a fifth is a
check.

A sample of channel c is α_c σ_c max(n·l, 0). With normals and directions from grey samples each
channel leaves a product of albedo and strength, found in alternation; a factor between them remains
in each channel, here such that the geometric mean of the strengths is 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GAP_MIN = 3.0
"""Ratio of the second least to the least singular value of (S A)×d from which on A is told."""

ROUNDS = 10
"""Turns of albedo and strength: they have all samples in common, so few suffice."""


def strengths_along(lamps: Array, directions: Array) -> Array | None:
    """Strengths (N,) of lamps with known directions (N, 3), from factors S (N, 3); their mean is 1.

    None if directions do not tell them.
    """
    # Rows of [d]ₓ (Aᵀ s): for each lamp three equations in the nine entries of A, row by row.
    cross = np.cross(np.eye(3)[None], directions[:, None])  # e_j × d
    rows = np.einsum("ni,njk->nkij", lamps, cross).reshape(-1, 9)
    _, values, vectors = np.linalg.svd(rows, full_matrices=True)
    values = np.concatenate([values, np.zeros(9 - len(values))])
    if values[7] < max(GAP_MIN * values[8], 1e-4 * values[0]):
        return None
    found = np.einsum("ni,nj,ij->n", lamps, directions, vectors[8].reshape(3, 3))
    found *= np.sign(found.sum())
    if (found <= 0).any():
        return None
    return np.asarray(found / found.mean())


def color_of_lamps(
    colors: Array, shading: Array, weights: Array, strengths: Array
) -> tuple[Array, Array]:
    """Albedo (P, 3) and strengths (N, 3) of channels.

    Parameters
    ----------
    colors
        (P, N, C) samples of 1 or 3 channels.
    shading
        (P, N) max(n·l, 0).
    weights
        (P, N, C) in [0, 1] of samples.
    strengths
        (N,) of grey samples.
    """
    tiny = np.finfo(np.float64).tiny
    albedos, found = [], []
    for c in range(colors.shape[2]):
        strength, w = np.maximum(strengths, 0.0), weights[..., c]
        for _ in range(ROUNDS):
            product = shading * strength
            albedo = np.einsum("pn,pn,pn->p", w, product, colors[..., c]) / np.maximum(
                np.einsum("pn,pn,pn->p", w, product, product), tiny
            )
            albedo = np.maximum(albedo, 0.0)
            # Pixels count alike, not by the square of their albedo.
            even = w / np.maximum(albedo, 1e-3 * albedo.mean() + tiny)[:, None] ** 2
            product = shading * albedo[:, None]
            strength = np.einsum("pn,pn,pn->n", even, product, colors[..., c]) / np.maximum(
                np.einsum("pn,pn,pn->n", even, product, product), tiny
            )
            strength = np.maximum(strength, 1e-6 * strength.max() + tiny)
        mean = float(np.exp(np.log(strength).mean()))
        albedos.append(albedo * mean)
        found.append(strength / mean)
    if len(found) == 1:
        albedos, found = albedos * 3, found * 3
    return np.stack(albedos, axis=1), np.stack(found, axis=1)
