"""The light of a picture whose materials are known: linear least squares.

A pixel's radiance is Σ_k w_k L_k (`pbrfit.shade` gives the w_k), so the light of one channel solves
a linear problem with as many rows as there are pixels and 16 columns. It is solved by QR, not by
normal equations, whose condition number is the square and would lose half of the digits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import view_directions
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, shade

Array = NDArray[np.float64]

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
        (N, H, W, 3), how much each value counts; None = all the same.
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
    maps = (materials.albedo, materials.roughness, materials.metallic)
    used = np.isfinite(normals).all(-1)
    for values in maps:
        used &= np.isfinite(values).reshape(*used.shape, -1).all(-1)
    height, width = used.shape
    views = view_directions(height, width, fov)[used]
    design = shade(normals[used], views, *(values[used] for values in maps), model=model)
    lights = np.empty((len(images), 16, 3))
    for c in range(3):
        of_channel = None if weights is None else weights[..., c]
        for group in _alike(of_channel, used, len(images)):
            counts = None if of_channel is None else of_channel[group[0]][used]
            samples = images[group][:, used, c].T
            lights[group, :, c] = _solved(design[:, c], samples, counts).T
    return lights


def _alike(
    weights: NDArray[np.floating[Any]] | None, used: NDArray[np.bool_], pictures: int
) -> list[list[int]]:
    """Indices of pictures: those that count all samples alike together, others alone."""
    even = [
        i
        for i in range(pictures)
        if weights is None or (np.ptp(weights[i][used]) == 0 and weights[i][used].all())
    ]
    return [*([even] if even else []), *([i] for i in range(pictures) if i not in even)]


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
    found = np.full(image.shape, np.nan)
    counts = None if weights is None else weights[valid]
    for c in range(3):
        planes = others[:, valid, c]
        of_channel = None if counts is None else counts[:, c]
        factors = _solved(planes.T, image[valid][:, c : c + 1], of_channel)[:, 0]
        found[valid, c] = factors @ planes
    return found


def _solved(
    design: NDArray[np.floating[Any]],
    samples: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None,
) -> Array:
    """Least-squares solutions (K, J) of (P, K) x = (P, J); rows of weight 0 may hold anything."""
    rows = np.column_stack([design, samples]).astype(np.float64)
    if weights is not None:
        counted = weights > 0
        rows = rows[counted] * np.sqrt(weights[counted], dtype=np.float64)[:, None]
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    unknowns = design.shape[1]
    found, *_ = np.linalg.lstsq(triangle[:, :unknowns], triangle[:, unknowns:], UNDETERMINED)
    return np.asarray(found)


def nearest(
    others: NDArray[np.floating[Any]],
    image: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None,
    valid: NDArray[np.bool_],
) -> Array:
    """(H, W, 3): of other pictures, a factor each and channel, the one with the least error."""
    of = np.ones(image.shape) if weights is None else weights
    tried = [best_combination(one[None], image, weights, valid) for one in others]
    errors = [(of[valid] * (one[valid] - image[valid]) ** 2).sum() for one in tried]
    return tried[int(np.argmin(errors))]
