"""Part "priors": what the default priors do to `auto`, in the ablation's cases with noise of 0.01.

The ablation compares many sets of priors by whichever solver is the default, and holds the default
priors to other limits. Here it is `auto` with them and without, and the limits are narrower.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pbrfit_evaluation.ablation import FIRST_SEED
from pbrfit_evaluation.ablation.cases import CaseName, case
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.solvers.fits import AUTO, clean_residual, fit

CASES: tuple[CaseName, ...] = ("constant", "shifted", "merged", "none", "varying")

ROUGHNESS: Mapping[CaseName, float] = {
    "constant": 0.5,
    "shifted": 0.5,
    "merged": 0.5,
    "none": 0.5,
    "varying": 0.8,
}
"""Largest ratio of the roughness RMSE to that without priors."""

METRICS = ("clean", "albedo", "metallic", "relight")
"""What must be no worse. "clean" is the reconstruction against the pictures without their noise: a
prior can only raise the residual of those with it, which nothing else was fitted to."""


@dataclass(frozen=True)
class Task:
    """A room of a case."""

    case: CaseName
    seed: int
    size: int
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"priors_{self.case}_{self.seed}"


def plan(scenes: int, size: int, iterations: int) -> list[Task]:
    """Rooms of every case, of the ablation's seeds."""
    return [Task(name, FIRST_SEED + i, size, iterations) for i in range(scenes) for name in CASES]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Scores of both fits."""
    scene = case(task.case, task.seed, size=task.size)
    common: dict[str, Any] = {"iterations": task.iterations, "threads": threads}
    results = {
        "none": fit(scene, AUTO, priors=None, **common),
        "default": fit(scene, AUTO, **common),
    }
    return {
        name: score(result, scene, threads).as_json()
        | {"clean": clean_residual(scene, result, threads)}
        for name, result in results.items()
    }
