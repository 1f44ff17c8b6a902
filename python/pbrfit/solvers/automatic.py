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
    start = x
    lit = find_lights(run, x)
    found: Array | None = None
    if not lit.fits:
        found = _by_all_pixels(run, start, loss, lit, start_given=start_given)
    if found is not None:
        x = found
        if learns(run) and run.left > 0 and not run.out_of_time():
            x, _ = learnt(run, x)
    else:
        found = fit_materials(run, lit)
        if found is None:
            return start, *run.ended("")
        x = found
        limited = run.left <= 0 or run.out_of_time()
        if limited and run.rows[-1].loss > loss:  # by penalties, of which squares know nothing
            return start, *run.ended("", "; kept the start, whose loss is lower")
        if learns(run) and run.left > 0 and not run.out_of_time():
            x = with_material_prior(run, x)
        if not run.objective.penalties and run.robust == "none":
            return x, *run.ended("no joint step lowers the squares further")
    if run.left > 0 and not run.out_of_time():
        if not learns(run):  # else it is robust already
            robust_around(run, (loss, x))
        x = lowered(run, x)
    return x, *run.ended("the loss falls no further")


def _by_all_pixels(
    run: Run, start: Array, loss: float, lit: Lit, *, start_given: bool
) -> Array | None:
    """X of L-BFGS from the start; None if the lights that are found already are far better."""
    objective = run.objective
    descent = Descent.for_size(run)
    with run.stage(descent.name) as notes:
        share = FIRST_SHARE if learns(run) else 1.0
        found, _, _ = staged(run, start, loss, share * run.left, descent, start_given=start_given)
        residuals = objective.problem.normal_equations(objective.for_core(found), lit.judges)[2]
        if lit.squares <= MUCH_LESS * float(residuals.sum()):
            notes.append("lights by Gauss-Newton are far better and were kept")
            return None
        notes.append("the model does not fit the pictures: residuals of neighbours are alike")
    return found
