"""Bounded L-BFGS on all unknowns: the paper's recipe, in stages that keep off roughness 0."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.run import Run
from pbrfit.fit.settings import (
    DATA_SHARE_OF_ITERATIONS,
    LBFGS_PAIRS,
    LBFGS_STAGES,
    LBFGS_STAGES_GIVEN_START,
    ROBUST_STAGES_GIVEN_START,
    START_ROUGHNESS,
    TRAP_ROUGHNESS,
    TRAPPED_MARGIN,
)
from pbrfit.result.options import ROBUST_LOSSES
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]


def staged(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, float, str]:
    """X, its loss, and which state that is, after the iterations that the data may have.

    The last is empty unless the state is one from before the last restart.
    """
    iterations = (DATA_SHARE_OF_ITERATIONS if run.has_mixture_prior else 1.0) * run.left
    best = loss, x
    trapped = False
    before = run.iteration
    for lowest_roughness, share in _stages(run, start_given):
        left = round(share * iterations) - (run.iteration - before)
        if left <= 0 or run.out_of_time():
            continue
        if run.iteration > before:
            best = robust_around(run, best)
        if trapped:
            x = _restarted(run, x)
        loss, x = by_scipy(run, x, left, lowest_roughness)
        trapped = lowest_roughness > 0
        # A restart raises the loss at first, and time may run out before it pays.
        best = min(best, (loss, x), key=lambda pair: pair[0])
    kept = "; kept the better state before the last restart" if best[0] < loss else ""
    loss, x = best
    return x, loss, kept


def _stages(run: Run, start_given: bool) -> tuple[tuple[float, float], ...]:
    if not start_given:
        return LBFGS_STAGES
    return (
        LBFGS_STAGES_GIVEN_START
        if run.options.robust not in ROBUST_LOSSES
        else ROBUST_STAGES_GIVEN_START
    )


def robust_around(run: Run, best: tuple[float, Array]) -> tuple[float, Array]:
    """Make the loss robust, if it is to be, with the scale at this state; returns it anew."""
    if run.options.robust not in ROBUST_LOSSES:
        return best
    _, x = best
    run.objective.robust = run.robust_around(x)
    return run.evaluate(x)[0], x


def _restarted(run: Run, x: Array) -> Array:
    """X with the pixels that are trapped at the roughness bound put back to the middle."""
    x = x.copy()
    roughness = x[run.objective.roughness]
    roughness[roughness <= TRAP_ROUGHNESS + TRAPPED_MARGIN] = START_ROUGHNESS
    return x


def _in_time(run: Run) -> Callable[[Array], tuple[float, Array]]:
    """`run.evaluate`, which ends a search along a line by StopIteration where time is up.

    The first call always returns: a search needs to know where it is.
    """
    first = True

    def evaluate(x: Array) -> tuple[float, Array]:
        nonlocal first
        if not first and run.out_of_time():
            raise StopIteration
        first = False
        return run.evaluate(x)

    return evaluate


def by_scipy(
    run: Run,
    x: Array,
    iterations: int,
    lowest_roughness: float = 0.0,
    stall: tuple[int, float] | None = None,
) -> tuple[float, Array]:
    """Loss and x after so many iterations of scipy's L-BFGS-B at most, which go into the history.

    With `stall` it also stops where the loss fell by less than a share of itself over a number of
    iterations.
    """
    from scipy.optimize import Bounds, minimize

    lower, upper = run.objective.bounds.T.copy()
    lower[run.objective.roughness] = lowest_roughness

    window, share = stall or (0, 0.0)
    losses: deque[float] = deque(maxlen=window + 1)
    in_time = _in_time(run)
    last: tuple[float, Array] | None = None

    def evaluate(x: Array) -> tuple[float, Array]:
        nonlocal last
        loss, gradient = in_time(x)
        if last is None and run.options.time_limit is not None:
            last = loss, x.copy()
        return loss, gradient

    def after_iteration(intermediate_result: Any) -> None:
        nonlocal last
        run.iteration += 1
        loss = float(intermediate_result.fun)
        run.record(intermediate_result.x, loss)
        if run.options.time_limit is not None:  # else nothing ends a search along a line
            last = loss, intermediate_result.x.copy()
        losses.append(loss)
        stalled = window and len(losses) > window and losses[0] - loss < share * losses[0]
        if stalled or run.out_of_time():
            raise StopIteration

    with one_blas_thread():
        try:
            found = minimize(
                evaluate,
                x,
                jac=True,
                method="L-BFGS-B",
                bounds=Bounds(lower, upper),
                callback=after_iteration,
                options={
                    "maxiter": iterations,
                    "maxfun": 10**9,  # iterations and time are the limits
                    "maxcor": LBFGS_PAIRS,
                    # The loss is a mean, so its gradient entries are tiny: scipy's absolute
                    # tolerances would stop at once. Run on until no step lowers the loss.
                    "ftol": 0.0,
                    "gtol": 0.0,
                },
            )
        except StopIteration:
            assert last is not None
            return last
    return float(found.fun), found.x
