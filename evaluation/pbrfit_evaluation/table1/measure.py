"""The rows of Table 1, which docs/table1.md describes: what each changes about the base.

A scene of a row is rendered, explained in one way, and compared with the ground truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pbrfit._core import InputError
from pbrfit.model.lamps import Lamps
from pbrfit.result.refinement import RefineNormals
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import World, draw
from pbrfit_evaluation import cycles, grid
from pbrfit_evaluation.arrays import known
from pbrfit_evaluation.estimator_errors import estimated_normals
from pbrfit_evaluation.grid import Grid, measured
from pbrfit_evaluation.jobs import digest_of_files
from pbrfit_evaluation.recipes import DEFAULT, GUESS, OTHER, PAPER, PAPER_REGULARIZED, Way
from pbrfit_evaluation.rooms.textures import MaterialSet, load_textures
from pbrfit_evaluation.suite import Options

COLUMNS = ("recon", "albedo", "roughness", "metallic", "relight")
"""What the paper reports."""

WAYS: Mapping[str, Way] = {
    "default": DEFAULT,
    "paper": PAPER,
    "paper-priors": PAPER_REGULARIZED,
    "constant": GUESS,
}

COMPARED = ("default", "paper", "constant")

REFINED = ("default",)
"""The paper's recipe and guesses cannot refine normals."""

REGULARIZED = ("default", "paper-priors", "constant")


@dataclass(frozen=True)
class Row:
    """One setup."""

    name: str
    """For people."""
    scene: Literal["furnished", "detailed"] = "furnished"
    """Kind of scene."""
    renderer: Literal["own", "cycles"] = "own"
    """Whose pictures: our forward model's, or Blender Cycles'."""
    light: Literal["panorama", "points"] = "panorama"
    transport: Literal["brdf", "shadows", "full"] = "full"
    """`light` and `transport`: of Cycles: see `pbrfit_evaluation.cycles.render_scene`."""
    normals: Literal["true", "predicted"] = "true"
    """The true ones, or those of a simulated estimator."""
    refine_normals: RefineNormals = "off"
    """As for `pbrfit.decompose`."""
    sh_order: int = 3
    """That the decomposition fits; the true lights have order 3."""
    fov: float = 60.0
    """That the decomposition is told, in degrees; the true one is 60."""
    swapped: bool = False
    """Whether our renderer uses the other model than the one that is fitted, instead of the same.
    """
    ways: tuple[str, ...] = COMPARED
    """Keys of the ways to explain its scenes."""
    enlarged: int = 1
    """Side of its pictures, over that of the others."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """The paper's RMSE, on the paper's scenes."""

    @property
    def slow(self) -> bool:
        """Whether a scene takes minutes, so that fewer are measured."""
        return self.renderer == "cycles" or self.refine_normals != "off" or self.enlarged > 1


def _paper(*errors: float) -> dict[str, float]:
    return dict(zip(COLUMNS, errors, strict=False))


ROWS: Mapping[str, Row] = {
    "base": Row("Base", paper=_paper(0.001, 0.065, 0.232, 0.186, 0.166)),
    "base-large": Row("Base, four times as wide and high", enlarged=4),
    "sh2": Row("SH2 decomposition", sh_order=2, paper=_paper(0.002, 0.064, 0.242, 0.147, 0.154)),
    "normals": Row(
        "Predicted normals",
        normals="predicted",
        paper=_paper(0.016, 0.160, 0.341, 0.446, 0.201),
    ),
    "normals-refined": Row(
        "Predicted normals, refined",
        normals="predicted",
        refine_normals="auto",
        ways=REFINED,
    ),
    "fov90": Row("FOV 90", fov=90.0, paper=_paper(0.004, 0.091, 0.283, 0.194, 0.143)),
    "other-model": Row("Pictures of the other model", swapped=True),
    "detailed": Row("Detailed scenes", scene="detailed"),
    "cycles-brdf": Row("Cycles, panorama: BRDF alone", renderer="cycles", transport="brdf"),
    "cycles-shadows": Row("Cycles, panorama: and shadows", renderer="cycles", transport="shadows"),
    "cycles-panorama": Row("Cycles, panorama", renderer="cycles"),
    "cycles-points-unshadowed": Row(
        "Cycles, point lights without shadows",
        renderer="cycles",
        light="points",
        transport="brdf",
    ),
    "cycles-points": Row(
        "Cycles, point lights",
        renderer="cycles",
        light="points",
        transport="shadows",
        paper=_paper(0.040, 0.386, 0.408, 0.630),
    ),
    "cycles-detailed": Row(
        "Detailed scenes, Cycles, panorama",
        scene="detailed",
        renderer="cycles",
        paper=_paper(0.043, 0.222, 0.334, 0.435, 0.210),
    ),
    "regularized": Row(
        "Regularised",
        ways=REGULARIZED,
        paper=_paper(0.010, 0.066, 0.241, 0.248, 0.160),
    ),
}
"""By key."""


TRUE_FOV = 60.0


def why_not(options: Options, key: str, _: str) -> str:
    """Why a row cannot be run; empty if it can."""
    if options.quick and ROWS[key].slow:
        return "--quick leaves out what takes minutes"
    return (cycles.why_not() or "") if ROWS[key].renderer == "cycles" else ""


def sized(options: Options, key: str) -> tuple[int, int]:
    """Scenes of a row, and the side of their pictures."""
    row = ROWS[key]
    scenes = min(options.scenes, options.slow_scenes) if row.slow else options.scenes
    return scenes, options.size * row.enlarged


GRID = Grid(
    {key: row.name for key, row in ROWS.items()},
    WAYS,
    of_condition={key: row.ways for key, row in ROWS.items()},
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
    row = ROWS[case.condition]
    scene = as_given(room(case, threads), case)
    options: dict[str, Any] = {"sh_order": row.sh_order, "refine_normals": row.refine_normals}
    return measured(case, WAYS[case.way], scene, threads, **options)[1]


def room(case: Case, threads: int) -> Scene:
    """The scene of a case with all that is true of it but its depth: the paper has none."""
    row = ROWS[case.condition]
    if row.renderer == "cycles":
        return replace(cycles_scene(case, row, threads), depth=None)
    model = OTHER[known(case.model)] if row.swapped else case.model
    textures = _textures(case.textures)
    return replace(case, kind=row.scene).drawn(model=model, textures=textures)


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
    row = ROWS[case.condition]
    if row.normals == "predicted":
        scene = replace(scene, normals=estimated_normals(scene, case.seed))
    return scene if row.fov == scene.fov else replace(scene, fov=row.fov)


MOST_SCENES = 100


def cases(options: Options) -> list[Case]:
    """The scenes of every row that can be run, for every model, those of a seed together.

    So a run that is broken off and resumed with fewer scenes is complete in those.

    Raises InputError if an option is out of range or a folder is not there.
    """
    if options.scenes > MOST_SCENES:
        raise InputError(f"--scenes: expected at most {MOST_SCENES}, found {options.scenes}")
    textures, digest = options.textures, ""
    if textures is not None:
        if not textures.is_dir():
            raise InputError(f"{textures}: expected a folder, found none")
        load_textures(textures)  # what is wrong with them should show before the work
        textures, digest = textures.resolve(), digest_of_files(textures)
    found = []
    for case in GRID.cases(options):
        detailed = ROWS[case.condition].scene == "detailed"
        inputs = {"textures": textures, "inputs": digest} if detailed else {}
        found.append(Case(**vars(case), **inputs))
    return sorted(found, key=lambda case: case.seed)
