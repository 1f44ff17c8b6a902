"""The stages in order."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pbrfit.material_prior import MaterialPull
from pbrfit.model_gap import NOISE_SHARED, Neighbours
from pbrfit.objective import Objective
from pbrfit.second_order import subsample
from pbrfit.second_order.pixels import (
    STEPS,
    Towards,
    descended,
    fitted,
    put,
    retried,
    taken,
)
from pbrfit.second_order.polish import polished

Array = NDArray[np.float64]

SUBSAMPLES = (256, 512, 1024)
"""Pixels that find the lights of 16 pictures. Others take over with the lights found so far where
something is left of the pixels that judge: the next size where that is no noise, the last where it
is, because noise of few pixels leads too far off for all pixels to follow. On twelve rooms of 128²
without noise 256 found all but one, and joint steps cost half as much as with 512."""

EXACT = 1e-5
"""Root mean square of residuals, at mean radiance 0.4, that counts as nothing left."""

TRIES = 4
"""At most, each with other pixels."""

ALIKE = 0.7
"""Of the larger of two sums of squares: a smaller one is another minimum."""

LIGHT_SHARE = 3
"""Unknowns of the lights that there are at most for each pixel of the subsample. A pixel of N
pictures and three channels knows 3N − 5 numbers about them."""

MUCH_LESS = 0.5
"""Of the squares of the pixels that judge: then something better is to be expected of others."""

TURNS = 8
"""Of a pull's offsets and all else, at most."""

SETTLED = 1e-4
"""Change of the squares in a turn that is the last."""

ROUNDS = 4
"""Of a polish and a search for pixels that are still caught, at most."""

FREED = 1e-3
"""Share of the squares by which the search has to lower them to be worth another polish."""


class Watch(Protocol):
    """Who is told of progress, and says when to stop."""

    def stop(self) -> bool:
        """Whether time is up."""

    def visit_few(
        self, pixels: NDArray[np.uint64], materials: Array, lights: Array, share: float
    ) -> bool:
        """A joint step of some pixels is done; whether to stop.

        `materials` (Q, D), `lights` as in x, and the mean weighted square that is left of them.
        """

    def visit(self, x: Array, squares: Array) -> bool:
        """All pixels have new materials, which leave them with `squares` (P,); whether to stop."""


@dataclass(frozen=True, eq=False)
class Lit:
    """x with lights, and with the materials of the pixels that found and judged them.

    Attributes
    ----------
    x
        All other pixels are as they were.
    fits
        Whether only noise is left of the pixels that judge.
    judges, squares
        These pixels, and the sum of their squares.
    note
        What was done, in words.
    """

    x: Array
    fits: bool
    judges: NDArray[np.uint64]
    squares: float
    note: str


@dataclass(frozen=True, eq=False)
class Fit:
    """x, and the pixels' weighted squares (P,) there."""

    x: Array
    squares: Array


def find_lights(objective: Objective, x: Array, watch: Watch, seed: int) -> Lit:
    """Lights that explain some pixels, from those of x; where they are known, they are left.

    Where no lights leave only noise, it is tried again from x with other pixels, and the lights
    that leave least are taken: pixels are few, and some lead into a wrong valley.
    """
    judge = Neighbours(objective)
    if objective.lighting is None:
        return Lit(x, fits=True, judges=judge.pixels, squares=0.0, note="lights known")
    rng = np.random.default_rng(seed)
    best, used = None, list[int]()
    with _one_blas_thread():
        for _ in range(TRIES):
            lit, stop = _try(objective, x, judge, rng, watch, used)
            left = sorted([lit.squares, lit.squares if best is None else best.squares])
            again = best is None or left[0] < ALIKE * left[1]
            if best is None or lit.squares < best.squares:
                best = lit
            if stop or best.fits or not again:
                break
    assert best is not None
    return replace(best, note=f"lights from {' and '.join(map(str, used))} pixels")


