"""Joint Gauss-Newton steps for lights and the materials of some pixels, pulled to given values.

L-BFGS hardly moves along the valleys that the problem has: when a channel's albedo is scaled and its
lights undo it, little but the highlights of dielectrics changes, and many pixels have to change
roughness a little as well. Gauss-Newton sees these valleys. What it minimises over albedo,
roughness and metallic of a set of pixels, the lights, and an offset δ for each cluster of pixels, is

    Σ ω (I − T)² + Σ_pf a_pf (v_pf − c_pf − δ_g(p)f)² + s Σ_gf (Σ_{p in g} a_pf) δ_gf²

with v = roughness and metallic (f), pulled with precision a towards c. The offsets let a cluster
move as a whole; without them each step of many pixels would have to be won against their pulls.

Pixels are solved for first, which leaves a dense system in lights and offsets (Schur complement, as
in `normal_equations`). After each step albedo is put to its best value for the new lights, roughness
and metallic, which needs no iteration (`Problem.best_albedo`): given these, each channel of a pixel
is a polynomial in its albedo. Without this, steps overshoot, since albedo times light is not linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.normal_equations import chunks, eliminate, held_at_bounds, subtract_products
from pbrfit.objective import Objective

Array = NDArray[np.float64]

OFFSET_PULL = 1e-3
"""s: offsets are pulled to 0 by this share of the pull that their pixels feel."""

FIRST_DAMPING = 1e-3
"""Of the diagonal of each pixel's matrix, as in Marquardt's method."""

LIGHT_DAMPING = 1e-3
"""Damping of the lights, as a share of that of pixels: their system is what we are here for."""

SMALLEST_DAMPING = 1e-6

FAILURES = 4
"""Steps that may fail, each followed by ten times the damping."""

ENOUGH = 1e-5
"""A step that lowers the sum by less than this share of it is the last."""

RIDGE = 1e-13
"""Of the largest diagonal entry: the lights may have directions that no pixel sees."""


@dataclass(frozen=True, eq=False)
class Pull:
    """Where pixels are pulled, with F = 2 for roughness and metallic, or 1 where the latter is known.

    Attributes
    ----------
    centre, precision
        (P, F): c, and a in units of squared residuals.
    cluster
        (P,): which offset a pixel has.
    clusters
        Number of clusters.
    """

    centre: Array
    precision: Array
    cluster: NDArray[np.intp]
    clusters: int

    def offset_precision(self) -> Array:
        """Σ a over the pixels of a cluster, (clusters, F)."""
        columns = [
            np.bincount(self.cluster, weights=column, minlength=self.clusters)
            for column in self.precision.T
        ]
        return np.stack(columns, axis=-1)


@dataclass(frozen=True, eq=False)
class _State:
    """x, the offsets (clusters, F), and the sum that is minimised."""

    x: Array
    offsets: Array
    total: float


def minimize(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], pull: Pull, steps: int
) -> tuple[Array, int]:
    """Steps from x that lower the sum; returns x and how many they were.

    Parameters
    ----------
    objective
        The problem, with unknown lights; its penalties take no part.
    x
        Where to start. Other pixels' materials stay.
    pixels
        (Q,) indices of the pixels that take part.
    pull
        Of these pixels.
    steps
        At most so many.
    """
    state = _with_best_albedo(objective, x, pixels, pull, np.zeros((pull.clusters, pull.centre.shape[1])))
    damping, done, failed = FIRST_DAMPING, 0, 0
    while done < steps and failed < FAILURES:
        try:
            moved = _step(objective, state, pixels, pull, damping)
        except np.linalg.LinAlgError:
            moved = None
        if moved is None or not moved.total < state.total:
            damping, failed = 10 * damping, failed + 1
            continue
        gain = state.total - moved.total
        state, done = moved, done + 1
        damping = max(damping / 5, SMALLEST_DAMPING)
        if gain < ENOUGH * state.total:
            break
    return state.x, done


def _with_best_albedo(
    objective: Objective, x: Array, pixels: NDArray[np.uint64], pull: Pull, offsets: Array
) -> _State:
    layout = objective.layout
    albedo, squares = objective.problem.best_albedo(objective.for_core(x), pixels)
    x = x.copy()
    x[layout.albedo].reshape(layout.channels, -1)[:, pixels] = albedo.T
    off = _finish(objective, x, pixels) - pull.centre - offsets[pull.cluster]
    pulled = float((pull.precision * off**2).sum())
    held = OFFSET_PULL * float((pull.offset_precision() * offsets**2).sum())
    return _State(x, offsets, float(squares.sum()) + pulled + held)


def _finish(objective: Objective, x: Array, pixels: NDArray[np.uint64]) -> Array:
    """(Q, F): roughness and metallic, as far as it is unknown."""
    layout = objective.layout
    planes = x[layout.roughness.start : layout.maps.stop].reshape(-1, layout.pixels)
    return planes[:, pixels].T


def _step(
    objective: Objective, state: _State, pixels: NDArray[np.uint64], pull: Pull, damping: float
) -> _State:
    """One damped step. Half the sum's derivatives are used throughout."""
    from scipy.linalg import cho_factor, cho_solve

    layout, problem, x = objective.layout, objective.problem, state.x
    for_core = objective.for_core(x)
    lit, k, f = layout.light_channels, layout.coefficients, pull.centre.shape[1]
    lights = layout.pictures * lit * k
    size = lights + pull.clusters * f
    own = layout.channels + f  # unknowns of a pixel
    matrix = np.zeros((size, size))
    gradient = np.zeros(size)
    materials = x[layout.maps].reshape(-1, layout.pixels).T[pixels.astype(np.intp)]
    off = materials[:, layout.channels :] - pull.centre - state.offsets[pull.cluster]

    parts = []
    for chunk in chunks(len(pixels), 8 * own * size):
        by_pull = pull.precision[chunk] * off[chunk]
        residuals = problem.residuals(for_core, pixels[chunk]).transpose(1, 0, 2)
        part = eliminate(
            problem, for_core, layout, pixels[chunk],
            residuals=residuals,
            materials=materials[chunk],
            precision=pull.precision[chunk],
            pull=by_pull,
            damping=damping,
        )
        parts.append(part)
    raise NotImplementedError
