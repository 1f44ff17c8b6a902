"""Our own core through Python, as the solver calls it: x and gradient in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.model.reflection import Model
from peers.case import Case


class Ours:
    """The peer."""

    def __init__(self, case: Case, threads: int, model: Model = "paper") -> None:
        self._problem = _core.Problem(
            case.images, case.normals, case.views, threads=threads, model=model
        )
        self._x = case.x
        self._gradient = np.empty(0)

    def evaluate(self) -> float:
        """The loss; the gradient is kept."""
        value, self._gradient = self._problem.value_and_grad(self._x)
        return value

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        return self._gradient
