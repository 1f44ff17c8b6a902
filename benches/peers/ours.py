"""Our own core through Python: x and gradient in float64, the gradient's memory used again."""

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
        self._gradient = np.empty_like(case.x)

    def evaluate(self) -> float:
        """The loss; the gradient is kept."""
        value, _ = self._problem.value_and_grad(self._x, out=self._gradient)
        return value

    def gradient(self) -> NDArray[np.float64]:
        """Of the last evaluation, in the order of x."""
        return self._gradient
