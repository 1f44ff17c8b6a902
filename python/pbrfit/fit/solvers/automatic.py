"""`auto`: Gauss-Newton first, then L-BFGS where there is more to lower than squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton import LightEstimate
from pbrfit.fit.solvers.descent import STALL, Descent, lowered, robust_around, staged
from pbrfit.fit.solvers.first_order import FIRST_SHARE
from pbrfit.fit.solvers.gauss_newton import find_lights, fit_materials, with_material_prior
from pbrfit.fit.solvers.learning import learns, learnt
from pbrfit.fit.solvers.run import Run
from pbrfit.result.result import Status

Array = NDArray[np.float64]

MUCH_LESS = 0.1
"""Of the squares of L-BFGS's fit: one that leaves less is the better one, whatever it leaves."""

SAME = 0.9
"""Of the squares of L-BFGS's fit: one that leaves as much, and no more, has found the same, and has
come further along its valleys. After 250 iterations on seven rooms Gauss-Newton left 0.93 to 0.99
of L-BFGS's squares where lights of order 2 were fitted to pictures of order 3, and its materials
were better; with a wrong field of view it left 0.42 to 0.79, and they were worse."""

NO_FIT = "the model does not fit the pictures: residuals of neighbours are alike"
NO_SQUARES = "for a robust loss"
"""Why L-BFGS takes all pixels from the start."""

LIKELY = (0.8, 1.3)
"""Of the squares of the pixels that judge: all may have found the same."""


def auto(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended.

    Where neighbouring pixels have something in common in what Gauss-Newton leaves of them, the
    model is wrong somewhere: normals, field of view, shadows, order of the lights. A lower loss can
    mean worse materials there, because lights that fit some pixels closely bend their materials to
    the error. Then L-BFGS takes all pixels from the start, and its fit stays unless Gauss-Newton's
    is the same or far better. It takes them with a robust loss too: squares of outliers lead far
    from where that is least, and the material prior would be learnt there.
    """
    least, by_all, lit = (loss, x), None, None
    if run.robust == "none":
        lit = find_lights(run, x)
    if lit is None or not lit.fits:
        why = NO_SQUARES if lit is None else NO_FIT
        least = _by_all_pixels(run, x, loss, why, start_given=start_given)
        by_all = least[1]
    found = None
    if lit is not None and (by_all is None or _may_be_better(run, lit, by_all)):
        found = fit_materials(run, lit)
    if found is not None and (by_all is None or _is_better(run, found, by_all)):
        x, squares_are_least = with_material_prior(run, found), True
    else:
        x, squares_are_least = least[1], False
        if learns(run) and _goes_on(run):
            x, _ = learnt(run, x)
    only_squares = run.robust == "none" and not run.objective.penalties
    done = squares_are_least and only_squares
    if not done and _goes_on(run):
        if not learns(run):  # else it is robust already
            robust_around(run, (loss, x))
        x = lowered(run, x, stall=STALL if squares_are_least else None)
    comparable = not learns(run) and run.robust == "none"
    if comparable and run.rows[-1].loss > least[0]:
        # Squares know nothing of penalties, and there was no time to lower these.
        return least[1], *run.ended("", "; kept an earlier state, whose loss is lower")
    why = "no joint step lowers the squares" if done else "the loss falls no"
    return x, *run.ended(f"{why} further")


def _goes_on(run: Run) -> bool:
    return run.left > 0 and not run.out_of_time()


def _by_all_pixels(
    run: Run, x: Array, loss: float, why: str, *, start_given: bool
) -> tuple[float, Array]:
    """Loss and x of L-BFGS from the start."""
    descent = Descent.for_size(run)
    with run.stage(descent.name) as notes:
        share = FIRST_SHARE if learns(run) else 1.0
        x, loss, _ = staged(run, x, loss, share * run.left, descent, start_given=start_given)
        notes.append(why)
    return loss, x


def _may_be_better(run: Run, lit: LightEstimate, by_all: Array) -> bool:
    """Whether all pixels need be fitted to tell, by those that judge."""
    objective = run.objective
    *_, squares = objective.problem.normal_equations(objective.for_core(by_all), lit.judges)
    share = lit.squares / max(float(squares.sum()), np.finfo(np.float64).tiny)
    return _goes_on(run) and (share <= MUCH_LESS or LIKELY[0] <= share <= LIKELY[1])


def _is_better(run: Run, found: Array, by_all: Array) -> bool:
    squares, left = (run.objective.data_value_and_grad(x)[0] for x in (found, by_all))
    return squares <= MUCH_LESS * left or SAME * left <= squares <= left
