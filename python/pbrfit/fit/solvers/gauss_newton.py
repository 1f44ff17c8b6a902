"""`gauss-newton`: the squares of the data as low as they get, by `pbrfit.fit.gauss_newton`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import gauss_newton as second_order
from pbrfit.fit.gauss_newton import LightEstimate
from pbrfit.fit.gauss_newton.pixels import put
from pbrfit.fit.solvers.learning import learns, learnt
from pbrfit.fit.solvers.run import Run
from pbrfit.result.result import Status

Array = NDArray[np.float64]

EXACT = 1e-6
"""Root mean square of residuals, at mean radiance 0.4: rounding to float32 leaves 10⁻⁸."""


class _Watch:
    """Makes iterations and rows of the history of what `second_order` tells of all pixels."""

    def __init__(self, run: Run, x: Array) -> None:
        self._run, self._x = run, x
        self._steps_of_few, self._most_of_few = 0, run.left

    def stop(self) -> bool:
        return self._run.out_of_time()

    def visit_few(
        self, pixels: NDArray[np.uint64], materials: Array, lights: Array, share: float
    ) -> bool:
        # No iterations: they cost little, and where they fail L-BFGS is to have all of these. But
        # there are no more of them, so that few iterations take little time.
        run = self._run
        self._steps_of_few += 1

        def state() -> Array:
            x = put(run.objective, self._x, pixels, materials)
            x[run.objective.layout.maps.stop :] = lights
            return x

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


def find_lights(run: Run, x: Array) -> LightEstimate:
    """Lights that explain some pixels, from x."""
    with run.stage("lights by Gauss-Newton") as notes:
        lit = second_order.find_lights(run.objective, x, _Watch(run, x), run.seed)
        notes.append(lit.note)
    return lit


def fit_materials(run: Run, lit: LightEstimate) -> Array | None:
    """X with the squares of all pixels as low as they get; None if time ran out before."""
    with run.stage("all pixels by Gauss-Newton") as notes:
        fit = second_order.fit_materials(run.objective, lit.x, _Watch(run, lit.x))
        if fit is None:
            notes.append("stopped before all pixels had lights")
    return None if fit is None else fit.x


def with_material_prior(run: Run, x: Array) -> Array:
    """X with the material prior learnt around it, and all pixels and lights fitted with it.

    Where there is none, or no time, x is as it was; so it is where nothing is left of the pictures
    but rounding. What draws materials to those that were learnt goes with the noise.
    """
    if not learns(run) or run.left <= 0 or run.out_of_time():
        return x
    if run.objective.data_value_and_grad(x)[0] <= EXACT**2:
        with run.stage("material prior") as notes:
            notes.append("left out: the pictures are explained to the last digit")
        return x
    x, pull = learnt(run, x)
    if pull is None:
        return x
    with run.stage("all pixels by Gauss-Newton, with the material prior"):
        second_order.fit_pulled(run.objective, x, pull, _Watch(run, x))
    return x


def gauss_newton(run: Run, x: Array) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended."""
    found = fit_materials(run, find_lights(run, x))
    if found is not None:
        x = with_material_prior(run, found)
    return x, *run.ended("no joint step lowers the sum further")
