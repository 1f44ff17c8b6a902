"""What a scene does not need is not computed, changes nothing, and is named in the result."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit.fit.objective import Objective
from pbrfit.result.options import SOLVERS, Solver
from pbrfit.synthetic import make_scene
from scene_files import known, lights_of, truth_of
from scene_kinds import known_lights

SIZE, N = 16, 3


def in_color(**options: Any) -> pbrfit.Scene:
    return make_scene("textured", size=SIZE, held_out=2, **({"lights": N} | options))


def in_grey() -> pbrfit.Scene:
    """The first channel of everything."""
    scene = in_color()
    known = truth_of(scene)
    maps = dataclasses.replace(known.materials, albedo=grey(known.materials.albedo))
    return pbrfit.Scene(
        images=grey(scene.images),
        normals=scene.normals,
        fov=scene.fov,
        truth=pbrfit.Truth(maps, grey(lights_of(scene))),
    )


def grey(values: NDArray[Any]) -> NDArray[Any]:
    return np.repeat(values[..., :1], 3, axis=-1)


def some_weights(seed: int = 0, *channels: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0.1, 1.0, (N, SIZE, SIZE, *channels)).astype(np.float32)
    weights[rng.random(weights.shape) < 0.1] = 0
    return weights


def without_priors(result: pbrfit.Result) -> list[str]:
    """What was left out beside lamps and priors, which depend on the lights that were found."""
    return [
        entry
        for entry in result.left_out
        if not entry.startswith(("prior", "surroundings", "lamps:"))
    ]


def assert_same_bits(a: pbrfit.Result, b: pbrfit.Result) -> None:
    for name in ("albedo", "roughness", "metallic", "lighting"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    np.testing.assert_array_equal(a.history["loss"], b.history["loss"])
    assert a.metrics == pytest.approx(b.metrics, rel=1e-13)  # weighted means round differently


def test_grey_pictures_are_fitted_like_colour_pictures_of_equal_channels() -> None:
    scene = in_grey()
    # Beside the last digit of float32, but no longer exactly equal.
    tint = np.array([1.0, 1.0, 1.0 + 1e-9])
    colored = dataclasses.replace(scene, images=scene.images.astype(np.float64) * tint)
    one, three = Objective(scene), Objective(colored)
    assert (one.channels, three.channels) == (1, 3)
    maps = truth_of(scene).materials
    for lighting in (None, 0.9 * lights_of(scene)):
        arguments = (maps.albedo**2, 0.5 * maps.roughness, maps.metallic, lighting)
        losses = [o.value_and_grad(o.pack(*arguments))[0] for o in (one, three)]
        assert losses[0] == pytest.approx(losses[1], rel=1e-5)
    result = pbrfit.decompose(scene, start=(maps, lights_of(scene)), iterations=5, priors=None)
    assert result.metrics["albedo_rmse"] <= 1e-6
    assert result.metrics["recon_rmse"] <= 1e-7


def test_one_sample_in_colour_makes_three_channels() -> None:
    scene = in_grey()
    images = scene.images.copy()
    images[-1, -1, -1, 2] = np.nextafter(images[-1, -1, -1, 2], np.inf)
    assert Objective(dataclasses.replace(scene, images=images)).channels == 3
    mask = np.ones((SIZE, SIZE), bool)
    mask[-1, -1] = False
    assert Objective(dataclasses.replace(scene, images=images, mask=mask)).channels == 1
    weights = np.ones((N, SIZE, SIZE))
    weights[-1, -1, -1] = 0
    assert Objective(dataclasses.replace(scene, images=images, weights=weights)).channels == 1


def test_known_lights_in_colour_make_three_channels() -> None:
    scene = in_grey()
    lighting = lights_of(scene).copy()
    assert Objective(dataclasses.replace(scene, lighting=lighting)).channels == 1
    lighting[0, 15, 1] *= 1 + 1e-15
    assert Objective(dataclasses.replace(scene, lighting=lighting)).channels == 3


def test_scenes_of_order_two_are_explained_without_band_three() -> None:
    scene = in_color(sh_order=2)
    start = (truth_of(scene).materials, lights_of(scene))
    options: dict[str, Any] = {"sh_order": 2, "iterations": 5, "priors": None}
    result = pbrfit.decompose(scene, start=start, **options)
    assert result.metrics["recon_rmse"] <= 1e-7
    assert not result.lighting[:, 9:].any()
    known_order_2 = pbrfit.decompose(known_lights(scene), start=start[0], **options)
    assert known_order_2.metrics["recon_rmse"] <= 1e-7
    np.testing.assert_array_equal(known_order_2.lighting, lights_of(scene))


def test_known_lights_of_order_three_are_refused_at_order_two() -> None:
    scene = known_lights(in_color())
    Objective(scene, sh_order=3)
    with pytest.raises(pbrfit.InputError, match=r"^lighting: expected known lights without band 3"):
        Objective(scene, sh_order=2)


@pytest.mark.parametrize("metallic", [0.0, 0.7])
def test_given_metallic_explains_pictures_of_it(metallic: float) -> None:
    scene = in_color()
    lighting = lights_of(scene)
    flat = np.full((SIZE, SIZE), metallic)
    maps = dataclasses.replace(truth_of(scene).materials, metallic=flat)
    images = pbrfit.kernel.render(maps, scene.normals, lighting, scene.fov)
    scene = dataclasses.replace(scene, images=images, truth=pbrfit.Truth(maps, lighting))
    options: dict[str, Any] = {"start": (maps, lighting), "iterations": 5, "priors": None}
    result = pbrfit.decompose(scene, **options, metallic=metallic)
    assert (result.metallic == metallic).all()
    assert result.metrics["metallic_rmse"] == 0
    assert result.metrics["recon_rmse"] <= 1e-7
    wrong = pbrfit.decompose(scene, **options, metallic=1 - metallic)
    assert wrong.metrics["recon_rmse"] > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("shape", [(SIZE, SIZE), (N, SIZE, SIZE)])
@pytest.mark.parametrize("value", [1.0, 1e-30, 1e30, 3])
def test_equal_weights_are_no_weights(value: float, shape: tuple[int, ...], solver: Solver) -> None:
    scene = in_color()
    weighted = dataclasses.replace(scene, weights=np.full(shape, value))
    a, b = (pbrfit.decompose(s, solver=solver, iterations=12) for s in (scene, weighted))
    assert_same_bits(a, b)
    assert without_priors(a) == without_priors(b) == []


@pytest.mark.slow
@pytest.mark.parametrize("channels", [(), (3,)])
def test_samples_of_weight_zero_are_not_looked_at(channels: tuple[int, ...]) -> None:
    scene = in_color()
    weights = some_weights(0, *channels)
    results = []
    for value in (0.0, -7.0, 1e30, np.nan, np.inf):
        images = scene.images.astype(np.float32)
        images[weights == 0] = value
        changed = dataclasses.replace(scene, images=images, weights=weights)
        results.append(pbrfit.decompose(changed, iterations=10, uncertainty=False))
    for result in results[1:]:
        assert_same_bits(result, results[0])


def test_a_pixel_without_weight_is_as_if_masked() -> None:
    scene = in_color()
    mask = np.random.default_rng(6).random((SIZE, SIZE)) < 0.7
    images, normals = scene.images.copy(), scene.normals.copy()
    images[:, ~mask], normals[~mask] = np.nan, 0.0
    changes: dict[str, Any] = {"images": images, "normals": normals}
    masked = dataclasses.replace(scene, mask=mask, **changes)
    weighted = dataclasses.replace(scene, weights=mask.astype(float), **changes)
    np.testing.assert_array_equal(weighted.valid, mask)
    np.testing.assert_array_equal(weighted.normals, masked.normals)
    a, b = (pbrfit.decompose(s, iterations=10) for s in (masked, weighted))
    assert_same_bits(a, b)
    np.testing.assert_array_equal(a.mask, b.mask)
    outside = int(np.count_nonzero(~mask))
    assert without_priors(a) == [f"{outside} pixels outside the mask"]
    assert without_priors(b) == [f"{outside} pixels without a usable sample"]


@pytest.mark.parametrize("channels", [(), (3,)])
def test_the_reconstruction_error_is_weighted(channels: tuple[int, ...]) -> None:
    weights = some_weights(0, *channels)
    scene = dataclasses.replace(in_color(), weights=weights)
    result = pbrfit.decompose(scene, solver="lbfgsb", iterations=20)
    rendered = pbrfit.kernel.render(result.materials, scene.normals, result.lighting, scene.fov)
    squares = np.square(rendered - scene.images)[:, scene.valid]
    of_values = known(scene.weights).astype(np.float64)[:, scene.valid]
    expected = np.sqrt(np.sum(of_values * squares) / np.sum(of_values))
    assert result.metrics["recon_rmse"] == pytest.approx(expected, rel=1e-12)
    assert result.metrics["recon_rmse"] != pytest.approx(np.sqrt(np.mean(squares)), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_weights_keep_bad_samples_out_of_the_maps(solver: Solver) -> None:
    """A tenth of the samples is ten times too bright, as in a highlight that the model lacks.

    One of a pixel at most: fewer than four pictures have more than one exact answer.
    """
    scene, rng = in_color(lights=5), np.random.default_rng(7)
    there = rng.random((SIZE, SIZE)) < 0.1 * 5
    bad = there & (rng.integers(5, size=(SIZE, SIZE)) == np.arange(5)[:, None, None])
    spoilt = dataclasses.replace(scene, images=scene.images * np.where(bad, 10, 1)[..., None])
    weighted = dataclasses.replace(spoilt, weights=(~bad).astype(float))
    clean, without, within = (
        pbrfit.decompose(s, solver=solver, iterations=200, priors=None, refine_normals="off")
        for s in (scene, spoilt, weighted)
    )
    for name in ("albedo_scaled_rmse", "roughness_rmse", "metallic_rmse"):
        assert within.metrics[name] <= 2 * clean.metrics[name] + 0.02, name
        assert within.metrics[name] <= 0.7 * without.metrics[name], name


@pytest.mark.usefixtures("uncompared")
def test_a_channel_without_weight_leaves_the_others_their_say() -> None:
    """Of an orange surface: the red of each pixel is clipped in the half that is brighter."""
    scene = make_scene("textured", size=SIZE, lights=8, held_out=2)
    bright = scene.images[..., 0] > np.median(scene.images[..., 0], axis=0)
    images, of_red = scene.images.copy(), np.ones(scene.images.shape)
    images[bright, 0], of_red[bright, 0] = np.nan, 0
    options: dict[str, Any] = {"priors": None, "robust": "none", "light": "sh"}
    options |= {"refine_normals": "off", "uncertainty": False}
    clean = pbrfit.decompose(scene, **options)
    fitted = pbrfit.decompose(dataclasses.replace(scene, images=images, weights=of_red), **options)
    shared = dataclasses.replace(scene, weights=of_red.min(axis=-1))
    as_before = pbrfit.decompose(shared, **options)
    for name in ("albedo_scaled_rmse", "roughness_rmse", "metallic_rmse"):
        assert fitted.metrics[name] <= as_before.metrics[name], name
    assert fitted.metrics["albedo_scaled_rmse"] <= clean.metrics["albedo_scaled_rmse"] + 0.005


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_pixel_of_vanishing_weight_does_no_harm(solver: Solver) -> None:
    weights = some_weights()
    weights[:, 3, 3] = 1e-38
    weights[0, 4, 4] = 1e30  # beside which the others vanish in float32
    scene = dataclasses.replace(in_color(), weights=weights)
    result = pbrfit.decompose(scene, solver=solver, iterations=20)
    for name in ("albedo", "roughness", "metallic"):
        assert np.isfinite(getattr(result, name)[result.mask]).all()
    assert np.isfinite(result.lighting).all()
