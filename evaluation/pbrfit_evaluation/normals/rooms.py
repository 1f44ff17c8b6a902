"""Part "rooms": errors against the size of the disturbance, with and without refinement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from pbrfit_evaluation.normals.disturbances import Disturbance, disturbed
from pbrfit_evaluation.normals.fits import NOISE, REFINE, Off, decision, fit, room, room_kind
from pbrfit_evaluation.scores import score

METRICS = ("recon", "albedo", "roughness", "metallic", "relight")
MAPS_AND_RELIGHT = ("albedo", "roughness", "metallic", "relight")

TRUE: Literal["true"] = "true"
"""In place of a disturbance: normals are the true ones."""


@dataclass(frozen=True)
class Task:
    """A scene under one disturbance, fitted without and with refinement, and as is decided."""

    scene: str
    seed: int
    size: int
    disturbance: Disturbance | Literal["true"]
    degrees: float
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"rooms_{self.disturbance}_{self.degrees:g}_{self.scene}_{self.seed}"


def plan(
    scenes: int,
    size: int,
    iterations: int,
    first_seed: int,
    disturbances: Sequence[Disturbance],
    degrees: Sequence[float],
) -> list[Task]:
    """Every scene with true normals, and under every disturbance at every θ above 0."""
    cases: list[tuple[Disturbance | Literal["true"], float]] = [(TRUE, 0.0)]
    cases += [(kind, theta) for kind in disturbances for theta in degrees if theta > 0]
    return [
        Task(room_kind(i), first_seed + i, size, kind, theta, iterations)
        for i in range(scenes)
        for kind, theta in cases
    ]


def work(task: Task, threads: int) -> dict[str, Any]:
    """Scores, angles and decision of each fit."""
    scene = room(task.scene, task.seed, task.size, noise=NOISE)
    given = scene
    if task.disturbance != "true":
        normals = disturbed(scene, task.disturbance, task.degrees, task.seed)
        given = replace(scene, normals=normals)
    found: dict[str, Any] = {"given": Off.of(given.normals, scene.normals, scene.valid).as_json()}
    for refine in REFINE:
        if refine == "on" and found["auto"]["decision"]["refined"]:
            found[refine] = found["auto"]  # the same fit, but for the time before it
            continue
        result = fit(given, refine, iterations=task.iterations, threads=threads)
        found[refine] = {
            "scores": score(result, scene, threads).as_json(),
            "angle": Off.of(result.normals, scene.normals, scene.valid).as_json(),
            "decision": decision(result),
        }
    return found
