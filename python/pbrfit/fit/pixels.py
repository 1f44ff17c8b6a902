"""Materials of pixels, each by itself, when the lights are given."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from pbrfit.fit import settings
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.sampling import Pixels, beside, slices
from pbrfit.values.arrays import Array, Mask

NODES = (
    np.linspace(*settings.DESCENT_ROUGHNESS_NODES),
    np.linspace(*settings.DESCENT_METALLIC_NODES),
)
NODE_SPACING = np.array([nodes[1] - nodes[0] for nodes in NODES])
"""No node is nearer to what a pixel descends to than the mean of a posterior that is narrower."""

NEIGHBOURS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""From where pixels that stand out take over materials, in this order: (rows, columns)."""

PIXELS_PER_CALL = 1 << 17
"""Pixels in one call, so that Python has its turn several times a second; changes no result."""


def taken(objective: Objective, x: Array, pixels: Pixels | slice) -> Array:
    """Materials (Q, D) of some pixels."""
    return x[objective.layout.maps].reshape(-1, objective.pixels)[:, pixels].T


def place(objective: Objective, x: Array, pixels: Pixels | slice, materials: Array) -> None:
    """Give some pixels of x these materials (Q, D)."""
    x[objective.layout.maps].reshape(-1, objective.pixels)[:, pixels] = materials.T


def descended(
    objective: Objective,
    x: Array,
    pixels: Pixels,
    *,
    steps: int,
    starts: int = 0,
    nodes: tuple[Array, Array] = NODES,
    prior: GaussianPrior | None = None,
    held_normals: bool = False,
) -> tuple[Array, Array]:
    """Materials (Q, D) of some pixels, no worse than those of x, and their sums of squares (Q,).

    `steps` are of Levenberg and Marquardt's method on sums over pictures that are made once, which
    know squares to half their digits; some on residuals follow. Beside their own material, pixels
    start from so many of the best `nodes`. The cost of `prior`, with rows of `pixels`,
    counts when materials are compared, and is no part of what is returned.
    """
    free = objective.tangent_offsets is not None
    none, known = np.empty(0), objective.known_metallic
    roughness, metallic = nodes if starts else (none, none)
    return objective.problem.fit_materials(
        objective.for_core(x),
        pixels,
        roughness,
        metallic if known is None or not starts else np.array([known]),
        starts=starts,
        steps=steps,
        exact_steps=settings.DESCENT_EXACT_STEPS_FREE_NORMALS
        if free
        else settings.DESCENT_EXACT_STEPS,
        mean=None if prior is None else prior.mean,
        precision=None if prior is None else prior.precision,
        held_normals=held_normals,
    )


def pieces(pixels: Pixels) -> Iterator[Pixels]:
    """Some pixels, in pieces that take a fraction of a second."""
    for piece in slices(len(pixels), PIXELS_PER_CALL):
        yield pixels[piece]


def fit_all(
    objective: Objective,
    x: Array,
    *,
    starts: int | Mask,
    steps: int = settings.DESCENT_STEPS,
    prior: GaussianPrior | None = None,
    held_normals: bool = False,
    stop: Callable[[], bool] = lambda: False,
) -> Array | None:
    """Give all pixels of x their best materials for its lights; their sums of squares (P,).

    `starts` may be one for each pixel. None if stopped before all pixels had theirs.
    """
    sum_sq, of_pixels = np.empty(objective.pixels), np.broadcast_to(starts, objective.pixels)
    descend = partial(descended, objective, x, steps=steps, held_normals=held_normals)
    for number in np.unique(starts):
        for chunk in pieces(np.flatnonzero(of_pixels == number).astype(np.uint64)):
            if stop():
                return None
            rows = None if prior is None else prior.rows(chunk)
            found, sum_sq[chunk] = descend(chunk, starts=int(number), prior=rows)
            place(objective, x, chunk, found)
    return sum_sq


def fit_level(
    objective: Objective,
    x: Array,
    prior: GaussianPrior | None = None,
    *,
    held_normals: bool = False,
) -> Array:
    """Give a level's pixels their best materials, from nodes too; their sums of squares (P,)."""
    starts = settings.SUBSET_STARTS
    sum_sq = fit_all(objective, x, starts=starts, prior=prior, held_normals=held_normals)
    assert sum_sq is not None  # nothing stops it
    return sum_sq


def try_from(
    objective: Objective,
    x: Array,
    sum_sq: Array,
    pixels: Pixels,
    materials: Array,
    *,
    steps: int,
    starts: int = 0,
    prior: GaussianPrior | None = None,
) -> None:
    """Let some pixels of x descend from these materials (Q, D), and keep what is lower.

    Theirs of the sums of squares (P,) change too. `prior` has rows of `pixels`.
    """
    own = taken(objective, x, pixels)
    place(objective, x, pixels, materials)
    found, left = descended(objective, x, pixels, steps=steps, starts=starts, prior=prior)
    better = left < sum_sq[pixels]
    place(objective, x, pixels, np.where(better[:, None], found, own))
    sum_sq[pixels[better]] = left[better]


def is_exact(objective: Objective, squares: float) -> bool:
    """Whether a sum of squared residuals of all pixels is but rounding."""
    return squares <= settings.EXACT_RMSE**2 * objective.total_weight


def retry_outliers(
    objective: Objective, x: Array, sum_sq: Array, stop: Callable[[], bool] = lambda: False
) -> None:
    """Try pixels again whose sums of squares stand out; x and the sums (P,) change where better.

    From more nodes, and from the materials of the pixels around them: an object is seldom of a
    single pixel, and where its neighbours have found their way, so can it. Where it is stopped, the
    pixels that are left stay as they are.
    """
    outlying = np.flatnonzero(sum_sq > settings.RETRY_RATIO * np.median(sum_sq)).astype(np.uint64)
    roughness, metallic = settings.RETRY_ROUGHNESS_NODES, settings.RETRY_METALLIC_NODES
    nodes = np.linspace(*roughness), np.linspace(*metallic)
    again, starts = partial(descended, objective, x, nodes=nodes), settings.RETRY_STARTS
    for chunk in pieces(outlying):
        if stop():
            return
        found, sum_sq[chunk] = again(chunk, steps=2 * settings.DESCENT_STEPS, starts=starts)
        place(objective, x, chunk, found)
    valid = objective.layout.valid
    for others in beside(np.flatnonzero(valid), valid.shape[1], NEIGHBOURS):
        for chunk in pieces(outlying[others[outlying] >= 0]):
            if stop():
                return
            materials = taken(objective, x, others[chunk].astype(np.uint64))
            try_from(objective, x, sum_sq, chunk, materials, steps=settings.DESCENT_STEPS)
