"""What is fitted: rooms whose ground truth is known, real pictures, and what the parts cost."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.penalties import penalties
from pbrfit.fit.robust import SCALES
from pbrfit.model.reflection import Model
from pbrfit.result.options import Priors, prior_names
from pbrfit_evaluation.ablation.cases import CaseName, case
from pbrfit_evaluation.ablation.configurations import FEW, WEIGHTS, Configuration
from pbrfit_evaluation.ablation.pictures import real_sheet, room_sheet
from pbrfit_evaluation.real.held_out import (
    explained_by,
    part,
    picture_scores,
    relative_error,
    split,
)
from pbrfit_evaluation.real.sources import Source, load
from pbrfit_evaluation.scores import score

REPEATS = 30
"""Calls whose median time counts."""

NOISE = 0.01
"""Scale of robust losses."""


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


@dataclass(frozen=True)
class RealTask:
    """A source, some pictures held out, fitted in all configurations; digest of its files."""

    source: Source
    max_size: int
    iterations: int
    configurations: tuple[Configuration, ...]
    digest: str
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"real_{self.source.name}"


@dataclass(frozen=True)
class CostTask:
    """What the parts cost on a picture of a size."""

    size: int
    iterations: int
    seed: int
    configurations: tuple[Configuration, ...]
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"cost_{self.size}"


def room(task: RoomTask, threads: int) -> dict[str, Any]:
    """Scores of every configuration, and perhaps a sheet of maps."""
    scene = case(task.case, task.seed, size=task.size, model=task.model)
    fitted = {
        one: one.fit(scene, iterations=task.iterations, threads=threads)
        for one in task.configurations
    }
    scores = {one.key: score(fit, scene, threads).as_json() for one, fit in fitted.items()}
    if not task.picture:
        return {"scores": scores}
    shown = {one.title: fit for one, fit in fitted.items() if one in FEW}
    return {"scores": scores, "sheet": _text(room_sheet(scene, shown))}


def real(task: RealTask, threads: int) -> dict[str, Any]:
    """Errors of held-out pictures, whose light alone is fitted, and a sheet of maps."""
    scene = load(task.source, task.max_size)
    which = split(len(scene.images))
    kept = part(scene, which.kept)
    found, shown = {}, {}
    for one in task.configurations:
        fit = one.fit(kept, iterations=task.iterations, threads=threads, model=task.model)
        rendered = explained_by(fit.materials, scene, which.held_out, threads, model=fit.model)
        of_pictures = picture_scores(scene, which.held_out, rendered)
        found[one.key] = {
            "error": relative_error(of_pictures),
            "psnr": float(np.mean([picture.psnr for picture in of_pictures])),
            "ssim": float(np.mean([picture.ssim for picture in of_pictures])),
            "recon": fit.metrics["recon_rmse"],
            "seconds": fit.seconds,
        }
        if one in FEW:
            shown[one.title] = (fit.materials, rendered[0])
    return {
        "kept": len(which.kept),
        "held_out": len(which.held_out),
        "found": found,
        "sheet": _text(real_sheet(scene, which, shown)),
    }


def cost(task: CostTask, threads: int) -> dict[str, Any]:
    """Time evaluations and fits of a "constant" room.

    Returns
    -------
    dict
        "parts": milliseconds of loss and gradient without priors; and what each penalty, and each
        robust loss instead of the square, takes beside that. Medians. The prior "material" is
        fitted as a fit runs, and shows in the time of whole fits. "fits": seconds, evaluations and
        iterations of each configuration.
    """
    scene = case("constant", task.seed, size=task.size, model=task.model)
    objective = Objective(scene, threads=threads, model=task.model)
    x, gradient = objective.start(), np.zeros(objective.size)
    data = _milliseconds(lambda: objective.problem.value_and_grad(x))
    parts = {"loss and gradient": data}
    for name in prior_names():
        if name != "material":
            priors = replace(Priors.none(), **{name: getattr(WEIGHTS, name)})
            [penalty] = penalties(objective.layout, priors)
            parts[name] = _milliseconds(partial(penalty.value_and_grad, x, gradient))
    for loss in SCALES:
        robust = _milliseconds(partial(objective.problem.value_and_grad, x, (loss, NOISE)))
        parts[f"{loss} loss"] = max(0.0, robust - data)
    fits = {}
    for one in task.configurations:
        fit = one.fit(scene, iterations=task.iterations, threads=threads)
        fits[one.key] = {
            "seconds": fit.seconds,
            "evaluations": fit.evaluations,
            "iterations": int(fit.history["iteration"][-1]),
        }
    return {"parts": parts, "fits": fits}


def _milliseconds(act: Callable[[], object]) -> float:
    """Median time of `REPEATS` calls, after one that is not counted."""
    act()
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        act()
        times.append(time.perf_counter() - began)
    return 1e3 * float(np.median(times))


def _text(png: bytes) -> str:
    return base64.b64encode(png).decode("ascii")
