"""One scene of one row: rendered, explained by every recipe, compared with the ground truth."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.normal_files import read_normals
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import DEFAULT_MODEL, Model
from pbrfit.scene.arrays import unit_normals
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import World, draw, make_scene
from pbrfit.synthetic.lights import condition
from pbrfit_evaluation import cycles
from pbrfit_evaluation.normal_errors import angle_errors
from pbrfit_evaluation.recipes import OTHER, explain
from pbrfit_evaluation.rooms.textures import MaterialSet, load_textures
from pbrfit_evaluation.scores import METAL, score
from pbrfit_evaluation.suite import Options
from pbrfit_evaluation.table1.normals import estimated
from pbrfit_evaluation.table1.rows import BY_KEY, Row

TRUE_FOV = 60.0

FIRST_SEED = 1000
"""Scenes are those of the seeds from here on. Seeds below 400 served to design scenes and simulated
normals and to tune the solver; none from 1000 on ever did."""


@dataclass(frozen=True)
class Task:
    """A scene of a row.

    Attributes
    ----------
    row
        Its key.
    seed
        Of the scene.
    size, lights
        Side of the pictures, and their number; as many are held out.
    iterations
        Of both fits.
    textures
        Folder of PBR maps for detailed scenes; None = procedural.
    predicted_normals
        Folder that holds SEED.exr or SEED.png by an estimator; None = simulated.
    model
        That is fitted; our renderer's pictures are of it too, unless the row says otherwise.
    inputs
        Digest of what is read from these two.
    preview
        Whether to keep a picture of our default's result.
    cycles_cache
        Where renders are kept.
    """

    row: str
    seed: int
    size: int
    lights: int
    iterations: int
    textures: Path | None = None
    predicted_normals: Path | None = None
    model: Model = DEFAULT_MODEL
    inputs: str = ""
    preview: bool = False
    cycles_cache: Path | None = field(default=None, repr=False)

    @property
    def key(self) -> str:
        """File name of the record."""
        return f"{self.row}_{self.model}_{self.seed}"


def work(task: Task, threads: int) -> dict[str, Any]:
    """Scores of the row's recipes, facts about the scene, and perhaps a preview."""
    row = BY_KEY[task.row]
    exact = _scene(task, row, threads)
    scene, facts = _as_given(exact, task, row)
    found: dict[str, Any] = {"facts": facts, "recipes": {}}
    for recipe in row.recipes:
        result = explain(
            scene,
            recipe,
            iterations=task.iterations,
            sh_order=row.sh_order,
            refine_normals=row.refine_normals,
            model=task.model,
            threads=threads,
        )
        found["recipes"][recipe] = score(result, scene, threads).as_json()
        if recipe == "default" and row.refine_normals != "off":
            facts |= _off("refined", result.normals, exact)
            facts["refined_scenes"] = float(result.refinement.refined)
        if recipe == "default" and task.preview:
            found["preview"] = _preview(result, scene)
    return found


def given(task: Task, threads: int) -> tuple[Scene, dict[str, float]]:
    """The task's scene as the decomposition is told of it, and facts about its truth."""
    row = BY_KEY[task.row]
    return _as_given(_scene(task, row, threads), task, row)


def _scene(task: Task, row: Row, threads: int) -> Scene:
    if row.renderer == "own":
        return make_scene(
            row.scene,
            size=task.size,
            lights=task.lights,
            held_out=task.lights,
            seed=task.seed,
            model=OTHER[task.model] if row.swapped else task.model,
            textures=_textures(task.textures),
        )
    return replace(cycles_scene(task, row, threads), depth=None)  # the paper has none


def cycles_scene(task: Task, row: Row, threads: int) -> Scene:
    """Render a row's scene by Cycles, with its depth; the world is `make_scene`'s of this seed."""
    return cycles.render_scene(
        _world(task, row),
        task.size,
        TRUE_FOV,
        light=row.light,
        transport=row.transport,
        lights=task.lights,
        held_out=task.lights,
        seed=task.seed,
        cache=task.cycles_cache,
        threads=threads,
    )


def cycles_lamps(task: Task, row: Row) -> Lamps:
    """The lamps of `cycles_scene` where the row has point lights, camera space, metres."""
    return cycles.true_lamps(
        _world(task, row), task.size, TRUE_FOV, lights=task.lights, seed=task.seed
    )


def _world(task: Task, row: Row) -> World:
    [stream] = np.random.SeedSequence(task.seed).spawn(1)
    return draw(row.scene, np.random.default_rng(stream), _textures(task.textures))


def why_not(row: Row, options: Options) -> str:
    """Why a row cannot be run; empty if it can."""
    if options.quick and row.slow:
        return "--quick leaves out what takes minutes"
    return (cycles.why_not() or "") if row.renderer == "cycles" else ""


@cache
def _textures(folder: Path | None) -> tuple[MaterialSet, ...] | None:
    """Read maps once a process: it takes seconds."""
    return None if folder is None else tuple(load_textures(folder))


def _as_given(scene: Scene, task: Task, row: Row) -> tuple[Scene, dict[str, float]]:
    """What the decomposition is told, which may be wrong; and facts about the truth."""
    truth = scene.truth
    assert truth is not None
    valid = scene.valid
    facts = {"metal_share": float(np.mean(truth.materials.metallic[valid] >= METAL))}
    if truth.lighting is not None:
        facts["condition"] = condition(truth.lighting)
    if row.normals == "predicted":
        normals = _predicted(scene, task)
        facts |= _off("normals", normals, scene)
        scene = replace(scene, normals=normals)
    if row.fov != scene.fov:
        scene = replace(scene, fov=row.fov)
    return scene, facts


def _off(name: str, normals: NDArray[np.float64], scene: Scene) -> dict[str, float]:
    """Angles of some normals to those of a scene, in degrees: mean and median."""
    off = angle_errors(normals[scene.valid], scene.normals[scene.valid])
    return {f"{name}_{of}": angle for of, angle in off.items()}


def predicted_files(folder: Path, seed: int) -> list[Path]:
    """Where the normals of a scene by an estimator may be."""
    return [folder / f"{seed}{suffix}" for suffix in (".exr", ".png")]


def _predicted(scene: Scene, task: Task) -> NDArray[np.float64]:
    folder = task.predicted_normals
    if folder is None:
        return estimated(scene, task.seed)
    paths = predicted_files(folder, task.seed)
    for path in paths:
        if path.exists():
            normals = read_normals(path).vectors
            if normals.shape != scene.normals.shape:
                height, width = normals.shape[:2]
                raise InputError(
                    f"{path}: expected {task.size} × {task.size} pixels, found {width} × {height}"
                )
            return unit_normals(normals, scene.valid)
    raise InputError(f"{folder}: expected {paths[0].name} or {paths[1].name}, found neither")


def _preview(result: Any, scene: Scene) -> str:
    from pbrfit.result.preview import preview
    from pbrfit.result.sheet import as_png

    return base64.b64encode(as_png(preview(result, scene))).decode("ascii")
