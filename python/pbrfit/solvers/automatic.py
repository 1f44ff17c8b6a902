"""`auto`: Gauss-Newton first, then L-BFGS on the whole objective where that has more than the data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.model_gap import NOISE_SHARED, Neighbours
from pbrfit.result import Status
from pbrfit.solvers.descent import robust_around, scipys, staged
from pbrfit.solvers.first_order import FIRST_SHARE
from pbrfit.solvers.gauss_newton import fit_data
from pbrfit.solvers.learning import learns, learnt
from pbrfit.solvers.run import Run

Array = NDArray[np.float64]

MUCH_LESS = 0.5
"""Of the squares of L-BFGS's fit: a fit that leaves less is the better one, whatever it leaves."""

EXACT = 3e-7
"""Of the pictures' root mean square: a fit that leaves less than this leaves rounding of float32."""


def auto(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended."""
    start = x
    fit = fit_data(run, x)
    if fit is None:
        return x, *run.ended("")
    x = fit.x
    if _only_noise_is_left(run, x):
        if not learns(run) and not run.objective.penalties and run.robust == "none":
            return x, *run.ended("no joint step lowers the squares further")
    else:
        x = _by_all_pixels(run, start, loss, x, float(fit.squares.sum()), start_given)
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


def _only_noise_is_left(run: Run, x: Array) -> bool:
    """Whether neighbouring pixels have nothing in common in what is left of the pictures.

    If they have, the model is wrong somewhere (normals, field of view, shadows, order of the
    lights), and a lower loss can mean worse materials: lights that fit some pixels closely bend
    their materials to the error.
    """
    neighbours = Neighbours(run.objective)
    if run.objective.lighting is None or not neighbours.pixels.size:
        return True
    return neighbours.shared(x) <= NOISE_SHARED


def _by_all_pixels(
    run: Run, start: Array, loss: float, x: Array, squares: float, start_given: bool
) -> Array:
    """X of L-BFGS on all pixels from the start, or the one given if it is far better."""
    with run.stage("L-BFGS-B") as notes:
        share = FIRST_SHARE if learns(run) else 1.0
        found, _, _ = staged(run, start, loss, share * run.left, start_given=start_given)
        left = run.objective.data_value_and_grad(found)[0] * run.objective.total_weight
        if squares <= MUCH_LESS * left:
            notes.append("Gauss-Newton's fit is far better and was kept")
            return x
        notes.append("residuals of neighbours are alike: the model does not fit the pictures")
        return found
