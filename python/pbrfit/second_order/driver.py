"""The stages in order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pbrfit.objective import Objective
from pbrfit.second_order import subsample
from pbrfit.second_order.pixels import fitted, put, taken
from pbrfit.second_order.polish import polished

Array = NDArray[np.float64]

SUBSAMPLE = 256
"""Pixels that find the lights of 16 pictures. On twelve rooms of 128² without noise 256 found all,
128 ten, and joint steps cost half as much as with 512."""

LIGHT_SHARE = 3
"""Unknowns of the lights that there are at most for each pixel of the subsample. A pixel of N pictures
and three channels knows 3N − 5 numbers about them."""


class Watch(Protocol):
    """Who is told of progress, and says when to stop."""

    def stop(self) -> bool:
        """Whether time is up."""

    def visit_few(self, pixels: NDArray[np.uint64], materials: Array, lights: Array, share: float) -> bool:
        """A joint step of some pixels is done; whether to stop.

        `materials` (Q, D), `lights` as in x, and the mean weighted square that is left of them.
        """

    def visit(self, x: Array, squares: Array) -> bool:
        """All pixels have new materials, which leave them with `squares` (P,); whether to stop."""


@dataclass(frozen=True, eq=False)
class Fit:
    """x, the pixels' weighted squares (P,) there, and what was done, in words."""

    x: Array
    squares: Array
    note: str


def minimize(objective: Objective, x: Array, watch: Watch, seed: int) -> Fit | None:
    """Squares of the data, as low as they get from x; penalties take no part.

    Returns None where time ran out before all pixels had been given lights.
    """
    # One BLAS thread: sums split over threads would round differently on a machine with another
    # number of processors.
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        note = "lights known"
        if objective.lighting is not None:
            x, note = _lit(objective, x, watch, seed)
        found = fitted(objective, x, starts=1, stop=watch.stop)
        if found is None:
            return None
        x, squares = found
        stop = watch.visit(x, squares)
        if objective.lighting is not None and not stop:
            x, squares = polished(objective, x, squares, watch.visit, watch.stop)
    return Fit(x, squares, note)


def _lit(objective: Objective, x: Array, watch: Watch, seed: int) -> tuple[Array, str]:
    """X with lights found on a few pixels, and with their materials."""
    layout = objective.layout
    lights = layout.light_channels * layout.pictures * layout.coefficients
    count = min(objective.pixels, max(SUBSAMPLE, lights // LIGHT_SHARE))
    chosen = np.sort(np.random.default_rng(seed).permutation(objective.pixels)[:count])
    chosen = chosen.astype(np.uint64)
    few = objective.restricted(chosen)
    everything = slice(None)

    def visit(of_few: Array, total: float) -> bool:
        return watch.visit_few(
            chosen,
            taken(few, of_few, everything),
            of_few[few.layout.lighting],
            total / few.total_weight,
        )

    of_few, _ = subsample.minimize(few, objective.part_of(x, chosen), visit)
    x = put(objective, x, chosen, taken(few, of_few, everything))
    x[layout.lighting] = of_few[few.layout.lighting]
    return x, f"lights from {count} pixels"
