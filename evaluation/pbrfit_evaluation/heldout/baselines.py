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
from typing import Literal, get_args

import numpy as np
from scipy.interpolate import RBFInterpolator

from pbrfit.export.rti import basis as polynomial
from pbrfit.export.rti import harmonics
from pbrfit.fit.lamps.samples import grey_samples
from pbrfit.fit.lamps.surface import strengths_along
from pbrfit.model.lamps import Lamps
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Mask
from pbrfit_evaluation.heldout.light import (
    Score,
    combination,
    curve_of,
    relative_error,
    score,
    target,
)

Interpolated = Literal["ptm", "hsh", "pca"]
"""Relightable images, which have no normals."""

UnderKnown = Literal["lambert-known", "lambert-trimmed", Interpolated]
"""What is told the directions of the lamps, and their strengths where these are known."""

Baseline = Literal["lambert", "nearest", "sum", UnderKnown]

ROUNDS = 20
"""Of alternating least squares that better strengths of lamps: shadows spoil where these start."""

TRIMMED = 0.25
"""Share of a pixel's samples that trimmed least squares leaves out at each end: cast shadows are
the darkest, highlights the brightest."""

UNKNOWNS = 3
"""Of a pseudo-normal: as few samples are kept."""

COMPONENTS = 8
"""Principal components, as many as the web viewers of relightable images keep."""


def explained_by_kept(
    way: Baseline, scene: Scene, kept: Sequence[int], pictures: Sequence[int], lamps: Lamps | None
) -> tuple[list[Score], Array | None]:
    """How well some pictures of a scene explain others, and normals (H, W, 3) where they have any.

    Files whose tone curve nobody told are read both as sRGB and as linear; the better counts.
    `lamps`, for `UnderKnown`, are those of all pictures, as of `sources.Opened`.
    """
    readings = [scene, scene.decoded_by("linear")] if scene.response == "srgb" else [scene]
    found = [_read(way, one, kept, pictures, lamps) for one in readings]
    return min(found, key=lambda one: relative_error(one[0]))


def _read(
    way: Baseline, scene: Scene, kept: Sequence[int], pictures: Sequence[int], lamps: Lamps | None
) -> tuple[list[Score], Array | None]:
    valid = scene.valid
    samples = scene.images[list(kept)][:, valid].astype(np.float64)
    normals = None
    tried = [[samples]] * len(pictures)
    if way == "lambert":
        tried = [[unknown_lamps(samples)]] * len(pictures)
    elif way == "nearest":
        tried = [[one[None] for one in samples]] * len(pictures)
    elif way in get_args(UnderKnown):
        assert lamps is not None
        weights = np.stack([target(scene, i, valid, None).weights for i in kept])
        under, seek = lamps.places[list(kept)], lamps.places[list(pictures)]
        if lamps.colored:
            strengths = np.maximum(lamps.colors[list(kept)], np.finfo(np.float64).tiny)
        else:
            strengths = strengths_of(samples, weights, under)[:, None]
        samples /= strengths[:, None]
        if way in ("lambert-known", "lambert-trimmed"):
            found, albedo = known_lamps(samples, weights, under, trim=way == "lambert-trimmed")
            normals = np.full((*valid.shape, 3), np.nan)
            normals[valid] = found
            shown = np.maximum(seek @ found.T, 0.0)[..., None] * albedo
        else:
            shown = _interpolated(way, samples, weights, under, seek)
        tried = [[one[None]] for one in shown]
    curve, scores = curve_of(scene), []
    for i, of_picture in zip(pictures, tried, strict=True):
        of = target(scene, i, valid, curve)
        planes = [of.explained(partial(combination, one)) for one in of_picture]
        scores.append(score(scene, i, min(planes, key=of.left)))
    return scores, normals


