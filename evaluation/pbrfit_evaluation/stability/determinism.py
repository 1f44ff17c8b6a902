"""Every bit at any number of threads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit_evaluation.stability.checks import Array, Check
from pbrfit_evaluation.stability.double_precision import Case
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.extreme_pixels import random_lights, random_pixels, random_targets


@dataclass(frozen=True, eq=False)
class Determinism:
    """Differences between evaluations of one problem."""

    checks: tuple[Check, ...]
    evaluations: int


THREADS = (1, 2, 3, 8)
REPEATS = 3


def measure_determinism(effort: Effort, rng: Generator) -> Determinism:
    """Every bit of loss and gradient at different numbers of threads, and again and again."""
    between_threads = between_calls = evaluations = 0
    sizes = []
    for count, pictures in effort.repeated:
        case = Case(
            random_pixels(rng, count),
            random_lights(rng, pictures),
            random_targets(rng, pictures, count),
        )
        first = _bits(case.problem(THREADS[0]), case.x)
        for threads in THREADS:
            problem = case.problem(threads)
            calls = [_bits(problem, case.x) for _ in range(REPEATS)]
            evaluations += len(calls)
            between_threads += int(np.count_nonzero(calls[0] != first))
            between_calls += sum(int(np.count_nonzero(bits != calls[0])) for bits in calls[1:])
        sizes.append(f"{count} × {pictures}")
    where = "pixels × pictures: " + ", ".join(sizes)
    checks = (
        Check(
            "differs_between_threads",
            f"numbers that differ between {', '.join(map(str, THREADS))} threads",
            between_threads,
            0,
            "Sums are taken in an order that does not depend on the threads, to the last bit.",
            where,
        ),
        Check(
            "differs_between_calls",
            f"numbers that differ between {REPEATS} calls",
            between_calls,
            0,
            "An evaluation depends on its input alone.",
            where,
        ),
    )
    return Determinism(checks, evaluations)


def _bits(problem: _core.Problem, x: Array) -> NDArray[np.uint64]:
    loss, gradient = problem.value_and_grad(x)
    return np.concatenate([[loss], gradient]).view(np.uint64)
