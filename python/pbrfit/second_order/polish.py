"""Joint Gauss-Newton steps of all pixels and the lights, whose system is never formed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pbrfit.objective import Objective
from pbrfit.sampling import spread
from pbrfit.second_order.lights import Cholesky, as_in_x, options, product
from pbrfit.second_order.pixels import Pixels, Towards, chunks, fitted, taken

Array = NDArray[np.float64]

STEPS = 8
"""At most."""

BASIS_PIXELS = 1024
"""Their system is the preconditioner. With so many, three or four products leave a tenth of the
error."""

BASIS_DAMPING = 1e-6

PRODUCTS = 12
"""Of the system with a vector, each a pass over all pictures, in one step at most."""

LEFT = 0.1
"""Of the error, in the norm of the preconditioner, a step may leave to the next."""

WORTH = 1e-5
"""Share of the sum by which a step has to lower it, as predicted, to be taken."""

LAST = 1e-3
"""A step that lowers the sum by less than this share of it is the last: a hundredth is left of what
it gained."""

HALVINGS = 3
DESCENT = 4
"""Steps of each pixel by itself after a joint one."""

Visit = Callable[[Array, Array], bool]
"""Called with x and the pixels' squares after each step; whether to stop."""


def polished(
    objective: Objective,
    x: Array,
    squares: Array,
    visit: Visit,
    stop: Callable[[], bool],
    towards: Towards | None = None,
) -> tuple[Array, Array]:
    """X and squares (P,) after joint steps that lower their sum, pulls included."""
    total = _total(objective, x, squares, towards)
    for _ in range(STEPS):
        if total == 0:
            break
        moves, predicted = _light_moves(objective, x, towards, WORTH * total, stop)
        if predicted < WORTH * total or stop():
            break
        taken_step = _stepped(objective, x, moves, total, towards, stop)
        if taken_step is None:
            break
        x, squares, lower = taken_step
        gain, total = 1 - lower / total, lower
        if visit(x, squares) or gain < LAST:
            break
    return x, squares


def _total(objective: Objective, x: Array, squares: Array, towards: Towards | None) -> float:
    total = float(squares.sum())
    if towards is not None:
        total += towards.cost(taken(objective, x, slice(None))[:, objective.channels :])
    return total


def _basis(objective: Objective, x: Array, towards: Towards | None) -> Cholesky:
    """The system of some pixels, scaled up to all."""
    chosen = spread(objective.pixels, BASIS_PIXELS)
    few = objective.restricted(chosen)
    part, pixels = objective.part_of(x, chosen), np.arange(len(chosen), dtype=np.uint64)
    rows = None if towards is None else towards.of(chosen)
    matrix, _ = few.problem.reduced(few.for_core(part), pixels, **options(few, part, pixels, rows))
    matrix *= objective.pixels / len(chosen)
    return Cholesky(matrix, BASIS_DAMPING)


def _light_moves(
    objective: Objective,
    x: Array,
    towards: Towards | None,
    enough: float,
    stop: Callable[[], bool],
) -> tuple[Array, float]:
    """δ with S δ ≈ −s by preconditioned conjugate gradients, and by how much it lowers the sum.

    The latter is that of a quadratic model; if it cannot exceed `enough`, no product is made.
    """
    layout = objective.layout
    size = layout.light_channels * layout.pictures * layout.coefficients
    moves = np.zeros(size)
    try:
        basis = _basis(objective, x, towards)
    except np.linalg.LinAlgError:
        return moves, 0.0
    _, gradient = product(objective, x, moves, towards)
    residual = -gradient
    direction = preconditioned = basis.solve(residual)
    first = size_now = float(residual @ preconditioned)
    if not first >= enough:
        return moves, 0.0
    predicted = 0.0
    for _ in range(PRODUCTS):
        along, _ = product(objective, x, direction, towards)
        curvature = float(direction @ along)
        if not curvature > 0:
            break
        length = size_now / curvature
        moves += length * direction
        residual -= length * along
        predicted += length * size_now
        preconditioned = basis.solve(residual)
        size_before, size_now = size_now, float(residual @ preconditioned)
        if size_now <= max(LEFT**2 * first, 0.1 * enough) or stop():
            break
        direction = preconditioned + size_now / size_before * direction
    return moves, predicted


def _stepped(
    objective: Objective,
    x: Array,
    moves: Array,
    total: float,
    towards: Towards | None,
    stop: Callable[[], bool],
) -> tuple[Array, Array, float] | None:
    """X, squares and sum after the longest of a few steps that lowers the sum; None if none does."""
    for halving in range(HALVINGS):
        share = 0.5**halving * moves
        trial = x.copy()
        trial[objective.layout.lighting] += as_in_x(share, objective.layout)
        maps = trial[objective.layout.maps].reshape(-1, objective.pixels)
        for chunk in chunks(objective.pixels):
            maps[:, chunk] = _followed(objective, x, chunk, share, towards).T
        found = fitted(objective, trial, starts=0, steps=DESCENT, towards=towards, stop=stop)
        if found is None:
            return None
        lower = _total(objective, *found, towards)
        if lower < total:
            return *found, lower
    return None


def _followed(
    objective: Objective, x: Array, chunk: Pixels, moves: Array, towards: Towards | None
) -> Array:
    rows = None if towards is None else towards.of(chunk)
    how = options(objective, x, chunk, rows)
    return objective.problem.follow_lights(objective.for_core(x), chunk, moves, **how)
