"""Noise of samples: found from what a fit leaves, and what it makes samples weigh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import scene_kinds
from pbrfit import Priors, Scene, decompose
from pbrfit.fit import settings
from pbrfit.fit.noise import NoiseModel, estimated
from pbrfit.fit.objective import Objective
from pbrfit.fit.tails import NORMAL, WithOutliers
from pbrfit.io.color import encode_srgb
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.result.metrics import rmse
from pbrfit.synthetic import make_scene
from scene_files import known, truth_of

SIGMA = 0.01


def noisy(sigma: float | np.ndarray = SIGMA, seed: int = 3, size: int = 24) -> Scene:
    scene = make_scene("room", size=size, lights=12, held_out=2, seed=seed)
    noise = np.random.default_rng(seed).standard_normal(scene.images.shape)
    images = scene.images + np.reshape(sigma, (-1, 1, 1, 1)) * noise
    return replace(scene, images=images.astype(np.float32))


def at_truth(scene: Scene) -> tuple[Objective, np.ndarray]:
    """The objective with all pixels, and x of the truth."""
    objective = Objective(scene)
    return objective, scene_kinds.at_truth(objective, scene)


def test_noise_of_one_kind_is_even_and_normal() -> None:
    objective, x = at_truth(noisy())
    model = estimated(objective, x)
    assert model.is_even
    assert model.tails.is_normal
    assert model.weights(objective, x) is None


@pytest.mark.slow
def test_what_jpeg_did_is_known_from_its_tables(tmp_path: Path) -> None:
    """Albedo is a quarter better than where nothing is known of the files."""
    made = make_scene("room", size=64, lights=16, held_out=1, seed=420)
    exposed = made.images / np.quantile(made.images, 0.995)
    replace(made, images=exposed, truth=None).save(tmp_path / "scene")
    for name, picture in zip(made.names, exposed, strict=True):
        path = tmp_path / "scene" / "images" / f"{name}.exr"
        path.unlink()
        codes = np.rint(255 * encode_srgb(picture.clip(0, 1))).astype(np.uint8)
        Image.fromarray(codes).save(path.with_suffix(".jpg"), quality=90, subsampling=0)
    scene = Scene.load(tmp_path / "scene")
    assert scene.file_noise is not None
    assert 0.1 < scene.file_correlation < 0.5
    true, both = truth_of(made).materials.albedo, (scene, replace(scene, file_noise=None))
    found, blind = (rmse(decompose(of, uncertainty=False).albedo, true) for of in both)
    assert found < 0.75 * blind


def test_each_picture_has_its_own_variance() -> None:
    sigmas = np.where(np.arange(12) == 5, 4 * SIGMA, SIGMA)
    objective, x = at_truth(noisy(sigmas))
    model = estimated(objective, x)
    ratio = model.variances / np.median(model.variances)
    # Nothing has been fitted to these residuals, and leverages are subtracted: a sixth at most.
    assert ratio[5] == pytest.approx(16, rel=0.1)
    assert np.delete(ratio, 5) == pytest.approx(np.ones(11), rel=0.25)
    assert not model.is_even
    weights = known(model.weights(objective, x))
    assert weights.max() <= 1
    assert weights[5].mean() == pytest.approx(weights[4].mean() / 16, rel=0.15)
    remark = model.remarks(tuple(map(str, range(12))), None)
    assert remark.startswith("5 weighs 1/1")


def test_named_only_from_twice_the_deviation() -> None:
    model = NoiseModel(np.array([1.0, 1.0, 1.0, 0.0]), np.eye(4)[0], 1.0, 0.0, NORMAL, False)
    ratio = settings.PICTURE_DEVIATION_NAMED
    for factor, named in ((0.99, False), (1.01, True)):
        variances = np.array([1.0, 1.0, 1.0, (factor * ratio) ** 2])
        assert bool(replace(model, variances=variances).remarks("abcd", None)) == named


def test_noise_that_grows_with_radiance() -> None:
    scene = make_scene("room", size=24, lights=12, held_out=2, seed=3)
    noise = np.random.default_rng(0).standard_normal(scene.images.shape)
    images = scene.images + 0.01 * np.sqrt(np.abs(scene.images)) * noise
    objective, x = at_truth(replace(scene, images=images.astype(np.float32)))
    shares = estimated(objective, x).shares
    assert shares[1] > 0.7
    assert shares[0] + shares[2] < 0.3


def test_outliers_show_in_the_tails_and_weigh_nothing() -> None:
    scene = noisy()
    rng = np.random.default_rng(1)
    hot = rng.random(scene.images.shape) < 0.002
    values = 2 + 4 * rng.random(hot.shape)  # of one value they would be at a limit
    objective, x = at_truth(replace(scene, images=np.where(hot, values, scene.images)))
    model = estimated(objective, x, outliers=True)
    assert isinstance(model.tails, WithOutliers)
    is_hot = np.stack([of[scene.valid] for of in hot])
    assert model.tails.share == pytest.approx(is_hot.mean(), rel=0.1)
    assert not model.is_even
    assert np.sqrt(model.variances * objective.scale**2) == pytest.approx(
        np.full(12, SIGMA), rel=0.2
    )
    weights = known(model.weights(objective, x))
    assert weights[is_hot].max() < 0.01 * weights[~is_hot].mean()


def test_limits_count_where_the_model_is_on_the_wrong_side() -> None:
    scene = noisy()
    limits = np.zeros(scene.images.shape, np.uint8)
    limits[0, :4], limits[1, :4] = AT_LEAST, AT_MOST
    objective, x = at_truth(replace(scene, limits=limits))
    weights = known(estimated(objective, x).weights(objective, x))
    everything = np.arange(objective.pixels, dtype=np.uint64)
    residuals = objective.problem.residuals(objective.for_core(x), everything)
    for picture, sign in ((0, -1), (1, 1)):
        at_limit = limits[picture][scene.valid] > 0
        wrong = (sign * residuals[picture] > 0) & at_limit
        right = (sign * residuals[picture] < 0) & at_limit
        assert wrong.any()
        assert right.any()
        assert (weights[picture][wrong] > 0).all()
        assert (weights[picture][right] == 0).all()


def test_black_picture_does_not_have_all_the_weight() -> None:
    scene = noisy()
    images = scene.images.copy()
    images[4] = 0
    objective, x = at_truth(replace(scene, images=images))
    x[objective.layout.lighting].reshape(12, -1)[4] = 0
    model = estimated(objective, x)
    middle = np.median(model.variances)
    assert model.variances.min() >= 0.99 * settings.NOISE_VARIANCE_RATIO_MIN * middle


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("hot", 16),
        *(pytest.param(kind, 32, marks=pytest.mark.slow) for kind in ("hot", "other", "black")),
    ],
)
def test_fits_stand_bad_samples_and_pictures(kind: str, size: int) -> None:
    scene = noisy(size=size)
    images = scene.images.copy()
    if kind == "hot":
        rng = np.random.default_rng(1)
        hot = rng.random(images.shape) < 0.002
        images[hot] = 2 + 4 * rng.random(hot.sum())  # of one value they would be at a limit
    elif kind == "other":
        images[4] = noisy(size=size, seed=9).images[4]
    else:
        images[4] = np.random.default_rng(2).normal(0, SIGMA, images[4].shape)
    truth = truth_of(scene).materials.albedo
    options: dict[str, Any] = {"refine_normals": "off", "align": "off", "light": "sh"}
    options |= {"uncertainty": False, "priors": Priors(material=1)}
    errors = {}
    for name, of in (("sound", scene), (kind, replace(scene, images=images))):
        errors[name] = rmse(decompose(of, **options).albedo, truth)
    squares = decompose(replace(scene, images=images), robust="none", **options)
    assert errors[kind] <= 1.5 * errors["sound"] + 0.002
    if kind != "black":
        assert 2 * errors[kind] < rmse(squares.albedo, truth)
