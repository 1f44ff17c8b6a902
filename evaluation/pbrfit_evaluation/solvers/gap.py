"""Part "gap": the rows of table1 whose pictures the model cannot explain, `auto` as it is.

A lower loss can mean worse materials there. The paper's recipe, L-BFGS-B in one stage without
priors, is what all columns are compared with.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pbrfit_evaluation.recipes import explain
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.solvers.fits import AUTO, FIRST_SEED, PICTURES, fit
from pbrfit_evaluation.table1 import measure
from pbrfit_evaluation.table1.rows import BY_KEY

ROWS = ("sh2", "fov90", "normals")
CYCLES_ROWS = (
    "cycles-brdf",
    "cycles-shadows",
    "cycles-panorama",
    "cycles-points",
    "cycles-detailed",
)

WORST_COLUMN = 1.25


@dataclass(frozen=True)
class Task:
    """A scene of a row of table1."""

    of_table1: measure.Task

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"gap_{self.of_table1.key}"


def plan(
    scenes: int, cycles_scenes: int, size: int, iterations: int, cache: Path | None
) -> list[Task]:
    """Scenes of the rows; those of Cycles where it is at hand."""
    counts = dict.fromkeys(ROWS, scenes)
    if cycles_scenes and not why_no_cycles():
        counts |= dict.fromkeys(CYCLES_ROWS, min(scenes, cycles_scenes))
    return [
        Task(measure.Task(row, FIRST_SEED + i, size, PICTURES, iterations, cycles_cache=cache))
        for row, count in counts.items()
        for i in range(count)
    ]


def why_no_cycles() -> str | None:
    """Why rows of Cycles cannot be rendered here; None if they can."""
    from pbrfit_evaluation import cycles

    return cycles.why_not()


def work(task: Task, threads: int) -> dict[str, Any]:
    """Scores of both."""
    told = task.of_table1
    row = BY_KEY[told.row]
    scene, facts = measure.given(told, threads)
    common: dict[str, Any] = {
        "iterations": told.iterations,
        "sh_order": row.sh_order,
        "threads": threads,
    }
    ours = fit(scene, AUTO, **common)
    paper = explain(scene, "paper", **common)
    return {
        "facts": facts,
        "auto": score(ours, scene, threads).as_json(),
        "paper": score(paper, scene, threads).as_json(),
        "stop_reason": ours.stop_reason,
        "stages": [str(stage) for stage in getattr(ours, "stages", ())],
    }
