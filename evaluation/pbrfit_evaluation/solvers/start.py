"""Part "start": `auto` never ends above `lbfgsb` in what both minimise, whatever the scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from pbrfit.fit.objective import Objective
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene
from pbrfit.synthetic.scenes import ADDED_KINDS
from pbrfit.synthetic.scenes import KINDS as ALWAYS
from pbrfit_evaluation.recipes import PAPER_PRIORS
from pbrfit_evaluation.solvers.fits import AUTO, FIRST_SEED, LBFGSB, PICTURES, fit, objective_value

KINDS: tuple[str, ...] = (*ALWAYS, *ADDED_KINDS)
NOISE = (0.0, 0.01)

ROUNDING = 1e-6
"""Two fits are level if their objectives differ by no more than float32 sums can."""

Loss = Literal["none", "huber"]

SETTINGS: dict[str, tuple[Priors | None, Loss]] = {
    "plain": (None, "none"),
    "smoothness": (replace(Priors.none(), smoothness=PAPER_PRIORS.smoothness), "none"),
    "cohesion": (replace(Priors.none(), cohesion=PAPER_PRIORS.cohesion), "none"),
    "paper's priors": (PAPER_PRIORS, "none"),
    "huber": (None, "huber"),
}
"""Objectives that do not change while a fit runs, but for the scale of the robust loss."""


@dataclass(frozen=True)
class Task:
    """A scene, fitted by both solvers under every setting."""

    kind: str
    seed: int
    size: int
    noise: float
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"start_{self.kind}_{1e3 * self.noise:g}_{self.seed}"


def plan(scenes: int, size: int, iterations: int) -> list[Task]:
    """Scenes of every kind, with and without noise."""
    return [
        Task(kind, FIRST_SEED + i, size, noise, iterations)
        for i in range(scenes)
        for kind in KINDS
        for noise in NOISE
    ]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Objective of both solvers by setting.

    Each estimates the scale of a robust loss from its own residuals, so both are compared at that
    of the L-BFGS-B fit.
    """
    scene = make_scene(
        task.kind,
        size=task.size,
        lights=PICTURES,
        held_out=1,
        seed=task.seed,
        noise=task.noise,
    )
    found = {}
    for name, (priors, loss) in SETTINGS.items():
        options: dict[str, Any] = {
            "priors": priors,
            "robust": loss,
            "iterations": task.iterations,
            "threads": threads,
            "uncertainty": False,
        }
        reference, ours = (fit(scene, solver, **options) for solver in (LBFGSB, AUTO))
        robust = None
        if loss != "none":
            objective = Objective(scene, threads=threads, model=reference.model)
            maps = reference.materials
            x = objective.pack(maps.albedo, maps.roughness, maps.metallic, reference.lighting)
            robust = objective.robust_around(x, loss)
        values = {
            key: objective_value(scene, result, priors=priors, robust=robust, threads=threads)
            for key, result in (("lbfgsb", reference), ("auto", ours))
        }
        found[name] = values | {
            "seconds": {"lbfgsb": reference.seconds, "auto": ours.seconds},
            "stop_reason": ours.stop_reason,
        }
    return found
