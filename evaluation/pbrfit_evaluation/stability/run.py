"""The sections of the stability suite, and one of them measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from threadpoolctl import threadpool_limits

from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability import bands, branches, objective, stiff_fits, tiny
from pbrfit_evaluation.stability.measure import Effort

Measure = Callable[[Effort, Generator, int], Values]


def sections() -> dict[str, Measure]:
    """What measures each section, by name, in the order of their seeds."""
    return {
        "band weights": bands.measure,
        "fast objective": objective.kernel,
        "branch points": branches.measure,
        "cancellation": objective.cancellation,
        "accumulated error": objective.accumulation,
        "tiny numbers": tiny.measure,
        "determinism": objective.determinism,
        "stiff fits": stiff_fits.measure,
    }


@dataclass(frozen=True)
class Task:
    """One section; each draws its own pixels, lights and pictures, whatever the others do."""

    section: str
    effort: Effort
    seed: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return self.section.replace(" ", "-")


def run(task: Task, threads: int) -> Values:
    """Measure one section."""
    measures = sections()
    rng = np.random.default_rng([task.seed, 1 + list(measures).index(task.section)])
    # Small matrices: more BLAS threads only get into each other's way, and change the last bits.
    with threadpool_limits(1):
        return measures[task.section](task.effort, rng, threads)
