"""Part "noise": how low the objective gets where pictures have noise, and what maps come of it.

The lower of two fits is the mark: L-BFGS-B's, and that of Gauss-Newton from the truth, which no
search for a start can be blamed for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pbrfit_evaluation.scores import score
from pbrfit_evaluation.solvers.fits import (
    AUTO,
    FIRST_SEED,
    GAUSS_NEWTON,
    LBFGSB,
    fit,
    objective_value,
    room,
)

LEVELS = (0.004, 0.01)
"""Standard deviations of the noise, in radiance: 1 % of the mean radiance of 0.4, as in the
convergence suite, and 1 % of a radiance of 1, as in the ablation."""

METRICS = ("albedo", "albedo_scaled", "roughness", "metallic", "relight")
OBJECTIVE_SLACK = 1e-3
METRIC_RATIO = 1.02

PLAIN = (
    "gauss-newton from the truth",
    "gauss-newton",
    "auto",
    "lbfgsb",
)
WITH_PRIORS = ("auto, priors", "lbfgsb, priors")


@dataclass(frozen=True)
class Task:
    """A room with noise."""

    seed: int
    size: int
    noise: float
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"noise_{1e3 * self.noise:g}_{self.seed}"


def plan(scenes: int, size: int, iterations: int) -> list[Task]:
    """Rooms at both levels of noise."""
    return [
        Task(FIRST_SEED + i, size, noise, iterations) for i in range(scenes) for noise in LEVELS
    ]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Objective (data term, float64) and scores of each fit."""
    scene = room(task.seed, task.size, noise=task.noise)
    truth = scene.truth
    assert truth is not None
    common: dict[str, Any] = {"iterations": task.iterations, "threads": threads}
    plain = common | {"priors": None}
    from_truth = {"start": (truth.materials, truth.lighting)}
    results = {
        "gauss-newton from the truth": fit(scene, GAUSS_NEWTON, **plain, **from_truth),
        "gauss-newton": fit(scene, GAUSS_NEWTON, **plain),
        "auto": fit(scene, AUTO, **plain),
        "lbfgsb": fit(scene, LBFGSB, **plain),
        "auto, priors": fit(scene, AUTO, **common),
        "lbfgsb, priors": fit(scene, LBFGSB, **common),
    }
    return {
        name: {
            "objective": objective_value(scene, result, threads=threads),
            "scores": score(result, scene, threads).as_json(),
            "stop_reason": result.stop_reason,
        }
        for name, result in results.items()
    }


def above_mark(values: Mapping[str, Any], name: str) -> float:
    """Objective of a fit over the mark, less 1."""
    mark = min(values[key]["objective"] for key in ("gauss-newton from the truth", "lbfgsb"))
    return float(values[name]["objective"] / mark - 1)
