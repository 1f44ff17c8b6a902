"""Compare the gradient of an objective with finite differences: a check that users can run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.penalties import Penalty
from pbrfit.values.arrays import Array


@dataclass(frozen=True)
class GradientCheck:
    """One derivative along a direction, both ways."""

    function: str
    """What is derived: "loss", with all its penalties, or the name of a penalty on its own."""
    unknowns: str
    """The kind that the direction lies in."""
    analytic: float
    numeric: float
    """By the gradient, and by finite differences."""
    tolerance: float = 1e-4
    """Relative error that is none: differences carry float32's noise of 1e-5."""

    @property
    def relative_error(self) -> float:
        """|analytic - numeric| over the larger of the two."""
        largest = max(abs(self.analytic), abs(self.numeric))
        return abs(self.analytic - self.numeric) / largest if largest else 0.0

    @property
    def passed(self) -> bool:
        """Whether both agree within `tolerance`."""
        return self.relative_error <= self.tolerance


def check_gradients(objective: Objective, *, seed: int = 0) -> list[GradientCheck]:
    """Derivatives along random directions, for each kind of unknown apart.

    First of the loss, then of each penalty on its own, which beside the data may be too small to
    show an error. Materials are drawn from [0.25, 0.75], tangent offsets, where there are, from
    [-0.2, 0.2]; lights are the ones that fit them. Directions follow the signs of the gradient, so
    that contributions do not cancel.
    """
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.25, 0.75, objective.size)
    if objective.tangent_offsets is not None:
        x[objective.tangent_offsets] = 0.8 * (x[objective.tangent_offsets] - 0.5)
    x = objective.with_best_lights(x)
    if objective.lighting is not None:
        # Away from the best lights, where their gradient is zero.
        lights = x[objective.lighting]
        lights *= rng.uniform(0.8, 1.2, lights.size)
    checks = list(_along_blocks("loss", objective.value_and_grad, objective, x, rng))
    for penalty in objective.penalties:

        def alone(x: Array, penalty: Penalty = penalty) -> tuple[float, Array]:
            gradient = np.zeros_like(x)
            return penalty.value_and_grad(x, gradient), gradient

        found = _along_blocks(penalty.name, alone, objective, x, rng)
        # Without what the penalty does not depend on.
        checks += [check for check in found if check.analytic or check.numeric]
    return checks


def _along_blocks(
    name: str,
    value_and_grad: Callable[[Array], tuple[float, Array]],
    objective: Objective,
    x: Array,
    rng: np.random.Generator,
) -> Iterator[GradientCheck]:
    _, gradient = value_and_grad(x)
    for unknowns in ("albedo", "roughness", "metallic", "tangent_offsets", "lighting"):
        block: slice | None = getattr(objective, unknowns)
        if block is None:
            continue  # known, no unknown
        for _ in range(3):
            direction = np.zeros(objective.size)
            # Where the gradient is 0, forwards: a difference would show that it should not be.
            signs = np.where(gradient[block] < 0, -1, 1)
            # In units of the unknowns' own size, so that steps show above float32 noise.
            size = np.sqrt(np.mean(np.square(x[block])))
            direction[block] = size * rng.uniform(0.5, 1.0, block.stop - block.start) * signs

            def along(step: float, direction: Array = direction) -> float:
                return value_and_grad(x + step * direction)[0]

            yield GradientCheck(name, unknowns, float(gradient @ direction), ridders(along))


def ridders(f: Callable[[float], float]) -> float:
    """df/ds at s = 0 by Ridders' method.

    Central differences with steps that shrink by a constant factor are extrapolated to step zero;
    each column of the table removes one more even power of the step. The entry that changes least
    from its neighbours is taken (C. J. F. Ridders, Adv. Eng. Software 4, 1982).
    """
    best, best_change = np.nan, np.inf
    previous: list[float] = []
    shrink = 1.4
    for i in range(8):
        step = 0.1 / shrink**i  # of the unknowns' size
        row = [(f(step) - f(-step)) / (2 * step)]
        for j, older in enumerate(previous):
            factor = shrink ** (2 * (j + 1))
            row.append((factor * row[j] - older) / (factor - 1))
            change = max(abs(row[-1] - row[j]), abs(row[-1] - older))
            if change < best_change:
                best, best_change = row[-1], change
        previous = row
    return best
