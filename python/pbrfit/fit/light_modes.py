"""How the lights of a fit may move when noise, and what pictures share, pull at them.

With G the information on the lights if materials were known, and S what is left of it where the
pixels are eliminated (`pbrfit.fit.joint`), directions of the light are scaled to the same effect on
the pictures, √(vᵀ G v). In these units S has eigenvalues λ in [0, 1]: the share of information that
is left. Few are much below 1, however many pictures there are: those directions that materials can
imitate. All of them lie in the span of the lights over the pictures (`Objective.light_basis`);
beyond it λ is 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.normal_equations import known_materials
from pbrfit.fit.objective import Objective
from pbrfit.fit.sampling import evenly_spaced

Array = NDArray[np.float64]


def light_modes(objective: Objective, x: Array, of_pixels: int | None = None) -> Array:
    """(R, N, K, C): the lights' covariance, of noise 1, as independent modes of deviation 1.

    From their spectrum over some pixels of a fit; those modes that matter to materials. None, R is
    0, where lights are known. `of_pixels` is how many pixels saw them, if not those of the
    objective alone.

    The mode of λ adds (1 − λ)/λ to the sum over pixels of their variances in units of A⁻¹. That
    ranks the modes and bounds what those left out would add. A direction that materials can make up
    for completely has the least λ that is not rounding.
    """
    layout = objective.layout
    if objective.lighting is None:
        return np.zeros((0, layout.pictures, layout.coefficients, layout.channels))
    pixels = evenly_spaced(layout.pixels, settings.COARSE_PIXELS)
    few, part = objective.restricted(pixels), objective.part_of(x, pixels)
    channels, k = layout.light_channels, layout.coefficients
    alone = known_materials(few, part)
    basis, problem, for_core = few.light_basis(part), few.problem, few.for_core(part)
    if basis is None:
        basis = np.broadcast_to(np.eye(layout.pictures), (channels, *2 * (layout.pictures,)))
    else:  # sums of the pictures, whose samples have their mean weights
        problem, for_core = few.combined(part, basis)
        alone = np.broadcast_to(alone.mean(axis=0), (basis.shape[2], *alone.shape[1:]))
    rank = basis.shape[2]
    left, _ = problem.schur_complement(for_core, few.everything, mono=channels < layout.channels)
    # T with Tᵀ G T = 1, a block for each light in a channel.
    blocks = np.einsum("nckcl->cnkl", alone.reshape(rank, channels, k, channels, k))
    sizes, directions = np.linalg.eigh(blocks.reshape(-1, k, k))
    seen = sizes > 1e-12 * sizes.max()  # by some pixel
    scale = np.where(seen, 1 / np.sqrt(np.where(seen, sizes, 1.0)), 0.0)
    units = directions * scale[:, None]
    left = left.reshape(len(units), k, len(units), k)
    scaled = np.einsum("aki,akbl,blj->aibj", units, left, units, optimize=True)
    scaled = scaled.reshape(len(units) * k, -1)
    unseen = ~seen.ravel()
    scaled[unseen, unseen] = 1.0
    shares, vectors = np.linalg.eigh(scaled)  # λ rises
    shares = np.clip(shares, settings.LIGHT_INFORMATION_MIN, 1.0)
    # What the other pixels know of the lights is taken to be like what these know.
    more = (of_pixels or layout.pixels) / few.pixels
    remaining = np.cumsum(((1 - shares) / shares)[::-1])[::-1]
    remaining /= more * few.layout.maps.stop
    used = int(np.count_nonzero(remaining > settings.OMITTED_VARIANCE_SHARE_MAX))
    modes = (vectors / np.sqrt(more * shares))[:, :used].reshape(len(units), k, used)
    modes = (units @ modes).reshape(channels, rank, k, used)
    found = np.einsum("cnj,cjkm->mnkc", basis, modes, optimize=True)
    return np.ascontiguousarray(np.repeat(found, layout.channels // channels, axis=-1))
