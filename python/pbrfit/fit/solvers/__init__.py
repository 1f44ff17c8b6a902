"""The solvers of `decompose`: from a start to a fit.

`lbfgsb` is the paper's recipe and the reference, `gauss-newton` the fast one for squares and the
learnt material prior, `auto` puts them together.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.solvers.automatic import auto
from pbrfit.fit.solvers.first_order import lbfgsb
from pbrfit.fit.solvers.gauss_newton import gauss_newton
from pbrfit.fit.solvers.run import Limits, Progress, Run
from pbrfit.result.result import Status

__all__ = ["SOLVERS", "Limits", "Progress", "Run", "Solver", "check_solver", "solve"]

Solver = Literal["auto", "gauss-newton", "lbfgsb"]
SOLVERS: tuple[Solver, ...] = get_args(Solver)


def check_solver(solver: str) -> None:
    """Refuse a name that is none.

    Raises
    ------
    InputError
        If it is none of `SOLVERS`.
    """
    if solver not in SOLVERS:
        raise InputError(f"solver: expected one of {', '.join(SOLVERS)}, found {solver!r}")


def solve(
    run: Run, solver: Solver, x: NDArray[np.float64], *, start_given: bool
) -> tuple[NDArray[np.float64], Status, str]:
    """X of a fit from x, and why it ended.

    `start_given` tells L-BFGS-B to trust the start: it has no stages then.
    """
    loss = run.evaluate(x)[0]  # not the gradient, which is as large as x
    run.record(x, loss)
    if run.left <= 0:
        return x, Status.ITERATION_LIMIT, "0 iterations asked for"
    if solver == "gauss-newton":
        return gauss_newton(run, x)
    method = auto if solver == "auto" else lbfgsb
    return method(run, x, loss, start_given=start_given)
