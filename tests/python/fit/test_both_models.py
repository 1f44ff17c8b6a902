"""What holds of solvers, priors and uncertainty whatever the reflection model."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from pbrfit import Objective, Scene, decompose
from pbrfit.model.reflection import MODELS, Model
from pbrfit.result.verdict import ROUGH_MAX
from pbrfit.synthetic import make_scene
from scene_files import known, truth_of
from scene_kinds import known_lights

pytestmark = pytest.mark.usefixtures("uncompared")

MAPS = ("albedo_rmse", "roughness_rmse", "metallic_rmse")

both_models = pytest.mark.parametrize("model", MODELS)


@functools.cache
def room(model: Model, size: int = 16, noise: float = 0.0) -> Scene:
    return make_scene("room", size=size, lights=16, held_out=2, seed=2000, model=model, noise=noise)


def test_exact_pictures_give_exact_materials() -> None:
    """Of the paper's model test_solvers.py says it."""
    result = decompose(room("principled"), solver="gauss-newton", priors=None, uncertainty=False)
    assert max(result.metrics[name] for name in MAPS) <= 1e-5
    assert result.metrics["relight_rmse"] <= 1e-5


def test_known_lights_give_exact_materials() -> None:
    result = decompose(known_lights(room("principled")), priors=None, uncertainty=False)
    assert max(result.metrics[name] for name in MAPS) <= 1e-6


def test_the_default_fit_learns_a_material_prior_and_comes_near_the_truth() -> None:
    scene = room("principled", size=18, noise=0.01)
    result = decompose(scene, refine_normals="off", light="sh", uncertainty=False)
    assert "prior material" not in " ".join(result.left_out)
    assert result.metrics["recon_rmse"] < 0.0105
    assert result.metrics["albedo_scaled_rmse"] < 0.05
    assert result.metrics["roughness_rmse"] < 0.1
    assert result.metrics["metallic_rmse"] < 0.1


@both_models
def test_the_true_materials_explain_pictures_of_their_model_alone(model: Model) -> None:
    [other] = set(MODELS) - {model}
    scene = room(model)
    true = truth_of(scene).materials

    def left(of: Model) -> float:
        objective = Objective(scene, model=of)
        x = objective.pack(true.albedo, true.roughness, true.metallic)
        return objective.residual_rmse(objective.data_value_and_grad(x)[0])

    assert left(model) < 1e-5
    assert left(other) > 0.003


@both_models
def test_deviations_are_of_the_size_of_the_errors(model: Model) -> None:
    scene = room(model, size=16, noise=0.01)
    true = truth_of(scene).materials
    result = decompose(known_lights(scene), priors=None)
    found = known(result.uncertainty)
    assert found.noise == pytest.approx(0.01, rel=0.1)
    inside = (result.roughness > 0) & (result.roughness < 1)
    told = inside & (found.deviation.roughness <= ROUGH_MAX["roughness"])
    off = (result.roughness - true.roughness)[told] / found.deviation.roughness[told]
    # Samples are used thrice, so deviations are √3 times those by noise alone.
    # 0.455: the median of a normal's square
    assert 0.5 / np.sqrt(3) < np.sqrt(np.median(off**2) / 0.455) < 2
