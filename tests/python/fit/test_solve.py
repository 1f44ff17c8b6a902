"""Solvers on whole scenes: accuracy, starts, the trap at roughness 0."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit.fit.settings import TRAP_ROUGHNESS
from pbrfit.result.options import SOLVERS, Solver
from pbrfit.synthetic import make_scene
from scene_files import lights_of, truth_of

PLAIN: dict[str, Any] = {"priors": None, "light": "sh", "refine_normals": "off"}

every_solver = pytest.mark.parametrize("solver", SOLVERS)


def room(size: int, **options: Any) -> pbrfit.Scene:
    return make_scene("room", size=size, **options)


def test_a_noise_free_room_is_recovered_and_no_pixel_is_left_in_the_trap() -> None:
    """By the paper's recipe, all its iterations."""
    scene = room(40)
    result = pbrfit.decompose(scene, solver="lbfgsb", priors=None, refine_normals="off")
    assert scene.images.mean() == pytest.approx(0.4)
    assert result.status == pbrfit.Status.ITERATION_LIMIT
    assert len(result.history) - 1 == 500
    assert result.metrics["recon_rmse"] <= 2e-3
    # A constant guess of roughness and metallic is off by 0.22 and 0.36.
    assert result.metrics["roughness_rmse"] <= 0.1
    assert result.metrics["metallic_rmse"] <= 0.1
    assert result.metrics["albedo_scaled_rmse"] <= 0.05
    assert truth_of(scene).materials.roughness.min() > 0.15
    trapped = np.count_nonzero(result.roughness <= TRAP_ROUGHNESS)
    assert trapped <= 0.002 * result.roughness.size


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize(("solver", "noise"), [("lbfgsb", 0.01), ("gauss-newton", 0.0)])
def test_the_last_row_of_the_history_is_the_result(solver: Solver, noise: float) -> None:
    scene = room(24, lights=8, noise=noise)
    result = pbrfit.decompose(scene, solver=solver, iterations=150, **PLAIN)
    assert result.stages
    for name in ("albedo_rmse", "roughness_rmse", "metallic_rmse"):
        assert result.history[name][-1] == pytest.approx(result.metrics[name], rel=1e-9)
    # The history's is of pictures divided by the scene scale and rounded to float32.
    recon = result.metrics["recon_rmse"]
    assert result.history["recon_rmse"][-1] == pytest.approx(recon, rel=1e-3, abs=1e-7)


@every_solver
@pytest.mark.parametrize("kind", ["room", "spheres", "textured"])
def test_the_truth_stays_where_it_is(kind: Any, solver: Solver) -> None:
    scene = make_scene(kind, size=24, lights=6)
    known = truth_of(scene)
    start = known.materials, lights_of(scene)
    result = pbrfit.decompose(scene, solver=solver, start=start, iterations=20, priors=None)
    assert result.metrics["recon_rmse"] <= 1e-7 * np.sqrt(np.mean(np.square(scene.images)))
    for name in ("albedo_rmse", "roughness_rmse", "metallic_rmse"):
        assert result.metrics[name] <= 1e-6, name


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize(("solver", "noise"), [("lbfgsb", 0.0), ("gauss-newton", 0.01)])
def test_known_lights_are_kept_and_make_better_maps(solver: Solver, noise: float) -> None:
    scene = room(24, lights=6, noise=noise)
    known = dataclasses.replace(scene, lighting=truth_of(scene).lighting)
    free, fixed = (
        pbrfit.decompose(s, solver=solver, iterations=150, **PLAIN) for s in (scene, known)
    )
    np.testing.assert_array_equal(fixed.lighting, truth_of(scene).lighting)
    assert "lights and their gradient: known, so only materials were fitted" in fixed.left_out
    for name in ("albedo_rmse", "roughness_rmse", "metallic_rmse"):
        assert fixed.metrics[name] < free.metrics[name], name


def test_roughness_zero_is_a_stationary_point() -> None:
    """The reason for the solver's stages; if it ever fails, they can go."""
    scene = room(24, lights=6)
    objective = pbrfit.Objective(scene)
    x = objective.start()
    x[objective.roughness] = 0.0
    _, gradient = objective.value_and_grad(x)
    assert not gradient[objective.roughness].any()
    assert gradient.any()


