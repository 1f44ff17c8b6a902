"""A room of a case, fitted with every set of priors, and a sheet of what they do to its maps."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pbrfit.model.reflection import Model, chosen_model, render
from pbrfit.result import metrics
from pbrfit.result.result import Result
from pbrfit.result.sheet import displayed
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.ablation.cases import CaseName, case
from pbrfit_evaluation.ablation.configurations import FEW, Configuration
from pbrfit_evaluation.panels import in_lines, of_maps
from pbrfit_evaluation.recipes import fit_and_score


@dataclass(frozen=True)
class RoomTask:
    """A room of a case, fitted in all configurations. `picture`: whether to draw a sheet."""

    case: CaseName
    seed: int
    size: int
    iterations: int
    configurations: tuple[Configuration, ...]
    picture: bool
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.case}_{self.seed}"


def room(task: RoomTask, threads: int) -> dict[str, Any]:
    """Scores of every configuration, and perhaps a sheet of maps."""
    scene = case(task.case, task.seed, size=task.size, model=task.model)
    scores, shown = {}, {}
    for one in task.configurations:
        result, scores[one.key] = fit_and_score(
            scene,
            threads,
            iterations=task.iterations,
            solver=one.solver,
            priors=one.priors,
        )
        if one in FEW:
            shown[one.title] = result
    if not task.picture:
        return {"scores": scores}
    return {
        "scores": scores,
        "sheet": base64.b64encode(room_sheet(scene, shown)).decode("ascii"),
    }


def room_sheet(scene: Scene, fitted: Mapping[str, Result]) -> bytes:
    """PNG: maps of a scene with ground truth and of each result, relit; and a picture of it.

    Relit pictures have the first held-out light.
    """
    truth = scene.truth
    assert truth is not None
    assert truth.relight_lighting is not None
    found = {"true": (truth.materials, chosen_model(None, scene.model))}
    found |= {name: (fit.materials, fit.model) for name, fit in fitted.items()}
    lines, white, light = {}, 0.0, truth.relight_lighting[0]
    for name, (maps, model) in found.items():
        relit = render(maps, scene.normals, light, scene.fov, model=model)
        white = white or metrics.white_of(relit)
        lines[name] = of_maps(maps) | {"relit": displayed(relit, white)}
    picture = scene.images[0]
    lines["true"]["picture, with noise"] = displayed(picture, metrics.white_of(picture))
    return in_lines(lines)
