"""Part "real": pictures of others whose normals are known, started from wrong ones.

The two bunnies come from another renderer under single lights; their normals are those of the mesh.
The brick sphere has the normals of a sphere. Highlights under single lights are beyond lights of
order 3, so the glossy bunny shows what refinement does where the model is wrong.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pbrfit.result.refinement import RefineNormals
from pbrfit_evaluation.normal_errors import Array
from pbrfit_evaluation.normals.disturbances import Disturbance, disturbed
from pbrfit_evaluation.normals.fits import REFINE, decision, fit, off
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
        """Normals that it starts from."""
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


def run(task: Task, threads: int) -> dict[str, Any]:
    """Angles, residual and decision of each fit; pictures."""
    scene = load(task.source, task.max_size)
    valid = scene.valid
    normals: Array = np.asarray(scene.normals, dtype=np.float64)
    if task.start == "flat":
        normals = np.where(valid[..., None], [0.0, 0.0, 1.0], np.nan)
    elif task.start != "true":
        # One seed for all sets: they have other shapes and masks.
        normals = disturbed(scene, task.start, task.degrees, 0)
    given = replace(scene, normals=normals)
    found: dict[str, Any] = {
        "pixels": int(np.count_nonzero(valid)),
        "pictures": len(scene.images),
        "given": off(normals, scene.normals, valid),
    }
    for refine in REFINE:
        result = fit(given, refine, iterations=task.iterations, threads=threads)
        found[refine] = {
            "angle": off(result.normals, scene.normals, valid),
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