@every_solver
@pytest.mark.parametrize("iterations", [0, 12])
@pytest.mark.parametrize("priors", [None, pbrfit.Priors()], ids=["alone", "priors"])
def test_no_more_iterations_than_asked_for(
    solver: Solver, iterations: int, priors: pbrfit.Priors | None
) -> None:
    seen: list[pbrfit.Progress] = []
    result = pbrfit.decompose(
        room(16, lights=3, noise=0.02),
        solver=solver,
        iterations=iterations,
        priors=priors,
        refine_normals="off",  # else as many again for each fit with other normals
        progress=seen.append,
    )
    if iterations == 0:  # of more Gauss-Newton may need less
        assert result.status == pbrfit.Status.ITERATION_LIMIT
    assert result.history.iterations <= iterations
    told = [progress.iteration for progress in seen]
    assert told == sorted(told)
    assert told[0] == 0
    assert told[-1] <= iterations
    assert {progress.iterations for progress in seen} == {iterations}
    # Whatever there was time for, it is no worse than the start.
    assert result.history["loss"][-1] <= result.history["loss"][0] or priors is not None
    start, end = result.history["recon_rmse"][[0, -1]]
    assert end <= start
    assert result.metrics["recon_rmse"] <= 1.001 * start


def hollow(scene: pbrfit.Scene) -> pbrfit.Truth:
    """A truth of which no albedo is known."""
    known = truth_of(scene)
    albedo = np.full_like(known.materials.albedo, np.nan)
    return dataclasses.replace(known, materials=dataclasses.replace(known.materials, albedo=albedo))


UNUSABLE: list[tuple[Callable[[pbrfit.Scene], dict[str, Any]], str]] = [
    *(
        (lambda _, name=name: {"names": ("first", name)}, "names: expected file names")
        for name in ("", ".hidden", "a/b", "..\\b", 7)
    ),
    (lambda _: {"names": ("a\udcff", "b")}, r"names: expected names in UTF-8, found 'a\\udcff'$"),
    *(
        (lambda _, name=name, found=found: {name: found}, f"{name}: expected {expected}, found ")
        for name, found, expected in (
            ("truth", 3, "Truth"),
            ("lamps", (), "Lamps"),
            ("assumed", None, "Mapping"),
            ("inputs", "abc", "Mapping"),
            ("file_noise", 1.5, "Sequence"),
            ("fov_known", np.zeros(2), "bool"),
            ("images", [[0], [0, 1]], "an array"),
            ("fov", 10**5000, "a number"),
        )
    ),
    (lambda scene: {"truth": hollow(scene)}, "truth: expected materials of some valid"),
    (lambda _: {"lighting": np.full((2, 16, 3), 1e60)}, "lighting: expected coefficients like"),
    (lambda s: {"images": np.zeros_like(s.images)}, "images: expected a positive mean radiance"),
]


@pytest.mark.parametrize(("changes", "message"), UNUSABLE)
def test_unusable_scenes_are_refused(
    changes: Callable[[pbrfit.Scene], dict[str, Any]], message: str
) -> None:
    scene = room(8, lights=2, held_out=1)
    with pytest.raises(pbrfit.InputError, match=f"^{message}"):
        pbrfit.decompose(dataclasses.replace(scene, **changes(scene)))


def test_a_start_must_cover_the_valid_pixels() -> None:
    scene = room(8, lights=2, held_out=1)
    maps = truth_of(scene).materials
    roughness = maps.roughness.copy()
    roughness[3, 3] = np.nan
    start = pbrfit.Materials(maps.albedo, roughness, maps.metallic)
    with pytest.raises(pbrfit.InputError, match=r"^roughness: expected finite"):
        pbrfit.decompose(scene, start=start)
    with pytest.raises(pbrfit.InputError, match=r"^lighting: expected finite coefficients"):
        pbrfit.decompose(scene, start=(maps, np.nan * lights_of(scene)))
