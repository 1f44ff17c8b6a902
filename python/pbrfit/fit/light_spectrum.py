"""What pixels say about the lights when their materials are fitted too, direction by direction.

With G the information if materials were known and S = G − Σ_p Bᵀ A⁻¹ B what is left of it
(`normal_equations`), directions of the light are scaled to the same effect on the pictures,
√(vᵀ G v). In these units S has eigenvalues λ in [0, 1]: the share of information that is left. Few
are much below 1, however many pictures there are: those directions that materials can imitate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.fit.normal_equations import Eliminated, chunks, eliminate
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout

Array = NDArray[np.float64]

DARK_SHARE = 1e-12
"""Share of the largest eigenvalue of G up to which a direction of the light counts as seen by no
pixel: it moves no material and is left out."""

DENSE_UNKNOWNS_MAX = 1600
"""Unknowns of the lights up to which all eigenvalues are computed, which takes time with their
cube; above, the smallest `LEADING_EIGENVALUES`."""

LEADING_EIGENVALUES = 160

SUBSPACE_ITERATIONS = 2
"""Subspace iterations before the one that tells eigenvalues."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Directions of the light by how much the pixels tell about them, the least known first."""

    left: Array
    """(R,): λ, rising."""
    vectors: Array
    """(M, R): their directions, of length 1 in units in which G is 1."""
    rest: float
    """Σ (1 − λ) of the directions that were not computed is at most this; 0 where all were."""
    to_units: Array
    from_units: Array
    """(lights, K, K), a light in a channel each: T⁻¹ and T with Tᵀ G T = 1; T is 0 where G is."""


def of_objective(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], held: NDArray[np.bool_]
) -> Spectrum:
    """Over some pixels of a fit at x; `held` (P', D) are unknowns that are no unknowns.

    Materials imitate only lights in the span of those of x (`Objective.light_basis`). So many
    pictures whose samples have the same weight are taken for as many sums as that has dimensions,
    and beyond it λ is 1.
    """
    layout, basis = objective.layout, objective.light_basis(x)
    if basis is None or layout.weighted:
        return spectrum(objective.problem, objective.for_core(x), layout, pixels, held)
    few, part = objective.restricted(pixels), objective.part_of(x, pixels)
    channels, pictures, rank = basis.shape
    problem, for_core = few.combined(part, basis)
    everything = np.arange(len(pixels), dtype=np.uint64)
    sums = replace(few.layout, pictures=rank)
    found = spectrum(problem, for_core, sums, everything, held)
    k, modes = layout.coefficients, len(found.left)
    # All pictures have the same units, those of the first sum.
    to_units, from_units = (
        np.tile(of[:channels], (pictures, 1, 1)) for of in (found.to_units, found.from_units)
    )
    lights = (found.from_units @ found.vectors.reshape(-1, k, modes)).reshape(rank, channels, -1)
    of_pictures = np.einsum("cnj,jcv->ncv", basis, lights, optimize=True)
    vectors = (to_units @ of_pictures.reshape(-1, k, modes)).reshape(-1, modes)
    return Spectrum(found.left, vectors, 0.0, to_units, from_units)


def spectrum(
    problem: _core.Problem,
    x: Array,
    layout: ParameterLayout,
    pixels: NDArray[np.uint64],
    held: NDArray[np.bool_],
) -> Spectrum:
    """Over some pixels; `held` (P', D) are unknowns that are no unknowns."""
    lights, k = layout.pictures * layout.light_channels, layout.coefficients
    size = lights * k
    parts = [
        eliminate(problem, x, layout, pixels[chunk], held[chunk])
        for chunk in chunks(len(pixels), 8 * held.shape[1] * size)
    ]
    alone = np.sum([part.information_alone(layout) for part in parts], axis=0)
    to_units, from_units = _units(alone.reshape(lights, k, k))
    if size > DENSE_UNKNOWNS_MAX:
        left, vectors = _leading(parts, from_units, layout)
        rest = (size - len(left)) * max(0.0, 1 - float(left[-1]))
        return Spectrum(left, vectors, rest, to_units, from_units)
    shared = np.zeros((size, size))
    for part in parts:
        shared += part.information(layout)
    # Scaled block by block: T has blocks of one light.
    scaled = np.einsum(
        "aki,akbl,blj->aibj", from_units, shared.reshape(lights, k, lights, k), from_units,
        optimize=True,
    ).reshape(size, size)  # fmt: skip
    unseen = ~from_units.any(axis=1).ravel()
    scaled[unseen, unseen] = 1
    left, vectors = np.linalg.eigh(scaled)
    return Spectrum(left, vectors, 0.0, to_units, from_units)


def _units(alone: Array) -> tuple[Array, Array]:
    sizes, directions = np.linalg.eigh(alone)
    seen = sizes > DARK_SHARE * sizes.max()
    roots = np.sqrt(np.where(seen, sizes, 0))
    inverses = np.zeros_like(roots)
    np.divide(1, roots, where=seen, out=inverses)
    return roots[:, :, None] * directions.transpose(0, 2, 1), directions * inverses[:, None, :]


def _leading(
    parts: list[Eliminated], from_units: Array, layout: ParameterLayout
) -> tuple[Array, Array]:
    """Smallest λ and their directions.

    Subspace iteration with 1 − Tᵀ S T = Σ_p Tᵀ Bᵀ A⁻¹ B T from random directions (N. Halko,
    P. Martinsson, J. Tropp, SIAM Review 53, 2011), and the Rayleigh-Ritz values of its result. This
    matrix has few large eigenvalues, so it converges at once; and it is applied pixel by pixel, in
    time that is linear in the number of pictures.
    """
    blocks, k, _ = from_units.shape
    n = layout.pictures

    def apply(directions: Array) -> Array:
        lights = from_units @ directions.reshape(blocks, k, -1)
        lights = lights.reshape(n, -1, k, directions.shape[1])
        moved = np.zeros_like(lights)
        for part in parts:
            moved += part.imitated(lights, layout)
        units = from_units.transpose(0, 2, 1) @ moved.reshape(blocks, k, -1)
        return np.asarray(units.reshape(directions.shape))

    found = np.random.default_rng(0).normal(size=(blocks * k, LEADING_EIGENVALUES))
    for _ in range(SUBSPACE_ITERATIONS):
        found, _ = np.linalg.qr(apply(found))
    lost, turn = np.linalg.eigh(found.T @ apply(found))
    return 1 - lost[::-1], found @ turn[:, ::-1]
