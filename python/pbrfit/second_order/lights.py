"""The system of the lights when pixels are solved for: steps from a matrix, or by products."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.layout import Layout
from pbrfit.objective import Objective
from pbrfit.second_order.pixels import Pixels, Towards, taken

Array = NDArray[np.float64]

RIDGE = 1e-13
"""Of the largest diagonal entry: lights may have directions that no pixel sees."""


def as_in_x(moves: Array, layout: Layout) -> Array:
    """From (light channel, picture, coefficient), as the core has them, to the order in x."""
    shape = (layout.light_channels, layout.pictures, layout.coefficients)
    return moves.reshape(shape).transpose(1, 2, 0).ravel()


class Cholesky:
    """Solves with the matrix of some pixels, damped by a share of its diagonal.

    Attributes
    ----------
    diagonal
        Of the matrix without damping.

    Raises
    ------
    LinAlgError
        If the matrix is not positive definite, which rounding can do to it.
    """

    def __init__(self, matrix: Array, damping: float) -> None:
        from scipy.linalg import cho_factor

        diagonal = np.einsum("ii->i", matrix)
        self.diagonal = diagonal.copy()
        diagonal += damping * np.abs(diagonal) + RIDGE * diagonal.max() + np.finfo(float).tiny
        self._factor = cho_factor(matrix, overwrite_a=True, check_finite=False)

    def solve(self, right: Array) -> Array:
        """The vector that the matrix takes to `right`."""
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve(self._factor, right, check_finite=False))


def options(
    objective: Objective, x: Array, pixels: Pixels, towards: Towards | None
) -> dict[str, Any]:
    """What the core has to know of mono lights and pulls, beside x and pixels."""
    layout = objective.layout
    found: dict[str, Any] = {"mono": layout.light_channels < layout.channels}
    if towards is not None:
        finish = taken(objective, x, pixels)[:, layout.channels :]
        found |= {
            "precision": towards.precision,
            "off": finish - towards.centre,
        }
    return found
