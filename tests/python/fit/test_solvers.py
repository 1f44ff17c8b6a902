"""What the two solvers promise, side by side: exact where it can be, no worse where it cannot."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit import Objective, Result, Scene, decompose
from pbrfit.model import reflection as model
from pbrfit.result.options import SOLVERS, Solver
from pbrfit.synthetic import make_scene
from scene_files import lights_of, truth_of

pytestmark = pytest.mark.usefixtures("uncompared")

MAPS = ("albedo_rmse", "roughness_rmse", "metallic_rmse")

PLAIN: dict[str, Any] = {"priors": None, "light": "sh", "uncertainty": False}


@cache
def room(seed: int = 2000, size: int = 32, **options: Any) -> Scene:
    return make_scene("room", size=size, lights=16, seed=seed, held_out=2, **options)


def in_float64(scene: Scene) -> Scene:
    pictures = model.render(truth_of(scene).materials, scene.normals, lights_of(scene), scene.fov)
    return dataclasses.replace(scene, images=pictures)


def names_of(result: Result) -> list[str]:
    around = ("alignment", "model selection", "albedo scale", "uncertainty")
    return [stage.name for stage in result.stages if stage.name not in around]


def test_pictures_without_noise_are_explained_to_their_last_bit() -> None:
    scene = in_float64(room())
    scene = dataclasses.replace(scene, images=scene.images.astype(np.float32))
    result = decompose(scene, **PLAIN)
    assert result.status == pbrfit.Status.CONVERGED
    rms = np.sqrt(np.mean(np.square(scene.images, dtype=np.float64)))
    assert result.metrics["recon_rmse"] <= 3e-8 * rms
    assert max(result.metrics[name] for name in MAPS) <= 1e-6
    assert names_of(result) == ["lights", "all pixels"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2000, 2001])
def test_pictures_in_float64_are_explained_as_far_as_that_goes(seed: int) -> None:
    scene = in_float64(room(seed))
    result = decompose(scene, priors=None, uncertainty=False)
    assert result.metrics["recon_rmse"] <= 1e-12
    assert max(result.metrics[name] for name in MAPS) <= 1e-10


def test_known_lights_give_exact_materials() -> None:
    scene = in_float64(room())
    scene = dataclasses.replace(scene, lighting=truth_of(scene).lighting)
    result = decompose(scene, **PLAIN)
    assert max(result.metrics[name] for name in MAPS) <= 1e-10
    assert next(stage.note for stage in result.stages if stage.note).startswith("lights known")


@pytest.mark.parametrize("size", [16, pytest.param(32, marks=pytest.mark.slow)])
def test_gauss_newton_leaves_less_than_lbfgsb(size: int) -> None:
    """Of noise too: the paper's recipe is not at the bottom after its iterations."""
    scene = room(size=size, noise=0.01)
    by_squares, paper = (
        decompose(scene, solver=solver, **PLAIN) for solver in ("gauss-newton", "lbfgsb")
    )
    assert by_squares.history["loss"][-1] < paper.history["loss"][-1]
    assert by_squares.metrics["recon_rmse"] < paper.metrics["recon_rmse"]


def wrong_normals() -> Scene:
    """Turned by smooth fields of up to some 15 degrees."""
    scene = room(2002, 24)
    rows, columns = np.mgrid[:24, :24] / 24 * 2 * np.pi
    off = 0.2 * np.stack([np.sin(rows), np.cos(columns), np.zeros_like(rows)], axis=-1)
    normals = scene.normals + off
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return dataclasses.replace(scene, normals=normals)


CASES: dict[str, tuple[Callable[[], Scene], float]] = {
    "wrong field of view": (lambda: dataclasses.replace(room(2002, 24), fov=90.0), 1.03),
    "lights of order 2": (lambda: room(2002, 24), 1.03),
    "wrong normals": (wrong_normals, 1.03),
    "noise": (lambda: room(2002, 24, noise=0.01), 1 + 1e-6),
    "few pictures": (
        lambda: make_scene("room", size=24, lights=5, seed=5, noise=0.01, held_out=1),
        1 + 1e-6,
    ),
}
"""Scenes, and the largest loss of Gauss-Newton over that of L-BFGS-B."""


def objective_at(scene: Scene, result: Result, **options: Any) -> float:
    """The whole objective of a result."""
    maps = result.materials
    objective = Objective(scene, **options)
    x = objective.pack(maps.albedo, maps.roughness, maps.metallic, result.lighting)
    return objective.value_and_grad(np.clip(x, *objective.bounds.T))[0]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_gauss_newton_does_not_end_above_lbfgsb(case: str) -> None:
    """But where the model is wrong its prior on lights keeps it from lowering the loss further.

    There it may stay 3 % above, which is 1.5 % of the residual.
    """
    made, at_most = CASES[case]
    scene = made()
    options: dict[str, Any] = {"sh_order": 2} if case == "lights of order 2" else {}
    ours, paper = (
        objective_at(
            scene,
            decompose(
                scene,
                solver=solver,
                priors=None,
                uncertainty=False,
                robust="none",
                refine_normals="off",
                **options,
            ),
            **options,
        )
        for solver in SOLVERS
    )
    assert ours <= at_most * paper


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_ran_is_told(solver: Solver, tmp_path: Path) -> None:
    scene = room(2002, 16, noise=0.01).of_pictures([0, 1, 2])
    result = decompose(scene, solver=solver, iterations=20)
    assert result.options.solver == solver
    expected = {
        "lbfgsb": ["L-BFGS-B", "material prior", "L-BFGS-B with the material prior"],
        "gauss-newton": ["lights", "material prior", "all pixels"],
    }
    assert names_of(result) == expected[solver]
    assert all(stage.seconds >= 0 for stage in result.stages)
    assert 0.8 * result.seconds <= sum(stage.seconds for stage in result.stages) <= result.seconds
    result.save(tmp_path / "out")
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert content["stages"] == [dataclasses.asdict(stage) for stage in result.stages]
    assert Result.load(tmp_path / "out").stages == result.stages
