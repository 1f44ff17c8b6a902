"""Numerical stability of the core: measurements against exact or float64 references.

Each function measures one thing and returns a frozen dataclass: its checks, which state a worst
figure and its bound, and the curves that a report may draw. Nothing here draws or writes.

The bounds on the fast objective hold for float32 arithmetic in any order with sums in blocks of up
to about a thousand terms and float64 beyond. They name nothing of how it is done.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from threadpoolctl import threadpool_limits

from pbrfit_evaluation.stability.accumulation import Accumulation, measure_accumulation
from pbrfit_evaluation.stability.bands import BandErrors, measure_bands
from pbrfit_evaluation.stability.branches import BranchPoints, measure_branches
from pbrfit_evaluation.stability.cancellation import Cancellation, measure_cancellation
from pbrfit_evaluation.stability.checks import Check
from pbrfit_evaluation.stability.determinism import Determinism, measure_determinism
from pbrfit_evaluation.stability.effort import FULL, QUICK, Effort
from pbrfit_evaluation.stability.kernel import KernelErrors, measure_kernel
from pbrfit_evaluation.stability.stiff_fits import StiffFits, measure_stiff_fits
from pbrfit_evaluation.stability.tiny import TinyNumbers, measure_tiny

__all__ = ["FULL", "QUICK", "SECTIONS", "Check", "Effort", "Stability", "measure"]


@dataclass(frozen=True, eq=False)
class Stability:
    """All measurements."""

    effort: Effort
    seed: int
    bands: BandErrors
    kernel: KernelErrors
    branches: BranchPoints
    cancellation: Cancellation
    accumulation: Accumulation
    tiny: TinyNumbers
    determinism: Determinism
    fits: StiffFits

    @property
    def by_section(self) -> tuple[tuple[Check, ...], ...]:
        """Checks, in the order of `SECTIONS`."""
        return (
            self.bands.checks,
            self.kernel.checks,
            self.branches.checks,
            self.cancellation.checks,
            self.accumulation.checks,
            self.tiny.checks,
            self.determinism.checks,
            self.fits.checks,
        )

    @property
    def checks(self) -> tuple[Check, ...]:
        """Those of all sections."""
        return tuple(check for checks in self.by_section for check in checks)

    @property
    def passed(self) -> bool:
        """Whether every bound holds."""
        return all(check.passed for check in self.checks)


def measure(
    effort: Effort,
    *,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Stability:
    """Measure everything.

    Parameters
    ----------
    effort
        `FULL` or `QUICK`.
    seed
        Of pixels, lights and pictures; each section draws its own, whatever the others do.
    threads
        Of the fast objective, 0 = one for each processor.
    progress
        Called with the name of each section before it starts.
    """

    def begin(number: int, name: str) -> Generator:
        progress(name)
        return np.random.default_rng([seed, number])

    # Small matrices: more BLAS threads only get into each other's way, and change the last bits.
    with threadpool_limits(1):
        begin(1, SECTIONS[0])
        bands = measure_bands(effort)
        kernel = measure_kernel(effort, begin(2, SECTIONS[1]), threads)
        branches = measure_branches(effort, begin(3, SECTIONS[2]), threads)
        cancellation = measure_cancellation(effort, begin(4, SECTIONS[3]), threads)
        accumulation = measure_accumulation(effort, begin(5, SECTIONS[4]), threads)
        tiny = measure_tiny(effort, begin(6, SECTIONS[5]), threads)
        determinism = measure_determinism(effort, begin(7, SECTIONS[6]))
        begin(8, SECTIONS[7])
        fits = measure_stiff_fits(effort, threads)
    return Stability(
        effort,
        seed,
        bands,
        kernel,
        branches,
        cancellation,
        accumulation,
        tiny,
        determinism,
        fits,
    )


SECTIONS = (
    "band weights",
    "fast objective",
    "branch points",
    "cancellation",
    "accumulated error",
    "tiny numbers",
    "determinism",
    "stiff fits",
)
