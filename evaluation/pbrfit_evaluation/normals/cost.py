"""Part "cost": seconds with and without refinement, one fit at a time, in turns.

"refined" is a scene whose normals are off, where the work is done; "declined" is one whose normals
are true, where only the decision costs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from pbrfit.result.refinement import RefineNormals
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normals.disturbances import disturbed
from pbrfit_evaluation.normals.fits import NOISE, fit, room

DEGREES = 10.0
TIMES, EXPONENT = 4.0, 1.1
"""Seconds over those without refinement, and the exponent with which they grow with the pixels, at
most; one much above 1 would not be linear."""

REHEARSAL_SIZE = 12

Case = Literal["refined", "declined"]
CASES: tuple[Case, ...] = get_args(Case)

COMPARED: dict[Case, RefineNormals] = {"refined": "on", "declined": "auto"}
"""With which option the seconds of "off" are compared."""


@dataclass(frozen=True)
class Task:
    """A furnished room, fitted `repeats` times by turns without and with refinement."""

    case: Case
    seed: int
    size: int
    repeats: int
    iterations: int

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"cost_{self.case}_{self.size}_{self.seed}"


def run(task: Task, threads: int) -> dict[str, Any]:
    """Seconds of every fit, after small ones that load libraries and wake threads."""
    refines: tuple[RefineNormals, RefineNormals] = ("off", COMPARED[task.case])
    rehearsal = replace(task, size=REHEARSAL_SIZE)
    for refine in refines:
        fit(_given(rehearsal), refine, iterations=5, threads=threads)
    scene = _given(task)
    seconds: dict[str, list[float]] = {refine: [] for refine in refines}
    refined = False
    for _ in range(task.repeats):
        for refine in refines:
            result = fit(scene, refine, iterations=task.iterations, threads=threads)
            seconds[refine].append(result.seconds)
            refined |= result.refinement.refined
    return {
        "without": seconds["off"],
        "with": seconds[COMPARED[task.case]],
        "refined": refined,
        "pixels": int(np.count_nonzero(scene.valid)),
        "threads": threads,
    }


def _given(task: Task) -> Scene:
    scene = room("furnished", task.seed, task.size, noise=NOISE, held_out=1)
    if task.case == "declined":
        return scene
    return replace(scene, normals=disturbed(scene, "correlated", DEGREES, task.seed))


def medians(values: Mapping[str, Any]) -> tuple[float, float]:
    """Seconds without and with refinement."""
    return float(np.median(values["without"])), float(np.median(values["with"]))


def exponent(pixels: Sequence[float], seconds: Sequence[float]) -> float:
    """Of seconds = c · pixels^k the k, by least squares of logarithms; NaN of fewer than two."""
    if len(set(pixels)) < 2:
        return float("nan")
    return float(np.polyfit(np.log(pixels), np.log(seconds), 1)[0])
