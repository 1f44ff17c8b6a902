"""One scene of one row: rendered, explained in one way, compared with the ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pbrfit.model.lamps import Lamps
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import World, draw, make_scene
from pbrfit_evaluation import cycles, grid
from pbrfit_evaluation.grid import Grid, measured
from pbrfit_evaluation.normal_errors import estimated
from pbrfit_evaluation.recipes import OTHER
from pbrfit_evaluation.rooms.textures import MaterialSet, load_textures
from pbrfit_evaluation.suite import Options
from pbrfit_evaluation.table1.rows import BY_KEY, WAYS, Row

TRUE_FOV = 60.0


def why_not(options: Options, key: str, _: str) -> str:
    """Why a row cannot be run; empty if it can."""
    if options.quick and BY_KEY[key].slow:
        return "--quick leaves out what takes minutes"
    return (cycles.why_not() or "") if BY_KEY[key].renderer == "cycles" else ""


def sized(options: Options, key: str) -> tuple[int, int]:
    """Scenes of a row, and the side of their pictures."""
    row = BY_KEY[key]
    scenes = min(options.scenes, options.slow_scenes) if row.slow else options.scenes
    return scenes, options.size * row.enlarged


GRID = Grid(
    {key: row.name for key, row in BY_KEY.items()},
    WAYS,
    of_condition={key: row.ways for key, row in BY_KEY.items()},
    pictured=("default",),
    why_not=why_not,
    sized=sized,
)


@dataclass(frozen=True)
class Case(grid.Case):
    """A scene of a row, in one way."""

    textures: Path | None = None
    """Folder of PBR maps for detailed scenes; None = procedural."""
    inputs: str = ""
    """Digest of these."""


def run(case: Case, threads: int) -> dict[str, Any]:
    """Scores, and perhaps maps."""
    row = BY_KEY[case.condition]
    scene = as_given(room(case, threads), case)
    options: dict[str, Any] = {"sh_order": row.sh_order, "refine_normals": row.refine_normals}
    return measured(case, WAYS[case.way], scene, threads, **options)[1]


def room(case: Case, threads: int) -> Scene:
    """The scene of a case with all that is true of it but its depth: the paper has none."""
    row = BY_KEY[case.condition]
    if row.renderer == "cycles":
        return replace(cycles_scene(case, row, threads), depth=None)
    assert case.model is not None
    return make_scene(
        row.scene,
        size=case.size,
        lights=case.lights,
        held_out=case.lights,
        seed=case.seed,
        model=OTHER[case.model] if row.swapped else case.model,
        textures=_textures(case.textures),
    )


def cycles_scene(case: grid.Case, row: Row, threads: int) -> Scene:
    """Render a row's scene by Cycles, with its depth; the world is `make_scene`'s of this seed."""
    return cycles.render_scene(
        _world(case, row),
        case.size,
        TRUE_FOV,
        light=row.light,
        transport=row.transport,
        lights=case.lights,
        held_out=case.lights,
        seed=case.seed,
        threads=threads,
    )


def cycles_lamps(case: grid.Case, row: Row) -> Lamps:
    """The lamps of `cycles_scene` where the row has point lights, camera space, metres."""
    world = _world(case, row)
    return cycles.true_lamps(world, case.size, TRUE_FOV, lights=case.lights, seed=case.seed)


def _world(case: grid.Case, row: Row) -> World:
    [stream] = np.random.SeedSequence(case.seed).spawn(1)
    textures = _textures(getattr(case, "textures", None))
    return draw(row.scene, np.random.default_rng(stream), textures)


@cache
def _textures(folder: Path | None) -> tuple[MaterialSet, ...] | None:
    """Read maps once a process: it takes seconds."""
    return None if folder is None else tuple(load_textures(folder))


def as_given(scene: Scene, case: Case) -> Scene:
    """What the decomposition is given, which may be wrong."""
    row = BY_KEY[case.condition]
    if row.normals == "predicted":
        scene = replace(scene, normals=estimated(scene, case.seed))
    return scene if row.fov == scene.fov else replace(scene, fov=row.fov)
