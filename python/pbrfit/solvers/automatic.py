"""`auto`: Gauss-Newton first, then L-BFGS on the whole objective where that has more than the data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.result import Status
from pbrfit.second_order import Lit
from pbrfit.solvers.descent import robust_around, scipys, staged
from pbrfit.solvers.first_order import FIRST_SHARE
from pbrfit.solvers.gauss_newton import find_lights, fit_materials
from pbrfit.solvers.learning import learns, learnt
from pbrfit.solvers.run import Run

Array = NDArray[np.float64]

MUCH_LESS = 0.5
"""Of the squares of L-BFGS's fit: lights that leave less are the better ones, whatever they leave."""


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
    if found is None:
        found = fit_materials(run, lit)
        if found is None:
            return start, *run.ended("")
        if not (learns(run) or run.objective.penalties or run.robust != "none"):
            return found, *run.ended("no joint step lowers the squares further")
    x = found
    if run.left <= 0 or run.out_of_time():
        return x, *run.ended("")
    if learns(run):
        x, _ = learnt(run, x)
    else:
        robust_around(run, (loss, x))
    if run.left > 0 and not run.out_of_time():
        with run.stage("L-BFGS-B"):
            _, x = scipys(run, x, run.left)
    return x, *run.ended("no step lowers the loss further")


def _by_all_pixels(
    run: Run, start: Array, loss: float, lit: Lit, *, start_given: bool
) -> Array | None:
    """X of L-BFGS from the start; None if the lights that are found already are far better."""
    objective = run.objective
    with run.stage("L-BFGS-B") as notes:
        share = FIRST_SHARE if learns(run) else 1.0
        found, _, _ = staged(run, start, loss, share * run.left, start_given=start_given)
        residuals = objective.problem.normal_equations(objective.for_core(found), lit.judges)[2]
        if lit.squares <= MUCH_LESS * float(residuals.sum()):
            notes.append("lights by Gauss-Newton are far better and were kept")
            return None
        notes.append("the model does not fit the pictures: residuals of neighbours are alike")
    return found
