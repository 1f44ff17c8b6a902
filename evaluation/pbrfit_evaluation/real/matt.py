"""A matt surface under unknown distant lamps, one a picture.

The samples (pictures × pixels) are a product of lamps and pseudo-normals, albedo times normal: the
best of rank three by singular values, known up to a 3 × 3 matrix (Hayakawa, "Photometric stereo
under a light source with arbitrary motion", JOSA A 11, 1994). That is enough for another picture:
its light is a vector of three numbers as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit_evaluation.real.lights import best_combination

Array = NDArray[np.float64]


def unknown_lamps(samples: Array) -> Array:
    """(3, P, 3): three pictures of a matt surface, of which all others are sums.

    `samples` (N, P, 3) all count. The colour of a pixel is its factor of the grey product.
    """
    grey = samples.mean(axis=-1)
    left, values, right = np.linalg.svd(grey, full_matrices=False)
    pseudo = right[:3]
    product = (left[:, :3] * values[:3]) @ pseudo
    squares = (product**2).sum(axis=0)
    color = np.einsum("np,npc->pc", product, samples) / np.where(squares > 0, squares, 1.0)[:, None]
    return np.asarray(pseudo[..., None] * color)


def best_light(
    basis: Array,
    picture: NDArray[np.floating[Any]],
    weights: NDArray[np.floating[Any]] | None,
    valid: NDArray[np.bool_],
) -> Array:
    """(H, W, 3): the sum of pictures (K, P, 3) nearest to another, a factor each and channel.

    Negative radiance, where the lamp is behind the surface, is 0.
    """
    planes = np.full((len(basis), *picture.shape), np.nan)
    planes[:, valid] = basis
    return np.asarray(np.maximum(best_combination(planes, picture, weights, valid), 0.0))
