"""The solvers of `decompose`: from a start to a fit.

`gauss-newton`, the default, takes joint steps of lights and materials for squares and the material
prior, and lowers other penalties from there. `lbfgsb` is the paper's recipe and the reference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import gauss_newton as joint
from pbrfit.fit.gauss_newton import LightEstimate
from pbrfit.fit.gauss_newton.pixels import put
from pbrfit.fit.plan import FitPlan
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.material import fit_prior
from pbrfit.fit.priors.penalties import Penalty, penalties
from pbrfit.fit.settings import EXACT_RMSE, STALL
from pbrfit.fit.solvers.descent import by_scipy, lowered, staged
from pbrfit.fit.solvers.run import Run
from pbrfit.model.materials import Materials
from pbrfit.result.data import Status

Array = NDArray[np.float64]


def solve(run: Run, x: Array, *, start_given: bool) -> tuple[Array, Status, str]:
    """X of a fit from x by the solver of the options, and why it ended.

    `start_given` tells L-BFGS-B to trust the start: it has no stages then.
    """
    loss = run.evaluate(x)[0]  # not the gradient, which is as large as x
    run.record(x, loss)
    if run.left <= 0:
        return x, Status.ITERATION_LIMIT, "0 iterations asked for"
    method = gauss_newton if run.options.solver == "gauss-newton" else lbfgsb
    return method(run, x, loss, start_given=start_given)


def gauss_newton(
    run: Run, x: Array, loss: float, *, start_given: bool
) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended.

    With a robust loss L-BFGS-B takes all pixels from the start: squares of outliers lead far from
    where that is least, and the material prior would be fitted there.
    """
    if run.options.robust != "none":
        return lbfgsb(run, x, loss, start_given=start_given)
    start = x
    found = fit_materials(run, find_lights(run, x))
    if found is not None:
        x = with_material_prior(run, found)
    why = "no joint step lowers the sum further"
    if run.goes_on and any(penalty.name != "material" for penalty in run.objective.penalties):
        x, why = lowered(run, x, stall=STALL), "the loss falls no further"
    if not run.has_mixture_prior and run.rows[-1].loss > loss:
        # Squares know nothing of penalties, and there was no time to lower these.
        return start, *run.ended(why, "; kept the start, whose loss is lower")
    return x, *run.ended(why)


def lbfgsb(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended."""
    with run.stage("L-BFGS-B"):
        x, _, kept = staged(run, x, loss, by_scipy, start_given=start_given)
    if run.has_mixture_prior and not run.out_of_time():
        x, prior = fit_mixture_prior(run, x)
        kept = kept if prior is None else ""
        if run.goes_on:  # scipy takes a step even where none is left
            with run.stage("L-BFGS-B with the material prior"):
                _, x = by_scipy(run, x, run.left)
    # With zero tolerances scipy stops early only where rounding hides any further descent.
    return x, *run.ended("no step lowers the loss further", kept)


def find_lights(run: Run, x: Array) -> LightEstimate:
    """Lights that explain some pixels, from x."""
    with run.stage("lights by Gauss-Newton") as notes:
        lights = joint.find_lights(run.objective, x, _Watch(run, x), run.options.seed)
        notes.append(lights.note)
    return lights


def fit_materials(run: Run, lights: LightEstimate) -> Array | None:
    """X with the squares of all pixels as low as they get; None if time ran out before."""
    with run.stage("all pixels by Gauss-Newton") as notes:
        done = joint.fit_materials(run.objective, lights.x, _Watch(run, lights.x))
        if done is None:
            notes.append("stopped before all pixels had lights")
    return None if done is None else lights.x


def with_material_prior(run: Run, x: Array) -> Array:
    """X with the material prior fitted around it, and all pixels and lights fitted with it.

    Where there is none, or no time, x is as it was; so it is where nothing is left of the pictures
    but rounding: the prior is as strong as the noise.
    """
    if not run.has_mixture_prior or not run.goes_on:
        return x
    if run.objective.data_value_and_grad(x)[0] <= EXACT_RMSE**2:
        with run.stage("material prior") as notes:
            notes.append("left out: the pictures are explained to the last digit")
        return x
    x, prior = fit_mixture_prior(run, x)
    if prior is None:
        return x
    with run.stage("all pixels by Gauss-Newton, with the material prior"):
        joint.fit_with_prior(run.objective, x, prior, _Watch(run, x))
    return x


def fit_mixture_prior(run: Run, x: Array) -> tuple[Array, GaussianPrior | None]:
    """X with the material prior fitted around it, which is a penalty from here on; one iteration.

    Where time runs out before, x is as it was and there is no prior.

    Weights that are chosen by rule are chosen by the lights that were found with it.
    """
    objective = run.objective
    others: list[Penalty] = []
    with run.stage("material prior") as notes:
        found = _fitted_by(run, x)
        if found is None:
            notes.append("stopped before all pixels had theirs")
            return x, None
        x, prior = found
        if run.shared_state is not None:
            others = run.shared_state.penalties(objective.layout)
        run.measured_lighting = objective.unpack(x)[1]
        plan = FitPlan.of(
            run.scene, objective.layout, priors=run.options.priors, lighting=run.measured_lighting
        )
        objective.penalties = [*penalties(objective.layout, plan.priors), *others, prior]
        objective.robust = run.robust_around(x)
        loss = run.evaluate(x)[0]
        run.iteration += 1
        run.record(x, loss)
    return x, prior


def _fitted_by(run: Run, x: Array) -> tuple[Array, GaussianPrior] | None:
    """X and the prior: that of the shared state, if there is one, else of the run's own pixels."""
    reweighted = run.objective.reweighted(x)
    if run.shared_state is not None:
        assert run.shared_state.material is not None
        return run.shared_state.material.applied(reweighted, x, run.out_of_time)
    found = fit_prior(reweighted, x, run.options.priors.material, stop=run.out_of_time)
    if found is None:
        return None
    x, prior, fitted = found
    run.fitted_prior = fitted, prior
    return x, prior


class _Watch:
    """Turns steps of Gauss-Newton into iterations and rows of the history."""

    def __init__(self, run: Run, x: Array) -> None:
        self._run, self._x = run, x
        self._steps_of_few, self._most_of_few = 0, run.left

    def stop(self) -> bool:
        return self._run.out_of_time()

    def visit_few(
        self, pixels: NDArray[np.uint64], materials: Array, lights: Array, share: float
    ) -> bool:
        # Steps on a subset do not count as iterations, because they cost little. But there are no
        # more of them, so that few iterations take little time.
        run = self._run
        self._steps_of_few += 1

        def state() -> tuple[Materials, Array]:
            x = put(run.objective, self._x, pixels, materials)
            x[run.objective.layout.maps.stop :] = lights
            return run.objective.unpack(x)

        run.tell(run.objective.residual_rmse(share), state)
        return self._steps_of_few >= self._most_of_few or run.out_of_time()

    def visit(self, x: Array, squares: Array) -> bool:
        run = self._run
        # Pixels that are freed after the last iteration belong to that.
        run.iteration += run.left > 0
        # Squares are those of float64, which a float32 evaluation of a good fit does not reach.
        loss = data = float(squares.sum()) / run.objective.total_weight
        if run.objective.penalties:
            loss += run.objective.add_penalties(x, np.zeros(run.objective.size))
        run.record(x, loss, data)
        return run.left <= 0 or run.out_of_time()
