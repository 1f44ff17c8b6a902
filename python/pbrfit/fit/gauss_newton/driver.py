"""The stages in order."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton import subsample
from pbrfit.fit.gauss_newton.global_gauss_newton import polish
from pbrfit.fit.gauss_newton.pixels import STEPS, Towards, descended, fit_all, place, retry, taken
from pbrfit.fit.misfit import NEIGHBOUR_CORRELATION_MAX, NeighbourPairs
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.material import HeldPull, MaterialPull

Array = NDArray[np.float64]

FEW = 256
"""Pixels that find the lights of 16 pictures. On 80 rooms of 128² without noise the
first draw of 256 sufficed for 63; joint steps cost half as much as with 512."""

TRIES = 3
"""With so many pixels, each with others, where only some lead to lights that fit."""

MORE = (512, 1024)
"""Pixels that go on where none did; and the last where noise is left, because lights from few noisy
pixels lie too far off for all to follow."""

ALIKE = 0.4
"""Of the largest sum of squares that tries left: what is smaller is another minimum."""

EXACT = 1e-5
"""Root mean square of residuals, at mean radiance 0.4, that counts as nothing left."""

LIGHT_SHARE = 3
"""Unknowns of the lights that there are at most for each pixel of the subsample. A pixel of N
pictures and three channels knows 3N − 5 numbers about them."""

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
class LightEstimate:
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


def find_lights(objective: Objective, x: Array, watch: Watch, seed: int) -> LightEstimate:
    """Lights that explain some pixels, from those of x; where they are known, they are left.

    Few pixels may lead into a wrong valley. So where their lights leave more than noise of the
    pixels that judge, others try from x. If all leave about the same, it is the model that does not
    fit; else more pixels go on from the lights that leave least.
    """
    judge = NeighbourPairs(objective)
    if objective.lighting is None:
        return LightEstimate(
            x.copy(), fits=True, judges=judge.pixels, squares=0.0, note="lights known"
        )
    search = _Search(objective, judge, watch, np.random.default_rng(seed))
    with _one_blas_thread():
        best, worst = None, 0.0
        for _ in range(TRIES):
            lit = search.by(FEW, x)
            worst = max(worst, lit.squares)
            if best is None or lit.squares < best.squares:
                best = lit
            if search.stopped or best.fits:
                break
        assert best is not None
        alike = not best.fits and best.squares > ALIKE * worst
        for size in () if alike else MORE:
            if search.stopped or (best.fits and (size < MORE[-1] or search.is_exact(best))):
                continue
            lit = search.by(size, best.x)
            if lit.squares < best.squares:
                best = lit
    counts = ", ".join(map(str, search.used))
    return replace(best, note=f"lights from {counts} pixels")


class _Search:
    """Subsets of the pixels, one after the other, that look for lights.

    Attributes
    ----------
    used
        Their sizes.
    stopped
        Whether the watch has had enough.
    """

    def __init__(
        self, objective: Objective, judge: NeighbourPairs, watch: Watch, rng: np.random.Generator
    ) -> None:
        self._objective, self._judge, self._watch, self._rng = objective, judge, watch, rng
        self.used: list[int] = []
        self.stopped = False

    def by(self, size: int, x: Array) -> LightEstimate:
        """Lights that so many pixels find from x, judged."""
        objective, judge, layout = self._objective, self._judge, self._objective.layout
        lights = layout.light_channels * layout.pictures * layout.coefficients
        count = min(objective.pixels, max(size, lights // LIGHT_SHARE))
        self.used.append(count)
        chosen = np.sort(self._rng.choice(objective.pixels, count, replace=False))
        x, self.stopped = _lit_by(objective, x, chosen.astype(np.uint64), self._watch)
        materials, squares = descended(objective, x, judge.pixels, steps=STEPS, starts=2)
        place(objective, x, judge.pixels, materials)
        fits = not judge.pixels.size or judge.residual_correlation(x) <= NEIGHBOUR_CORRELATION_MAX
        return LightEstimate(x, fits, judge.pixels, float(squares.sum()), "")

    def is_exact(self, lit: LightEstimate) -> bool:
        """Whether nothing is left of the pixels that judge."""
        share = len(lit.judges) / self._objective.pixels
        return lit.squares <= EXACT**2 * self._objective.total_weight * share


def fit_materials(objective: Objective, x: Array, watch: Watch) -> Fit | None:
    """All pixels' materials for the lights of x, then both together; None if time ran out.

    x changes.
    """
    with _one_blas_thread():
        squares = fit_all(objective, x, starts=1, stop=watch.stop)
        if squares is None:
            return None
        retry(objective, x, squares, watch.stop)
        stop = watch.visit(x, squares)
        if objective.lighting is None:
            return Fit(x, squares)
        for _ in range(ROUNDS):
            if stop:
                break
            polish(objective, x, squares, watch.visit, watch.stop)
            before = float(squares.sum())
            retry(objective, x, squares, watch.stop)
            left = float(squares.sum())
            if left < before:
                stop = watch.visit(x, squares)
            if left >= (1 - FREED) * before:
                break
    return Fit(x, squares)


def fit_pulled(objective: Objective, x: Array, pull: MaterialPull | HeldPull, watch: Watch) -> None:
    """Squares and pull together as low as they get from x, which changes.

    The pull's offsets are put to their best values in turns with all else. Where time runs out
    before all pixels have had their turn, x is as it was before it.
    """
    data = np.inf
    with _one_blas_thread():
        for turn in range(TURNS):
            towards = Towards(pull.shifted(x), pull.precision)
            starts = 1 if turn == 0 else 0
            before_turn = x.copy()
            squares = fit_all(objective, x, starts=starts, towards=towards, stop=watch.stop)
            if squares is None:
                x[:] = before_turn
                break
            del before_turn  # of the size of x, which counts
            if objective.lighting is not None:
                polish(objective, x, squares, lambda *_: watch.stop(), watch.stop, towards)
            stop = watch.visit(x, squares)
            before, data = data, float(squares.sum())
            if stop or abs(before - data) < SETTLED * data:
                break


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
    x = x.copy()
    objective.put_part(x, chosen, of_few)
    return x, stopped
