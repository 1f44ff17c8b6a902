"""The camera as a number that all pixels share: its derivatives and its estimate."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import Objective, Result, Scene, decompose
from pbrfit.fit import settings
from pbrfit.fit.joint import JointFit, SharedFit, minimize
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.misfit import Misfit
from pbrfit.fit.nuisances import Nuisances, degrees, log_tangent
from pbrfit.fit.pixels import fit_all
from pbrfit.io.json_files import read_as
from pbrfit.result.camera import Camera
from pbrfit.result.options import Response
from pbrfit.scene.correction import Correction
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from result_files import CONTRADICTED
from scene_files import known
from scene_kinds import at_truth

FAST: dict[str, Any] = {"uncertainty": False, "threads": 1, "light": "sh"}


def room(fov: float = 60.0, size: int = 32, seed: int = 1, noise: float = 0.01) -> Scene:
    return make_scene("room", size=size, lights=8, noise=noise, seed=seed, held_out=1, fov=fov)


def minimum(objective: Objective, x: Array, lights: LightPrior, rounds: int = 4) -> JointFit:
    """Where pixels and lights have settled; x changes."""
    shared = SharedFit(lights)
    for _ in range(rounds):
        sum_sq = known(fit_all(objective, x, starts=0))
        fit = JointFit(objective, x, sum_sq, shared)
        minimize(fit, 20, 1e-4)
    return fit


def test_gradient_and_curvature_are_those_of_refits(monkeypatch: pytest.MonkeyPatch) -> None:
    """With F the lowest sum for a θ: dF/dθ = 2 g, and d²F/dθ² = 2 H where residuals are small."""
    scene = room(size=16)
    objective = Objective(scene, threads=1)
    lights = LightPrior.around(objective, at_truth(objective, scene))
    lights = lights.weighing(1e-4, 1e-4, objective.pixels)
    x = at_truth(objective, scene)
    minimum(objective, x, lights)
    offset = 0.03
    scene = scene.through(degrees(log_tangent(scene.fov) + offset))
    objective.see(scene)
    fit = minimum(objective, x, lights)
    monkeypatch.setattr(settings, "LOG_FOCAL_LENGTH_SIGMA", 1e6)  # no prior
    nuisances = Nuisances(scene)
    nuisances.estimate(objective, x, fit, Misfit(1e-4))
    precision = 1e-4 / nuisances.covariance[0, 0]
    slope = -nuisances.step[0] * precision
    step, totals = 0.01, []
    for by in (-step, 0.0, step):
        other, moved = Objective(nuisances.moved(np.array([by])), threads=1), x.copy()
        ended = minimum(other, moved, lights)
        totals.append(ended.total(moved, ended.sum_sq, None))
    assert (totals[2] - totals[0]) / (4 * step) == pytest.approx(slope, rel=0.05)
    curvature = (totals[2] - 2 * totals[1] + totals[0]) / (2 * step**2)
    assert curvature == pytest.approx(precision, rel=0.25)


VIEWS = [(90.0, 1), (40.0, 2), (60.0, 3)]


@cache
def fitted(fov: float, seed: int, told: bool) -> Result:
    scene = room(fov, size=48, seed=seed)
    return decompose(scene if told else replace(scene, fov=60.0, fov_known=False), **FAST)


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize(
    ("fov", "seed"),
    [VIEWS[0], *(pytest.param(*view, marks=pytest.mark.slow) for view in VIEWS[1:])],
)
def test_a_field_of_view_that_nobody_told_is_found(fov: float, seed: int) -> None:
    found = fitted(fov, seed, told=False)
    assert found.camera is not None
    assert found.camera.how == "fitted"
    assert found.fov == found.camera.fov_degrees == pytest.approx(fov, abs=2.0)
    assert abs(found.fov - fov) < 4 * known(found.camera.fov_sigma) < 4
    assert found.assumed["fov"] == found.camera.in_words()
    assert found.assumed["fov"].endswith("degrees, fitted")


@pytest.mark.slow
@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize("name", ["albedo", "roughness", "metallic", "relight"])
def test_a_field_of_view_that_nobody_told_costs_little(name: str) -> None:
    found, told = (
        np.mean([fitted(*view, told).metrics[f"{name}_rmse"] for view in VIEWS])
        for told in (False, True)
    )
    assert found < 1.2 * told


def test_what_pictures_do_not_say_the_lens_prior_does() -> None:
    """A single pixel is seen straight on, whatever the lens."""
    scene = room(size=16)
    scene = Scene(images=scene.images[:, :1, :1], normals=scene.normals[:1, :1])
    found = decompose(scene, refine_normals="off", **FAST)
    sigma = np.degrees(np.sin(np.radians(60)) * settings.LOG_FOCAL_LENGTH_SIGMA)
    assert known(found.camera).fov_degrees == pytest.approx(60)
    assert known(found.camera).fov_sigma == pytest.approx(sigma)


def test_unknown_stays_unknown_on_the_way_through_a_folder(tmp_path: Path) -> None:
    made = room(size=8)
    scene = Scene(images=made.images, normals=made.normals)
    assert (scene.fov, scene.fov_known) == (60.0, False)
    assert Scene(images=made.images, normals=made.normals, fov=60).fov_known
    assert not replace(scene, images=made.images).fov_known
    scene.save(tmp_path / "scene")
    assert not Scene.load(tmp_path / "scene").fov_known
    assert Scene.load(tmp_path / "scene", fov=50).fov_known


@pytest.mark.parametrize(
    "camera",
    [
        Camera(60.0, "given"),
        Camera(62.25, "fitted", 1.1),
        Camera(60.0, "assumed"),
        replace(CONTRADICTED, response="linear"),
    ],
)
def test_result_json_holds_the_camera(camera: Camera, tmp_path: Path) -> None:
    result = decompose(room(size=8).of_pictures([0, 1]), iterations=0, **FAST)
    replace(result, camera=camera).save(tmp_path / "out")
    assert Result.load(tmp_path / "out").camera == camera


def test_words() -> None:
    assert Camera(62.25, "fitted", 1.1).in_words() == "62.2 ± 1.1 degrees, fitted"
    assert Camera(62.25, "fitted", 12.0).in_words() == "62 ± 12 degrees, fitted"
    assert Camera(0.0, "given").in_words() == "0 degrees, given"


def bent(scene: Scene, numbers: tuple[float, ...]) -> Scene:
    """As a camera with the inverse of a correction shows it."""
    correction = Correction(scene.mean_brightness(), numbers)
    images = correction.applied(scene.images)
    return replace(scene, images=images.astype(np.float32))


CURVE = (0.1, 0.0, 0.0)


@pytest.mark.slow
def test_a_tone_curve_is_undone_where_it_is_asked_for() -> None:
    # In single scenes fits with the curve free end beside the best minimum: the middle of three.
    better = []
    for seed in (301, 302, 303):
        scene = make_scene("furnished", size=64, lights=16, noise=0.01, seed=seed, held_out=2)
        held, found = (
            decompose(bent(scene, CURVE), response=response, **FAST) for response in ("auto", "fit")
        )
        assert known(held.camera).correction is None
        assert found.camera is not None
        assert known(found.camera.correction).numbers[0] == pytest.approx(-0.1, abs=0.03)
        assert "response" in found.assumed
        assert read_as(Camera, json.loads(json.dumps(asdict(found.camera)))) == found.camera
        better.append(found.metrics["albedo_rmse"] / held.metrics["albedo_rmse"])
    assert np.median(better) < 0.8


@pytest.mark.slow
def test_a_tone_curve_of_clipped_pictures_is_undone_too() -> None:
    """What it does to values at limits says nothing of how likely it is."""
    scene = make_scene("furnished", size=64, lights=16, noise=0.01, seed=301, held_out=2)
    scene = bent(scene, CURVE)
    highest = np.quantile(scene.images[:, scene.valid], 0.93)
    clipped = replace(scene, images=np.minimum(scene.images, highest))
    found = decompose(clipped, response="fit", **FAST)
    assert known(known(found.camera).correction).numbers[0] == pytest.approx(-0.1, abs=0.04)


@pytest.mark.parametrize("response", ["auto", "fit", "linear"])
def test_a_tone_curve_is_fitted_only_where_it_is_asked_for(response: Response) -> None:
    scene = bent(room(size=12), CURVE).of_pictures([0, 1, 2])
    found = decompose(scene, response=response, **FAST)
    assert ("response" in found.assumed) == (response == "fit")
