"""Normals and albedo of all pixels, and colours of lamps, from pseudo-normals.

A sample of channel c is α_c σ_c max(n·l, 0). With normals and directions from grey samples each
channel leaves a product of albedo and strength, found in alternation; a factor between them remains
in each channel, here such that the geometric mean of the strengths is 1.
"""

from __future__ import annotations

import numpy as np

from pbrfit.fit.lamps.ambiguity import KNOWN_MIN, unit_and_length
from pbrfit.fit.lamps.photometric import PseudoNormals
from pbrfit.fit.lamps.samples import FirstShape, Pixels, Samples, some_of
from pbrfit.fit.sampling import slices
from pbrfit.fit.settings import PIXELS_AT_ONCE
from pbrfit.model.materials import nearest_inside
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array


def finished(
    data: Samples,
    found: PseudoNormals,
    G: Array,
    lamps: Array,
    undetermined: tuple[str, ...],
    rough: Array | None = None,
) -> FirstShape:
    """Normals, albedo and colours from pseudo-normals b G under lamps, directions times strengths.

    A pixel whose samples tell little, because most are in shadow, leans on the rough normals
    (H, W, 3), or on the nearest pixel's that are told: b is the most likely one if beside its own
    samples it is normal about that one, with a precision that is a small part of what pixels know
    on the whole.
    """
    inverse: Array = np.linalg.inv(G).astype(np.float64)
    vectors = found.vectors @ G
    unit, length = unit_and_length(vectors)
    information = found.information(inverse, data.threads)
    # Where lamps lie in a plane no sample tells the third part: the least that is told counts.
    medians = np.median(information, axis=0)
    told = medians[medians > 1e-6 * medians[2]]
    lean = KNOWN_MIN * float(told[0]) if len(told) else 1.0
    known = information[:, 0] > lean
    if not known.all():
        others, certain = np.flatnonzero(~known), known if known.any() else ~known
        if rough is None:
            nearest = nearest_inside(data.plane(certain, 0.0).astype(bool))
            rough = data.plane(unit, 0.0)[nearest]
        expected = float(np.median(length[certain])) * rough[data.where][others]
        precision = found.precision(others, inverse)
        right = np.einsum("pij,pj->pi", precision, vectors[others]) + lean * expected
        vectors[others] = np.linalg.solve(precision + lean * np.eye(3), right[..., None])[..., 0]
    unit, _ = unit_and_length(vectors)
    unit[~unit.any(axis=1)] = 0.0, 0.0, 1.0  # neither the pixel nor a neighbour tells anything
    directions, strengths = unit_and_length(lamps)

    def shaded(pixels: Pixels) -> tuple[Array, Array, Array]:
        """Colours, shading, and the weights of both."""
        colors, told = data.colors(pixels)
        # Pixels of which no sample follows the law have an albedo all the same.
        weights = np.maximum(found.weights(pixels), 1e-6)[..., None] * told
        shading = np.maximum(unit[pixels] @ directions.T, 0.0)
        return colors.astype(np.float64), shading, weights

    colors = strengths_of_channels(*shaded(some_of(len(unit), 20_000)), strengths)
    albedo = np.full((*data.mask.shape, 3), np.nan)

    def fill(piece: slice) -> None:
        row, column = (of[piece] for of in data.where)
        albedo[row, column] = _albedo(*shaded(piece), colors)

    in_pieces(data.threads, fill, slices(len(unit), PIXELS_AT_ONCE))
    return FirstShape(
        normals=data.plane(unit, np.nan),
        albedo=albedo,
        directions=directions,
        strengths=np.broadcast_to(colors, (len(colors), 3)),
        undetermined=undetermined,
    )


def strengths_of_channels(colors: Array, shading: Array, weights: Array, strengths: Array) -> Array:
    """Strengths (N, C) of lamps in each channel, from those of grey samples (N,).

    By `colors` (P, N, C) with weights in [0, 1], and `shading` (P, N), max(n·l, 0).
    """
    tiny = np.finfo(np.float64).tiny
    found = np.repeat(strengths[:, None], colors.shape[2], axis=1)
    below = np.maximum(np.einsum("pnc,pn->nc", weights, shading**2), tiny)
    for _ in range(10):  # both have all samples in common
        albedo = _albedo(colors, shading, weights, found)
        # Pixels count alike, not by the square of their albedo.
        albedo = np.maximum(albedo, 1e-3 * albedo.mean(axis=0) + tiny)
        found = np.einsum("pnc,pnc,pn,pc->nc", weights, colors, shading, 1 / albedo) / below
        found = np.maximum(found, 1e-6 * found.max(axis=0) + tiny)
    return np.asarray(found / np.exp(np.log(found).mean(axis=0)))


def _albedo(colors: Array, shading: Array, weights: Array, strengths: Array) -> Array:
    """Albedo (P, C) by weighted least squares."""
    product = shading[..., None] * strengths
    weighted = weights * product
    below = np.einsum("pnc,pnc->pc", weighted, product)
    above = np.einsum("pnc,pnc->pc", weighted, colors)
    return np.asarray(np.maximum(above, 0.0) / np.maximum(below, np.finfo(np.float64).tiny))


def strengths_along(lamps: Array, directions: Array) -> Array | None:
    """Strengths (N,) of lamps with known directions (N, 3), from factors S (N, 3); their mean is 1.

    A factorisation gives lamps S up to a matrix A with S A = σ d. So (S A)×d = 0 for each lamp:
    linear in A, which is the vector of the least singular value, and σ = (S A)·d. Four lamps, no
    three of them in a plane, tell A up to a factor; a fifth is a check. None if directions do not
    tell them.
    """
    # Rows of [d]ₓ (Aᵀ s): for each lamp three equations in the nine entries of A, row by row.
    cross = np.cross(np.eye(3)[None], directions[:, None])  # e_j × d
    rows = np.einsum("ni,njk->nkij", lamps, cross).reshape(-1, 9)
    _, values, vectors = np.linalg.svd(rows)
    if values[7] < max(3 * values[8], 1e-4 * values[0]):  # A is not told
        return None
    found = np.einsum("ni,nj,ij->n", lamps, directions, vectors[8].reshape(3, 3))
    found *= np.sign(found.sum())
    return None if (found <= 0).any() else np.asarray(found / found.mean())
