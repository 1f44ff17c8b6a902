"""`gauss-newton`: the squares of the data as low as they get, by `pbrfit.second_order`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit import second_order
from pbrfit.result import Status
from pbrfit.second_order import Fit
from pbrfit.second_order.pixels import put
from pbrfit.solvers.run import Run

Array = NDArray[np.float64]


class _Watch:
    """Makes iterations and rows of the history of what `second_order` tells."""

    def __init__(self, run: Run, x: Array) -> None:
        self._run, self._x = run, x

    def stop(self) -> bool:
        return self._run.out_of_time()

    def visit_few(
        self, pixels: NDArray[np.uint64], materials: Array, lights: Array, share: float
    ) -> bool:
        run = self._run
        run.iteration += 1

        def state() -> Array:
            x = put(run.objective, self._x, pixels, materials)
            x[run.objective.layout.maps.stop :] = lights
            return x

        run.tell(run.objective.residual_rmse(share), state)
        return run.left <= 0 or run.out_of_time()

    def visit(self, x: Array, squares: Array) -> bool:
        run = self._run
        run.iteration += 1
        # Squares are those of float64, which a float32 evaluation of a good fit does not reach.
        data = float(squares.sum()) / run.objective.total_weight
        run.record(x, data, data)
        return run.left <= 0 or run.out_of_time()


def fit_data(run: Run, x: Array) -> Fit | None:
    """The fit of the squares from x; None where time ran out before it was one."""
    with run.stage("Gauss-Newton") as notes:
        found = second_order.minimize(run.objective, x, _Watch(run, x), run.seed)
        notes.append("stopped before all pixels had lights" if found is None else found.note)
    return found


def gauss_newton(run: Run, x: Array) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended."""
    found = fit_data(run, x)
    if found is not None:
        x = found.x
    return x, *run.ended("no joint step lowers the squares further")
