"""What explains a picture without a fit of materials: other pictures, and matt surfaces.

Unknown lamps: the samples (pictures × pixels) of a matt surface are a product of lamps and
pseudo-normals, albedo times normal, known up to a 3 × 3 matrix by singular values (Hayakawa,
"Photometric stereo under a light source with arbitrary motion", JOSA A 11, 1994). That is enough
for another picture, whose light is three numbers as well. Known lamps: the pseudo-normal of each
pixel by least squares over all its samples, those in shadow and in highlights too (Woodham,
"Photometric method for determining surface orientation from multiple images", Optical Engineering
19, 1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.samples import grey_samples
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.heldout.light import (
    Score,
    combination,
    curve_of,
    relative_error,
    score,
    target,
)

Array = NDArray[np.float64]

Baseline = Literal["lambert", "lambert-known", "nearest", "sum"]

ROUNDS = 20
"""Of alternating least squares that better strengths of lamps: shadows spoil where these start."""


def explained_by_kept(
    way: Baseline, scene: Scene, kept: Sequence[int], pictures: Sequence[int], lamps: Array | None
) -> tuple[list[Score], Array | None]:
    """How well some pictures of a scene explain others, and normals (H, W, 3) where they have any.

    Files whose tone curve nobody told are read both as sRGB and as linear; the better counts.
    `lamps`, for "lambert-known", are those of all pictures, as of `sources.Opened`.
    """
    readings = [scene, scene.decoded_by("linear")] if scene.response == "srgb" else [scene]
    found = [_read(way, one, kept, pictures, lamps) for one in readings]
    return min(found, key=lambda one: relative_error(one[0]))


def _read(
    way: Baseline, scene: Scene, kept: Sequence[int], pictures: Sequence[int], lamps: Array | None
) -> tuple[list[Score], Array | None]:
    valid = scene.valid
    samples = scene.images[list(kept)][:, valid].astype(np.float64)
    normals = None
    tried = [[samples]] * len(pictures)
    if way == "lambert":
        tried = [[unknown_lamps(samples)]] * len(pictures)
    elif way == "nearest":
        tried = [[one[None] for one in samples]] * len(pictures)
    elif way == "lambert-known":
        assert lamps is not None
        counted = np.stack([target(scene, i, valid, None).weights for i in kept])
        found, albedo = known_lamps(samples, counted, lamps[list(kept)])
        normals = np.full((*valid.shape, 3), np.nan)
        normals[valid] = found
        shading = np.maximum(lamps[list(pictures)] @ found.T, 0.0)
        tried = [[(one[:, None] * albedo)[None]] for one in shading]
    curve, scores = curve_of(scene), []
    for i, of_picture in zip(pictures, tried, strict=True):
        of = target(scene, i, valid, curve)
        shown = [of.explained(partial(combination, planes)) for planes in of_picture]
        scores.append(score(scene, i, min(shown, key=of.left)))
    return scores, normals


def unknown_lamps(samples: Array) -> Array:
    """(3, P, 3): three pictures of a matt surface, of which all others are sums.

    `samples` (N, P, 3) all count. The colour of a pixel is its factor of the grey product.
    """
    left, values, right = np.linalg.svd(samples.mean(axis=-1), full_matrices=False)
    pseudo = right[:3]
    product = (left[:, :3] * values[:3]) @ pseudo
    squares = (product**2).sum(axis=0)
    color = np.einsum("np,npc->pc", product, samples) / np.where(squares > 0, squares, 1.0)[:, None]
    return np.asarray(pseudo[..., None] * color)


def known_lamps(samples: Array, weights: Array, lamps: Array) -> tuple[Array, Array]:
    """Normals and albedo, both (P, 3), of a matt surface, of samples (N, P, 3) and their weights.

    `lamps` (N, 3) are as of `sources.Opened`. Strengths that are unknown start at `strengths_along`
    and alternate with pseudo-normals.
    """
    by_pixel, told = grey_samples(samples.swapaxes(0, 1), (weights > 0).swapaxes(0, 1))
    grey, counted = by_pixel.T, np.where(told.T, weights.max(axis=-1), 0.0)
    if np.allclose(np.linalg.norm(lamps, axis=-1), 1.0):
        directions, lamps = lamps, lamps * strengths_along(lamps, grey)[:, None]
        for _ in range(ROUNDS):
            shading = directions @ _pseudo_normals(grey, counted, lamps).T
            best = (counted * shading * grey).sum(axis=1) / (counted * shading**2).sum(axis=1)
            lamps = directions * (best / best.mean())[:, None]
    pseudo = _pseudo_normals(grey, counted, lamps)
    lengths = np.linalg.norm(pseudo, axis=-1, keepdims=True)
    normals = np.where(lengths > 0, pseudo / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0])
    shading = np.maximum(lamps @ normals.T, 0.0)[..., None]
    squares = (weights * shading**2).sum(axis=0)
    albedo = (weights * shading * samples).sum(axis=0) / np.where(squares > 0, squares, 1.0)
    return normals, np.maximum(albedo, 0.0)


def strengths_along(directions: Array, grey: Array) -> Array:
    """(N,) relative strengths of lamps of known directions, from samples (N, P) that all count.

    The best factors of rank three, u_n of lamp n, are its vector but for a matrix: M u_n is along
    its direction. Of M, up to a factor, that is three linear equations a lamp.
    """
    left, values, _ = np.linalg.svd(grey, full_matrices=False)
    factors = left[:, :3] * values[:3] / values[0]
    across = np.cross(np.eye(3)[None], directions[:, None]).transpose(0, 2, 1)
    equations = np.einsum("nij,nk->nijk", across, factors).reshape(-1, 9)
    matrix = np.linalg.svd(equations)[2][-1].reshape(3, 3)
    found = np.einsum("ni,ij,nj->n", directions, matrix, factors)
    return np.asarray(found / found.mean())


def _pseudo_normals(grey: Array, weights: Array, lamps: Array) -> Array:
    """(P, 3) least squares; the ridge decides where there are no three samples."""
    outer = (lamps[:, :, None] * lamps[:, None]).reshape(-1, 9)
    matrices = (weights.T @ outer).reshape(-1, 3, 3)
    matrices += 1e-9 * np.trace(lamps.T @ lamps) * np.eye(3)
    sums = (weights * grey).T @ lamps
    return np.asarray(np.linalg.solve(matrices, sums[..., None])[..., 0])
