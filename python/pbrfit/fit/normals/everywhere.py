"""All pixels' normals, from lights that a lattice found, or that a fit with held normals had.

Each pixel turns its normal by itself, drawn to where its neighbours are; then joint steps of all
pixels and the lights (`pbrfit.fit.gauss_newton.global_gauss_newton`). Neighbours are seen where
they were before, so what is drawn to is made anew a few times: at the end that is the same as all
together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.global_gauss_newton import minimize
from pbrfit.fit.gauss_newton.pixels import fit_all
from pbrfit.fit.normals.noise import noise_variance, pixel_squares, uncertain_tilts
from pbrfit.fit.normals.offset_prior import TiltPrior
from pbrfit.fit.normals.search import Found
from pbrfit.fit.normals.strided_subset import Neighbourhood, numbered
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior

Array = NDArray[np.float64]

ROUNDS = 3

GATHERED = 0.03
"""Standard deviation of roughness and metallic around those of a fit with the learnt prior."""


def spread_out(objective: Objective, x: Array, found: Found) -> None:
    """Give all pixels the unknowns of the lattice's nearest one, and its lights; x changes."""
    layout = objective.layout
    rows, columns = np.nonzero(layout.valid)
    chosen = found.pixels.astype(np.intp)
    from scipy.spatial import KDTree

    places = np.stack([rows[chosen], columns[chosen]], axis=-1)
    _, nearest = KDTree(places).query(np.stack([rows, columns], axis=-1))
    of_lattice = found.x[found.few.layout.maps].reshape(-1, found.few.pixels)
    x[layout.maps] = of_lattice[:, nearest].ravel()
    x[layout.maps.stop :] = found.x[found.few.layout.maps.stop :]


def start_nearer(objective: Objective, x: Array, tilts: Array) -> None:
    """Give pixels these tilts (P, 2) where they leave less than those of x; x changes.

    Each with its best albedo, and roughness and metallic as they are.
    """
    assert objective.tangent_offsets is not None
    everything = np.arange(objective.pixels, dtype=np.uint64)
    before = objective.put_best_albedo(x, everything)
    other = x.copy()
    other[objective.tangent_offsets] = tilts.T.ravel()
    nearer = objective.put_best_albedo(other, everything) < before
    maps = slice(0, objective.layout.maps.stop)
    planes = x[maps].reshape(-1, objective.pixels)
    planes[:, nearer] = other[maps].reshape(-1, objective.pixels)[:, nearer]


def prior_of(objective: Objective, given: Array, sigma: Array | None, spread: float) -> TiltPrior:
    """The prior on the tilts of all pixels."""
    around = Neighbourhood.of(numbered(objective.layout), given, sigma)
    return TiltPrior(around, spread=spread)


def turn(
    objective: Objective,
    x: Array,
    prior: TiltPrior,
    finish: Array | None,
    starts: int,
    stop: Callable[[], bool],
) -> tuple[TiltPrior, Array | None]:
    """Turn the normals of all pixels, with their materials and the lights; x changes.

    Parameters
    ----------
    objective
        With free normals.
    prior
        Of the tilts.
    finish
        (P, F): roughness and metallic to stay near; None = none.
    starts
        Nodes from which pixels start, in the first round.

    Returns
    -------
    prior
        With the spread that was found.
    squares
        (P,); None if time ran out before all pixels had turned.
    """
    layout = objective.layout
    assert layout.tangent_offsets is not None
    squares = None
    for number in range(ROUNDS):
        tilts = x[layout.tangent_offsets].reshape(2, -1).T
        variance = noise_variance(objective, pixel_squares(objective, x))
        centre, precision = prior.beside_others(tilts, variance)
        drawn, by = np.zeros((2, len(tilts), len(layout.roughness_metallic)))
        if finish is not None:
            drawn, by = finish, by + variance / GATHERED**2
        towards = GaussianPrior(
            np.concatenate([drawn, centre], axis=1), np.concatenate([by, precision], axis=1)
        )
        first = number == 0
        squares = fit_all(
            objective,
            x,
            starts=starts if first else 0,
            steps=12 if first and starts else 0,
            prior=towards,
            stop=stop,
        )
        if squares is None:
            return prior, None
        if objective.lighting is not None:
            minimize(objective, x, squares, lambda *_: stop(), stop, towards)
        prior = prior.learnt(
            x[layout.tangent_offsets].reshape(2, -1).T,
            uncertain_tilts(objective, x, towards.precision, variance),
        )
    return prior, squares
