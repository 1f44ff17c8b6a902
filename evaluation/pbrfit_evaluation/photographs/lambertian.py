"""Photometric stereo of a matt surface under one distant lamp a picture, by plain least squares.

    I_nc = albedo_c · max(normal · lamp_n, 0)

With known lamps the pseudo-normal, albedo times normal, of each pixel is the least-squares solution
of all its samples, those in shadow and those in highlights too (Woodham, "Photometric method for
determining surface orientation from multiple images", Optical Engineering 19, 1980). Unknown lamps
are those of `pbrfit_evaluation.real.matt`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.samples import grey_samples
from pbrfit_evaluation.photographs.pictures import Known

Array = NDArray[np.float64]


ROUNDS = 20
"""Of alternating least squares that better strengths of lamps: shadows spoil where these start."""


@dataclass(frozen=True, eq=False)
class Matt:
    """A matt surface.

    Attributes
    ----------
    normals
        (P, 3) unit vectors.
    albedo
        (P, 3), in any unit.
    """

    normals: Array
    albedo: Array

    def under(self, direction: Array) -> Array:
        """(P, 3): radiance under a white lamp of strength 1 along a unit vector."""
        return self.albedo * np.maximum(self.normals @ direction, 0.0)[:, None]


def known_lamps(samples: Array, weights: Array, known: Known) -> Matt:
    """Photometric stereo.

    Parameters
    ----------
    samples
        (N, P, 3) radiance.
    weights
        (N, P, 3), how much each value counts.
    known
        The N lamps. Strengths that are unknown start at `strengths_along` and alternate with
        pseudo-normals.
    """
    by_pixel, told = grey_samples(samples.swapaxes(0, 1), (weights > 0).swapaxes(0, 1))
    grey, of_samples = by_pixel.T, np.where(told.T, weights.max(axis=-1), 0.0)
    if known.strengths is None:
        lamps = known.directions * strengths_along(known.directions, grey)[:, None]
        for _ in range(ROUNDS):
            shading = known.directions @ _pseudo_normals(grey, of_samples, lamps).T
            best = (of_samples * shading * grey).sum(axis=1)
            best /= (of_samples * shading**2).sum(axis=1)
            lamps = known.directions * (best / best.mean())[:, None]
    else:
        lamps = known.directions * known.strengths[:, None]
    pseudo = _pseudo_normals(grey, of_samples, lamps)
    lengths = np.linalg.norm(pseudo, axis=-1, keepdims=True)
    normals = np.where(lengths > 0, pseudo / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0])
    shading = np.maximum(lamps @ normals.T, 0.0)[..., None]
    squares = (weights * shading**2).sum(axis=0)
    albedo = (weights * shading * samples).sum(axis=0) / np.where(squares > 0, squares, 1.0)
    return Matt(normals, np.maximum(albedo, 0.0))


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
    matrices = np.einsum("np,ni,nj->pij", weights, lamps, lamps)
    matrices += 1e-9 * np.trace(lamps.T @ lamps) * np.eye(3)
    sums = np.einsum("np,ni,np->pi", weights, lamps, grey)
    return np.asarray(np.linalg.solve(matrices, sums[..., None])[..., 0])
