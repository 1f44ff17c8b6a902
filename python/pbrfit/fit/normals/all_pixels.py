"""All pixels' normals, in lights that a level found, or that a fit with held normals had.

Each pixel changes its normal by itself, with a prior around where its neighbours are. Neighbours
are seen where they were before, so the prior is made anew a few times. Lights stay: what the two
numbers more of each pixel take up of the noise would bend them, however many pixels there are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.levels import Level
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.normals.free import noise_variance, offset_variances, offsets_of, pixel_sums
from pbrfit.fit.normals.offset_prior import TangentOffsetPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import fit_all, place, taken
from pbrfit.fit.priors.gaussian import GaussianPrior

Array = NDArray[np.float64]


def tangent_offsets_between(given: Array, changed: Array) -> Array:
    """Tangent offsets (P, 2) that change unit normals (P, 3) into others.

    n is along n₀ + a t₁ + b t₂ with tangents at n₀ that are unit vectors at right angles, so that
    a = n·t₁ / n·n₀ and b = n·t₂ / n·n₀.
    """
    x, y, z = given.T
    mirrored = z <= -0.99  # tangents are those of the mirror image (docs/model.md)
    upper = np.where(mirrored, -z, z)
    first = np.stack([1 - x**2 / (1 + upper), -x * y / (1 + upper), -x], axis=-1)
    second = np.stack([-x * y / (1 + upper), 1 - y**2 / (1 + upper), -y], axis=-1)
    for tangent in (first, second):
        tangent[mirrored, 2] *= -1
    cosine = np.maximum(np.einsum("pi,pi->p", given, changed), 0.1)  # else it grows without bound
    return np.stack(
        [np.einsum("pi,pi->p", changed, tangent) / cosine for tangent in (first, second)], axis=-1
    )


def start_from_level(objective: Objective, x: Array, level: Level, part: Array) -> None:
    """Give all pixels the unknowns of a level's nearest one, and its lights; x changes.

    `part` is x of the level.
    """
    from scipy.spatial import KDTree

    layout, of_level = objective.layout, level.objective.layout
    places = np.argwhere(layout.valid)
    _, nearest = KDTree(places[level.pixels.astype(np.intp)]).query(places)
    place(objective, x, slice(None), taken(level.objective, part, np.asarray(nearest, np.uint64)))
    x[layout.maps.stop :] = part[of_level.maps.stop :]


def start_from_offsets(objective: Objective, x: Array, offsets: Array) -> None:
    """Give pixels these tangent offsets (P, 2) where they explain more than those of x; x changes.

    Each with its best albedo, and roughness and metallic as they are.
    """
    assert objective.tangent_offsets is not None
    before = objective.put_best_albedo(x, objective.everything)
    other = x.copy()
    other[objective.tangent_offsets] = offsets.T.ravel()
    after = objective.put_best_albedo(other, objective.everything)
    better = np.flatnonzero(after < before).astype(np.uint64)
    place(objective, x, better, taken(objective, other, better))


def refine_all(
    objective: Objective,
    x: Array,
    prior: TangentOffsetPrior,
    noise: NoiseModel | None,
    stop: Callable[[], bool],
) -> bool:
    """Change the normals of all pixels, with their materials; x changes. False if time ran out.

    Samples weigh by their `noise`, of which outliers show once pixels are fitted.
    """
    layout = objective.layout
    assert layout.tangent_offsets is not None
    for number in range(settings.NORMALS_PRIOR_UPDATES):
        if noise is not None:
            weights = noise.weights(objective, x if number else None, first=number == 1)
            objective.adopt(objective.weighed(weights))
        offsets = offsets_of(objective, x)
        variance = noise_variance(objective, pixel_sums(objective, x))
        offset_mean, offset_precision = prior.conditional(offsets, variance)
        free = np.zeros((len(offsets), len(layout.roughness_metallic)))
        pixel_prior = GaussianPrior(
            np.concatenate([free, offset_mean], axis=1),
            np.concatenate([free, offset_precision], axis=1),
        )
        starts, steps = (0, 0) if number else (1, settings.DESCENT_STEPS)
        if fit_all(objective, x, starts=starts, steps=steps, prior=pixel_prior, stop=stop) is None:
            return False
        left = offset_variances(objective, x, pixel_prior.precision, variance)
        prior = prior.fitted(offsets_of(objective, x), left)
    return True
