"""The light of a picture whose materials are known: exact linear least squares.

A pixel's radiance is Σ_k w_k L_k (`pbrfit.shade` gives the w_k), so the light of one channel solves
a linear problem with as many rows as there are pixels and 16 columns. It is solved by QR, not by
normal equations, whose condition number is the square and would lose half of the digits. The rows
come in blocks: with QR = [A₁ b₁], the triangle R takes the place of all rows so far, so that memory
does not grow with the picture.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import view_directions
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, shade

Array = NDArray[np.float64]

BLOCK = 4096
"""Pixels at a time."""

UNDETERMINED = 1e-12
"""Combinations of unknowns whose singular value is below this share of the largest are left 0: with
flat normals, for one, pictures do not show most of the light."""


def fit_lights(
    images: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None,
    materials: Materials,
    normals: NDArray[np.floating[Any]],
    fov: float,
    model: Model,
) -> Array:
    """Lights that explain pictures best, each on its own.

    Parameters
    ----------
    images
        (N, H, W, 3), linear.
    weights
        (N, H, W), how much each sample counts; None = all the same.
    materials, normals
        Maps of (H, W) pixels; those with NaN are left out.
    fov
        Horizontal field of view in degrees.
    model
        How the materials reflect light.

    Returns
    -------
    (N, 16, 3) in picture units.
    """
    used = np.isfinite(materials.albedo).all(-1) & np.isfinite(normals).all(-1)
    used &= np.isfinite(materials.roughness) & np.isfinite(materials.metallic)
    rows = np.flatnonzero(used)
    height, width = used.shape
    views = view_directions(height, width, fov).reshape(-1, 3)
    flat = [a.reshape(-1, *a.shape[2:]) for a in (materials.albedo, normals)]
    maps = [materials.roughness.ravel(), materials.metallic.ravel()]
    # Pictures that count all samples alike share their rows, and so their factorisation.
    groups = _groups(weights, used, len(images))
    triangles = [[np.zeros((0, 16 + len(group)))] * 3 for group in groups]
    for begin in range(0, len(rows), BLOCK):
        at = rows[begin : begin + BLOCK]
        design = shade(
            *(flat[1][at], views[at], flat[0][at], maps[0][at], maps[1][at]), model=model
        )
        samples = images.reshape(len(images), -1, 3)[:, at]
        for of, group in zip(triangles, groups, strict=True):
            counts = None if weights is None else weights[group[0]].ravel()[at]
            for c in range(3):
                block = np.column_stack([design[:, c], samples[group, :, c].T.astype(np.float64)])
                of[c] = _joined(of[c], _weighted(block, counts))
    lights = np.empty((len(images), 16, 3))
    for of, group in zip(triangles, groups, strict=True):
        for c in range(3):
            lights[group, :, c] = _solution(of[c], 16).T
    return lights


def _groups(
    weights: NDArray[np.floating[Any]] | None, used: NDArray[np.bool_], pictures: int
) -> list[list[int]]:
    """Indices of pictures by equal weights: those with all the same together, others alone."""
    if weights is None:
        return [list(range(pictures))]
    alike = [i for i in range(pictures) if np.ptp(weights[i][used]) == 0 and weights[i][used].all()]
    return [*([alike] if alike else []), *([i] for i in range(pictures) if i not in alike)]


def best_combination(
    others: NDArray[np.floating[Any]],
    image: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None,
    valid: NDArray[np.bool_],
) -> Array:
    """(H, W, 3): the combination of other pictures, a factor each and channel, nearest to `image`.

    Light adds up, so a picture under a light that is a sum of others is the sum of their pictures,
    whatever the scene is made of. This is what can be had without any model of materials.
    """
    rows = np.flatnonzero(valid)
    found = np.full(image.shape, np.nan)
    counts = None if weights is None else weights.ravel()
    for c in range(3):
        planes = others[..., c].reshape(len(others), -1)
        target = image[..., c].ravel()
        triangle = np.zeros((0, len(others) + 1))
        for begin in range(0, len(rows), BLOCK):
            at = rows[begin : begin + BLOCK]
            block = np.column_stack([planes[:, at].T, target[at]]).astype(np.float64)
            triangle = _joined(triangle, _weighted(block, None if counts is None else counts[at]))
        factors = _solution(triangle, len(others))[:, 0]
        found[valid, c] = factors @ planes[:, rows]
    return found


def _weighted(block: Array, weights: NDArray[np.floating[Any]] | None) -> Array:
    """Rows times the root of their weight; those of weight 0 may hold anything."""
    if weights is None:
        return block
    counted = weights > 0
    return np.asarray(block[counted] * np.sqrt(weights[counted], dtype=np.float64)[:, None])


def _joined(triangle: Array, block: Array) -> Array:
    """R of the rows that `triangle` stands for and more."""
    return np.asarray(np.linalg.qr(np.vstack([triangle, block]), mode="r"), dtype=np.float64)


def _solution(triangle: Array, unknowns: int) -> Array:
    """Least-squares solutions (unknowns, J) of the systems [A b₁ ... b_J] that R stands for."""
    design, right = triangle[:, :unknowns], triangle[:, unknowns:]
    found, *_ = np.linalg.lstsq(design, right, rcond=UNDETERMINED)
    return np.asarray(found)
