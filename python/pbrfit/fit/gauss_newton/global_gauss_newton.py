"""Joint Gauss-Newton steps of all pixels and the lights, whose system is never formed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.lights import options
from pbrfit.fit.gauss_newton.normal_equations import Cholesky, as_in_x
from pbrfit.fit.gauss_newton.pixels import (
    AT_ONCE,
    Pixels,
    Towards,
    chunks,
    fit_all,
    place,
    taken,
    try_from,
)
from pbrfit.fit.objective import Objective
from pbrfit.fit.sampling import spread

Array = NDArray[np.float64]

STEPS = 8
"""At most."""

BASIS_PIXELS = 1024
"""Their system is the preconditioner. With two and four times as many, fits of 512² with noise
took longer."""

BASIS_DAMPING = 1e-6

PRODUCTS = 12
"""Of the system with a vector, each a pass over all pictures, in one step at most."""

LEFT = 0.3
"""Of the error, in the norm of the preconditioner, a step may leave to the next. With 0.1 fits of
512² with noise took twice as long and ended the same."""

WORTH = 1e-5
"""Share of the sum by which a step has to lower it, as predicted, to be taken."""

LAST = 1e-3
"""A step that lowers the sum by less than this share of it is the last: a tenth is left of what it
gained."""

SHARES = (1.0, 0.4)
"""Of a step that are tried before more damping is."""

FIRST_DAMPING = 1e-3
MORE_DAMPING = 30.0
MOST_DAMPING = 0.5
"""Of the diagonals of pixels, as in Marquardt's method: none at first, and where a step fails."""

LIGHT_DAMPING = 1e-3
"""Damping of the lights, as a share of that of pixels."""

DESCENT = 4
"""Steps of each pixel by itself after a joint one."""

WORSE = 1.02
"""Times its squares before a step: a pixel left with more may have fallen into another minimum."""


@dataclass(frozen=True, eq=False)
class _How:
    """How pixels are solved for."""

    towards: Towards | None
    damping: float

    def of(self, objective: Objective, x: Array, pixels: Pixels) -> dict[str, Any]:
        """Options of the core's functions."""
        rows = None if self.towards is None else self.towards.of(pixels)
        return options(objective, x, pixels, rows) | {"damping": self.damping}


Visit = Callable[[Array, Array], bool]
"""Called with x and the pixels' squares after each step; whether to stop."""


def polish(
    objective: Objective,
    x: Array,
    squares: Array,
    visit: Visit,
    stop: Callable[[], bool],
    towards: Towards | None = None,
) -> None:
    """Joint steps that lower the sum of squares, pulls included; x and `squares` (P,) change."""
    total = _total(objective, x, squares, towards)
    damping = 0.0
    for _ in range(STEPS):
        if total == 0:
            break
        how = _How(towards, damping)
        moves, predicted = _light_moves(objective, x, how, WORTH * total, stop)
        if predicted < WORTH * total or stop():
            break
        lower = _step(objective, x, squares, moves, total, how, stop)
        if lower is None:
            if damping >= MOST_DAMPING or stop():
                break
            damping = max(MORE_DAMPING * damping, FIRST_DAMPING)
            continue
        damping = 0.0 if damping <= FIRST_DAMPING else damping / MORE_DAMPING
        gain, total = 1 - lower / total, lower
        if visit(x, squares) or gain < LAST:
            break


def _total(objective: Objective, x: Array, squares: Array, towards: Towards | None) -> float:
    total = float(squares.sum())
    if towards is not None:
        total += towards.cost(taken(objective, x, slice(None))[:, objective.channels :])
    return total


def _basis(objective: Objective, x: Array, how: _How) -> Cholesky:
    """The system of some pixels, scaled up to all."""
    chosen = spread(objective.pixels, BASIS_PIXELS)
    few = objective.restricted(chosen)
    part, pixels = objective.part_of(x, chosen), np.arange(len(chosen), dtype=np.uint64)
    of_few = _How(None if how.towards is None else how.towards.of(chosen), how.damping)
    matrix, _ = few.problem.schur_complement(
        few.for_core(part), pixels, **of_few.of(few, part, pixels)
    )
    matrix *= objective.pixels / len(chosen)
    return Cholesky(matrix, BASIS_DAMPING)


