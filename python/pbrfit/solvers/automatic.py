"""`auto`: Gauss-Newton first, then L-BFGS where there is more to lower than squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.result import Status
from pbrfit.second_order import Lit
from pbrfit.solvers.descent import Descent, lowered, robust_around, staged
from pbrfit.solvers.first_order import FIRST_SHARE
from pbrfit.solvers.gauss_newton import find_lights, fit_materials, with_material_prior
from pbrfit.solvers.learning import learns, learnt
from pbrfit.solvers.run import Run

Array = NDArray[np.float64]

MUCH_LESS = 0.5
"""Of the squares of L-BFGS's fit: lights that leave less are better ones, whatever they leave."""


def auto(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended.

    Where neighbouring pixels have something in common in what Gauss-Newton leaves of them, the
    model is wrong somewhere: normals, field of view, shadows, order of the lights. A lower loss can
    mean worse materials there, because lights that fit some pixels closely bend their materials to
    the error. Then L-BFGS takes all pixels from the start.
    """
    least, lit = (loss, x), find_lights(run, x)
    fits = lit.fits
    if not fits:
        least, fits = _by_all_pixels(run, x, loss, lit, start_given=start_given)
    if fits:
        found = fit_materials(run, lit)
        if found is None:
            return least[1], *run.ended("")
        x = found
        if learns(run) and run.left > 0 and not run.out_of_time():
            x = with_material_prior(run, x)
    else:
        x = least[1]
        if learns(run) and run.left > 0 and not run.out_of_time():
            x, _ = learnt(run, x)
    only_squares = not run.objective.penalties and run.robust == "none"
    if not (fits and only_squares) and run.left > 0 and not run.out_of_time():
        if not learns(run):  # else it is robust already
            robust_around(run, (loss, x))
        x = lowered(run, x)
    comparable = not learns(run) and run.robust == "none"
    if comparable and run.rows[-1].loss > least[0]:
        # Squares know nothing of penalties, and there was no time to lower these.
        return least[1], *run.ended("", "; kept an earlier state, whose loss is lower")
    why = "no joint step lowers the squares" if fits and only_squares else "the loss falls no"
    return x, *run.ended(f"{why} further")


def _by_all_pixels(
    run: Run, start: Array, loss: float, lit: Lit, *, start_given: bool
) -> tuple[tuple[float, Array], bool]:
    """Loss and x of L-BFGS from the start, and whether the lights that are there are far better."""
    objective = run.objective
    descent = Descent.for_size(run)
    with run.stage(descent.name) as notes:
        share = FIRST_SHARE if learns(run) else 1.0
        x, loss, _ = staged(run, start, loss, share * run.left, descent, start_given=start_given)
        residuals = objective.problem.normal_equations(objective.for_core(x), lit.judges)[2]
        better = lit.squares <= MUCH_LESS * float(residuals.sum())
        notes.append(
            "lights by Gauss-Newton are far better and were kept"
            if better
            else "the model does not fit the pictures: residuals of neighbours are alike"
        )
    return (loss, x), better
