"""`lbfgsb`: L-BFGS-B on all unknowns, the paper's recipe and the reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.solvers.descent import SCIPYS, staged
from pbrfit.fit.solvers.learning import learns, learnt
from pbrfit.fit.solvers.run import Run
from pbrfit.result.result import Status

Array = NDArray[np.float64]

FIRST_SHARE = 0.5
"""Of the iterations: the fit of the data that the material prior is learnt around. The rest is
spent with the prior."""


def lbfgsb(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended."""
    with run.stage("L-BFGS-B"):
        share = FIRST_SHARE if learns(run) else 1.0
        x, _, kept = staged(run, x, loss, share * run.left, SCIPYS, start_given=start_given)
    if learns(run) and not run.out_of_time():
        x, pull = learnt(run, x)
        kept = kept if pull is None else ""
        if run.left > 0 and not run.out_of_time():  # scipy takes a step even where none is left
            with run.stage("L-BFGS-B with the material prior"):
                _, x = SCIPYS(run, x, run.left)
    # With zero tolerances scipy stops early only where rounding hides any further descent.
    return x, *run.ended("no step lowers the loss further", kept)