def _try(
    objective: Objective,
    x: Array,
    judge: Neighbours,
    rng: np.random.Generator,
    watch: Watch,
    used: list[int],
) -> tuple[Lit, bool]:
    """Lights that some pixels find from x, and others after them; and whether to stop altogether.

    The numbers of pixels are added to `used`.
    """
    layout = objective.layout
    lights = layout.light_channels * layout.pictures * layout.coefficients
    drawn = rng.permutation(objective.pixels).astype(np.uint64)
    nothing = EXACT**2 * objective.total_weight * len(judge.pixels) / objective.pixels
    fits, left, sizes = False, math.inf, list(SUBSAMPLES)
    while True:
        count = min(objective.pixels, max(sizes.pop(0), lights // LIGHT_SHARE))
        used.append(count)
        chosen, drawn = np.sort(drawn[:count]), np.roll(drawn, -count)
        found, stop = _lit_by(objective, x, chosen, watch)
        materials, squares = descended(objective, found, judge.pixels, steps=STEPS, starts=2)
        found = put(objective, found, judge.pixels, materials)
        before, now = left, float(squares.sum())
        if now < before:
            x, left = found, now
            fits = not judge.pixels.size or judge.shared(x) <= NOISE_SHARED
        hopeless = not fits and now > MUCH_LESS * before
        if stop or hopeless or (fits and left <= nothing) or not sizes:
            return Lit(x, fits, judge.pixels, left, ""), stop
        if fits:
            sizes = sizes[-1:]


def fit_materials(objective: Objective, x: Array, watch: Watch) -> Fit | None:
    """All pixels' materials for the lights of x, then both together; None if time ran out."""
    with _one_blas_thread():
        found = fitted(objective, x, starts=1, stop=watch.stop)
        if found is None:
            return None
        x, squares = retried(objective, *found)
        stop = watch.visit(x, squares)
        if objective.lighting is None:
            return Fit(x, squares)
        for _ in range(ROUNDS):
            if stop:
                break
            x, squares = polished(objective, x, squares, watch.visit, watch.stop)
            before = float(squares.sum())
            x, squares = retried(objective, x, squares)
            left = float(squares.sum())
            if left < before:
                stop = watch.visit(x, squares)
            if left >= (1 - FREED) * before:
                break
    return Fit(x, squares)


def fit_pulled(objective: Objective, x: Array, pull: MaterialPull, watch: Watch) -> Array | None:
    """X with squares and pull together as low as they get from x; None if time ran out before.

    The pull's offsets are put to their best values in turns with all else.
    """
    data = np.inf
    with _one_blas_thread():
        for turn in range(TURNS):
            towards = Towards(pull.shifted(x), pull.precision)
            starts = 1 if turn == 0 else 0
            found = fitted(objective, x, starts=starts, towards=towards, stop=watch.stop)
            if found is None:
                return None if turn == 0 else x
            x, squares = found
            if objective.lighting is not None:
                x, squares = polished(
                    objective, x, squares, lambda *_: watch.stop(), watch.stop, towards
                )
            stop = watch.visit(x, squares)
            before, data = data, float(squares.sum())
            if stop or abs(before - data) < SETTLED * data:
                break
    return x


def _one_blas_thread() -> AbstractContextManager[object]:
    """Sums split over threads would round differently on a machine with more processors."""
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(1, user_api="blas")
    return limits


def _lit_by(
    objective: Objective, x: Array, chosen: NDArray[np.uint64], watch: Watch
) -> tuple[Array, bool]:
    """X with the lights that these pixels find from it, and their materials; whether to stop."""
    few = objective.restricted(chosen)
    everything = slice(None)
    stopped = False

    def visit(of_few: Array, total: float) -> bool:
        nonlocal stopped
        stopped = watch.visit_few(
            chosen,
            taken(few, of_few, everything),
            of_few[few.layout.lighting],
            total / few.total_weight,
        )
        return stopped

    of_few, _ = subsample.minimize(few, objective.part_of(x, chosen), visit)
    x = put(objective, x, chosen, taken(few, of_few, everything))
    x[objective.layout.lighting] = of_few[few.layout.lighting]
    return x, stopped
