"""Bounded L-BFGS on all unknowns: the paper's recipe, in stages that keep off roughness 0."""

from __future__ import annotations

from typing import Any

from pbrfit.fit import settings
from pbrfit.fit.run import Run
from pbrfit.values.arrays import Array


def staged(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, str]:
    """X, whose loss is given, after the iterations that the data may have; and which state that is.

    The last is empty unless the state is one from before the last restart.
    """
    # Half of them are for the mixture prior, which is fitted around where data alone lead.
    iterations = run.left / 2 if run.has_mixture_prior else run.left
    stages = settings.LBFGS_STAGES[-1:] if start_given else settings.LBFGS_STAGES
    best = loss, x
    trapped = False
    before = run.iteration
    for lowest_roughness, share in stages:
        left = round(share * iterations) - (run.iteration - before)
        if left <= 0 or run.out_of_time():
            continue
        if trapped:  # pixels at the roughness bound go back to the middle
            x = x.copy()
            roughness = x[run.objective.roughness]
            at_bound = roughness <= settings.TRAP_ROUGHNESS + settings.TRAPPED_MARGIN
            roughness[at_bound] = settings.START_MIDDLE
        loss, x = by_scipy(run, x, left, lowest_roughness)
        trapped = lowest_roughness > 0
        # A restart raises the loss at first, and time may run out before it pays.
        best = min(best, (loss, x), key=lambda pair: pair[0])
    return best[1], "; kept the better state before the last restart" if best[0] < loss else ""


def by_scipy(
    run: Run, x: Array, iterations: int, lowest_roughness: float = 0.0
) -> tuple[float, Array]:
    """Loss and x after so many iterations of scipy's L-BFGS-B at most, which go into the history.

    Where time is up a search along a line ends too; then x is that of the last iteration.
    """
    from scipy.optimize import Bounds, minimize

    lower, upper = run.objective.bounds.T.copy()
    lower[run.objective.roughness] = lowest_roughness
    last: tuple[float, Array] | None = None

    def evaluate(x: Array) -> tuple[float, Array]:
        nonlocal last
        if last is not None and run.out_of_time():
            raise StopIteration
        loss, gradient = run.evaluate(x)
        if last is None:
            last = loss, x.copy()
        return loss, gradient

    def after_iteration(intermediate_result: Any) -> None:
        nonlocal last
        run.iteration += 1
        last = float(intermediate_result.fun), intermediate_result.x.copy()
        run.record(last[1], last[0])
        if run.out_of_time():
            raise StopIteration

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