def _product(
    objective: Objective, x: Array, v: Array, how: _How, stop: Callable[[], bool]
) -> tuple[Array, Array] | None:
    """S v and s of all pixels, in order, so that the sums are always the same; None if stopped."""
    totals = np.zeros((2, len(v)))
    for chunk in chunks(objective.pixels):
        if stop():
            return None
        totals += objective.problem.schur_product(
            objective.for_core(x), chunk, v, **how.of(objective, x, chunk)
        )
    return totals[0], totals[1]


def _light_moves(
    objective: Objective, x: Array, how: _How, enough: float, stop: Callable[[], bool]
) -> tuple[Array, float]:
    """δ with (S + damping) δ ≈ −s by preconditioned conjugate gradients, and what it gains.

    The latter is by how much the sum falls in the quadratic model; if it cannot exceed `enough`, no
    product is made.
    """
    layout = objective.layout
    size = layout.light_channels * layout.pictures * layout.coefficients
    moves = np.zeros(size)
    try:
        basis = _basis(objective, x, how)
    except np.linalg.LinAlgError:
        return moves, 0.0
    product = _product(objective, x, moves, how, stop)
    if product is None:
        return moves, 0.0
    residual = -product[1]
    direction = preconditioned = basis.solve(residual)
    first = size_now = float(residual @ preconditioned)
    if not first >= enough:
        return moves, 0.0
    predicted = 0.0
    for _ in range(PRODUCTS):
        product = _product(objective, x, direction, how, stop)
        if product is None:
            break
        along = product[0] + LIGHT_DAMPING * how.damping * basis.diagonal * direction
        curvature = float(direction @ along)
        if not curvature > 0:
            break
        length = size_now / curvature
        moves += length * direction
        residual -= length * along
        predicted += length * size_now
        preconditioned = basis.solve(residual)
        size_before, size_now = size_now, float(residual @ preconditioned)
        if size_now <= max(LEFT**2 * first, 0.1 * enough):
            break
        direction = preconditioned + size_now / size_before * direction
    return moves, predicted


def _step(
    objective: Objective,
    x: Array,
    squares: Array,
    moves: Array,
    total: float,
    how: _How,
    stop: Callable[[], bool],
) -> float | None:
    """The sum after the longest step of a few that lowers it, which is taken; None if none does."""
    towards = how.towards
    trial = np.empty_like(x)
    for share in SHARES:
        moved = share * moves
        trial[:] = x
        trial[objective.layout.lighting] += as_in_x(moved, objective.layout)
        for chunk in chunks(objective.pixels):
            if stop():
                return None
            followed = objective.problem.back_substitute(
                objective.for_core(x), chunk, moved, **how.of(objective, x, chunk)
            )
            place(objective, trial, chunk, followed)
        left = fit_all(objective, trial, starts=0, steps=DESCENT, towards=towards, stop=stop)
        if left is None:
            return None
        _catch(objective, x, squares, trial, left, towards, stop)
        lower = _total(objective, trial, left, towards)
        if lower < total:
            x[:], squares[:] = trial, left
            return lower
    return None


def _catch(
    objective: Objective,
    before: Array,
    squares_before: Array,
    x: Array,
    squares: Array,
    towards: Towards | None,
    stop: Callable[[], bool],
) -> None:
    """Let pixels that a step left worse off start again; x and `squares` change.

    From where they were, and from the best node: one that falls into another minimum costs more
    than many others gain. Those that are left when it is stopped stay worse off.
    """
    worse = np.flatnonzero(squares > WORSE * squares_before).astype(np.uint64)
    for first in range(0, len(worse), AT_ONCE):
        if stop():
            return
        chunk = worse[first : first + AT_ONCE]
        own = taken(objective, before, chunk)
        rows = None if towards is None else towards.of(chunk)
        steps = 2 * DESCENT
        try_from(objective, x, squares, chunk, own, steps=steps, starts=1, towards=rows)
