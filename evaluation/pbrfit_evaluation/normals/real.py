"""Part "real": pictures of others whose normals are known, started from wrong ones.

The two bunnies come from another renderer under single lights; their normals are those of the mesh.
The brick sphere has the normals of a sphere. Highlights under single lights are beyond lights of
order 3, so the glossy bunny shows what refinement does where the model is wrong.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pbrfit.result.refinement import RefineNormals
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.normal_errors import Array
from pbrfit_evaluation.normals.disturbances import Disturbance, disturbed
from pbrfit_evaluation.normals.fits import REFINE, Off, decision, fit
from pbrfit_evaluation.normals.pictures import draw_panels
from pbrfit_evaluation.real.sources import Source, check_names, find_sources, load

KINDS = ("bunny_ps", "maxcrous_sphere_color")
"""Public sets with true normals (see `evaluation.real.public_sets`)."""

Start = Disturbance | Literal["true", "flat"]
"""Normals that a fit is given: disturbed; the true ones; or all +Z."""

SHOWN: RefineNormals = "on"
"""What pictures show."""


@dataclass(frozen=True)
class Task:
    """A set started from wrong normals. `digest` is of its files."""

    source: Source
    start: Start
    degrees: float
    max_size: int
    iterations: int
    digest: str

    @property
    def key(self) -> str:
        """Name of the record."""
        theta = f"_{self.degrees:g}" if self.degrees else ""
        return f"real_{self.source.name}_{self.start}{theta}"

    @property
    def in_words(self) -> str:
        """Where it starts."""
        return f"{self.start} {self.degrees:g}°" if self.degrees else self.start


def find(folders: Sequence[Path]) -> list[Source]:
    """Sets with true normals in folders of public sets.

    Raises
    ------
    FileNotFoundError, InputError
        As `evaluation.real.sources.find_sources`; or if two sets have one name.
    """
    every = [source for folder in folders for source in find_sources(folder)]
    found = [source for source in every if source.kind in KINDS]
    check_names(found)
    return found


def plan(
    sources: Sequence[Source],
    max_size: int,
    iterations: int,
    disturbances: Sequence[Disturbance],
    degrees: Sequence[float],
) -> list[Task]:
    """Every source from its true normals, from all wrong ones, and from flat ones."""
    starts: list[tuple[Start, float]] = [("true", 0.0)]
    starts += [(kind, theta) for kind in disturbances for theta in degrees]
    starts.append(("flat", 0.0))
    return [
        Task(source, start, theta, max_size, iterations, digest)
        for source in sources
        for digest in [source.digest()]
        for start, theta in starts
    ]


def work(task: Task, threads: int) -> Mapping[str, Any]:
    """Angles, residual and decision of each fit; pictures."""
    scene = load(task.source, task.max_size)
    valid = scene.valid
    normals = _given(scene, task)
    given = replace(scene, normals=normals)
    found: dict[str, Any] = {
        "pixels": int(np.count_nonzero(valid)),
        "pictures": len(scene.images),
        "given": Off.of(normals, scene.normals, valid).as_json(),
    }
    for refine in REFINE:
        result = fit(given, refine, iterations=task.iterations, threads=threads)
        found[refine] = {
            "angle": Off.of(result.normals, scene.normals, valid).as_json(),
            "recon": result.metrics["recon_rmse"],
            "seconds": result.seconds,
            "decision": decision(result),
        }
        if refine == SHOWN:
            panels = draw_panels(scene, normals, result.normals)
            found["panels"] = {
                name: base64.b64encode(png).decode("ascii") for name, png in panels.items()
            }
    return found


def _given(scene: Scene, task: Task) -> Array:
    match task.start:
        case "true":
            return np.asarray(scene.normals, dtype=np.float64)
        case "flat":
            return np.where(scene.valid[..., None], [0.0, 0.0, 1.0], np.nan)
        case kind:
            # One seed for all sets: they have other shapes and masks.
            return disturbed(scene, kind, task.degrees, 0)