def _interpolated(
    way: Baseline, samples: Array, weights: Array, under: Array, seek: Array
) -> Array:
    """(M, P, 3): pictures under far lamps along `seek` (M, 3), as relightable images give them.

    Of samples (N, P, 3) with their weights under lamps along `under` (N, 3). "ptm" and
    "hsh": the polynomial and the hemispherical harmonics, both of order 2, of `pbrfit.export.rti`.
    "pca": principal components of the pictures, whose factors are interpolated over (l_u, l_v) by
    thin plates.
    """
    flat = samples.reshape(len(samples), -1)
    if way == "pca":
        mean = flat.mean(axis=0)
        left, values, right = np.linalg.svd(flat - mean, full_matrices=False)
        factors = RBFInterpolator(under[:, :2], left[:, :COMPONENTS])(seek[:, :2])
        found = mean + (factors * values[:COMPONENTS]) @ right[:COMPONENTS]
    else:
        terms = polynomial if way == "ptm" else harmonics
        factors = _least_squares(flat, weights.reshape(flat.shape), terms(under))
        found = terms(seek) @ factors.T
    return np.asarray(np.maximum(found, 0.0).reshape(-1, *samples.shape[1:]))


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


def known_lamps(
    samples: Array, weights: Array, lamps: Array, *, trim: bool = False
) -> tuple[Array, Array]:
    """Normals and albedo, both (P, 3), of a matt surface, of samples (N, P, 3) and their weights.

    `lamps` (N, 3) are unit vectors to lamps that are equally strong. `trim` leaves out a pixel's
    darkest and brightest samples.
    """
    grey, counted = _grey(samples, weights)
    if trim:
        middle = _middle(grey, counted > 0)
        counted, weights = counted * middle, weights * middle[..., None]
    pseudo = _least_squares(grey, counted, lamps)
    lengths = np.linalg.norm(pseudo, axis=-1, keepdims=True)
    normals = np.where(lengths > 0, pseudo / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0])
    shading = np.maximum(lamps @ normals.T, 0.0)[..., None]
    squares = (weights * shading**2).sum(axis=0)
    albedo = (weights * shading * samples).sum(axis=0) / np.where(squares > 0, squares, 1.0)
    return normals, np.maximum(albedo, 0.0)


def strengths_of(samples: Array, weights: Array, directions: Array) -> Array:
    """(N,) relative strengths of lamps along `directions` (N, 3), by samples of a matt surface.

    They start at those by the best factors of rank three of the samples, or alike where these do
    not tell any, and alternate with pseudo-normals.
    """
    grey, counted = _grey(samples, weights)
    left, values, _ = np.linalg.svd(grey, full_matrices=False)
    found = strengths_along(left[:, :3] * values[:3] / values[0], directions)
    found = np.ones(len(directions)) if found is None else found
    for _ in range(ROUNDS):
        pseudo = _least_squares(grey, counted, directions * found[:, None])
        shading = directions @ pseudo.T
        found = (counted * shading * grey).sum(axis=1) / (counted * shading**2).sum(axis=1)
        found /= found.mean()
    return found


def _grey(samples: Array, weights: Array) -> tuple[Array, Array]:
    """(N, P) grey samples and their weights."""
    by_pixel, told = grey_samples(samples.swapaxes(0, 1), (weights > 0).swapaxes(0, 1))
    return by_pixel.T, np.where(told.T, weights.max(axis=-1), 0.0)


def _middle(grey: Array, told: Mask) -> Mask:
    """(N, P): which samples (N, P) are told, and not `TRIMMED` at either end of their pixel's."""
    places = np.where(told, grey, np.inf).argsort(axis=0).argsort(axis=0)
    count = told.sum(axis=0)
    cut = np.minimum((TRIMMED * count).astype(int), np.maximum(count - UNKNOWNS, 0) // 2)
    return np.asarray((places >= cut) & (places < count - cut))


def _least_squares(values: Array, weights: Array, basis: Array) -> Array:
    """(P, K) factors of a basis (N, K) that values (N, P) with weights are nearest to.

    The ridge decides where there are too few samples.
    """
    size = basis.shape[1]
    outer = (basis[:, :, None] * basis[:, None]).reshape(-1, size**2)
    matrices = (weights.T @ outer).reshape(-1, size, size)
    matrices += 1e-9 * np.trace(basis.T @ basis) * np.eye(size)
    sums = (weights * values).T @ basis
    return np.asarray(np.linalg.solve(matrices, sums[..., None])[..., 0])
