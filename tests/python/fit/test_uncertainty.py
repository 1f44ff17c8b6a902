"""Uncertainty: normal equations against a slow reference, and deviations against dense algebra."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import pbrfit
from pbrfit.fit import discrepancy, settings, uncertainty
from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import MEAN_RADIANCE, SAMPLE_USES, SIGMA_MAX
from pbrfit.result.uncertainty import Uncertainty, layer_names
from pbrfit.result.verdict import PARAMETERS
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from result_files import layers_of
from scene_files import known, truth_of
from scene_kinds import at_truth


def scene_and_x(**options: Any) -> tuple[pbrfit.Scene, Objective, Array]:
    """A small noisy room, away from the bounds, at its true maps and best lights."""
    scene = make_scene("room", size=12, lights=6, held_out=1, noise=0.01, seed=2003)
    if options.pop("grey", False):
        grey = scene.images.mean(axis=-1, keepdims=True).repeat(3, axis=-1)
        scene = dataclasses.replace(scene, images=grey, truth=None)
    if options.pop("known_lights", False):
        scene = dataclasses.replace(scene, lighting=truth_of(scene).lighting, truth=scene.truth)
    mask = np.ones((12, 12), dtype=bool)
    mask[:6] = False
    scene = dataclasses.replace(scene, mask=mask)
    objective = Objective(scene, threads=options.pop("threads", 1), **options)
    rng = np.random.default_rng(5)
    maps = rng.uniform(0.2, 0.8, objective.layout.maps.stop)
    return scene, objective, objective.with_best_lights(maps)


def dense_deviations(objective: Objective, x: Array, noise: float) -> tuple[Array, Array]:
    """Conditional and marginal (P, D), by the whole Jacobian of all unknowns, dense."""
    layout = objective.layout
    pixels = np.arange(layout.pixels, dtype=np.uint64)
    by_material, by_light, weights = objective.problem.derivatives(objective.for_core(x), pixels)
    p, n, c, k = layout.pixels, layout.pictures, layout.channels, layout.coefficients
    whole = np.zeros((p, n, c, objective.for_core(x).size))
    i = np.arange(p)
    for channel in range(c):
        whole[i, :, channel, channel * p + i] = by_material[:, :, channel, 0]
    for unknown in range(1 if layout.metallic_known else 2):
        whole[i, :, :, (c + unknown) * p + i] = by_material[..., 1 + unknown]
    if layout.lighting is not None:
        lit = whole[..., layout.maps.stop :].reshape(p, n, c, n, k, c)
        for picture in range(n):
            for channel in range(c):
                lit[:, picture, channel, picture, :, channel] = by_light[:, channel]
        if layout.light_channels < c:
            light = lit.sum(axis=-1).reshape(p, n, c, n * k)
            whole = np.concatenate([whole[..., : layout.maps.stop], light], axis=-1)
    rows = whole.reshape(p * n * c, -1) * np.sqrt(weights.reshape(-1, 1))
    held = np.zeros(layout.size, dtype=bool)
    held[layout.maps] = (x[layout.maps] <= 0) | (x[layout.maps] >= 1)

    def deviations(rows: Array, used: NDArray[np.bool_]) -> Array:
        # By QR, which does not square the condition: row norms of R⁻¹.
        triangle = np.linalg.qr(rows[:, used], mode="r")
        found = np.zeros(rows.shape[1])
        found[used] = noise * np.linalg.norm(np.linalg.inv(triangle), axis=1)
        return found[layout.maps].reshape(-1, p).T

    maps = layout.maps
    return deviations(rows[:, maps], ~held[maps]), deviations(rows, ~held)


def estimated(objective: Objective, x: Array, **scale: Array) -> Uncertainty:
    """The uncertainty of x without a prior, and by default of a scale that is known."""
    found = discrepancy.find(objective, x)
    spread, of_scale = (
        uncertainty.spread(objective, x, found, None),
        scale.get("scale", np.zeros(1)),
    )
    return uncertainty.of_spread(spread, objective.layout, found, of_scale, objective)


OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"sh_order": 2, "metallic": 0.5},
    {"grey": True, "sh_order": 2},
    {"mono_light": True},
    {"known_lights": True},
)


def told(variance: float, objective: Objective, x: Array) -> Discrepancy:
    """Of samples that are off by this variance, and lights by all their modes."""
    modes = discrepancy.light_modes(objective, x)
    return Discrepancy(variance / SAMPLE_USES, 0.0, modes, 0.0)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_sharp_deviations_are_those_of_dense_algebra(
    options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where pixels tell far more than any prior, posteriors are those of all unknowns together."""
    monkeypatch.setattr(settings, "OMITTED_VARIANCE_SHARE_MAX", 0.0)
    _, objective, x = scene_and_x(**options)
    if objective.lighting is not None:
        x = objective.with_best_lights(x)
    noise = 1e-6
    found = uncertainty.spread(objective, x, told(noise**2, objective, x), None)
    with threadpool_limits(1):
        conditional, marginal = dense_deviations(objective, x, noise)
    sigma = np.sqrt(found.variance)
    sure = marginal < 1e-3  # beside the priors' 0.2 to 0.3
    assert sure.mean() > 0.3
    # Six grey samples for three unknowns and lights: the prior is felt, and only helps.
    rtol = 0.03 if options.get("grey") else 2e-3
    np.testing.assert_allclose(sigma[sure], marginal[sure], rtol=rtol)
    if objective.lighting is None:
        np.testing.assert_allclose(marginal, conditional)
    else:
        assert (marginal > 1.05 * conditional).any()  # the comparison was one of two things


def test_noise_has_its_degrees_of_freedom() -> None:
    """Of many pictures of a true scene under true lights what is left is the noise."""
    scene = make_scene("room", size=24, lights=12, held_out=1, noise=0.01, seed=2003)
    objective = Objective(scene)
    assert estimated(objective, at_truth(objective, scene)).noise == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("light", ["sh", "lamps"])
def test_a_known_metallic_is_certain(light: Any) -> None:
    scene = make_scene("spheres", size=12, lights=4, held_out=1, seed=1)
    options: dict[str, Any] = {"refine_normals": "off", "iterations": 3, "threads": 1}
    found = pbrfit.decompose(scene, light=light, metallic=0.5, **options)
    told = known(found.uncertainty)
    assert not told.deviation.metallic[found.mask].any()
    for values in (found.materials, told.low, told.high):
        assert (values.metallic[found.mask] == 0.5).all()


def test_what_no_picture_shows_is_as_unsure_as_a_guess() -> None:
    """A pixel in one picture: three samples for five unknowns, and its neighbour has them all."""
    scene, _, _ = scene_and_x(known_lights=True)
    weights = np.ones((6, 12, 12), dtype=np.float32)
    weights[1:, 8, 5] = 0
    objective = Objective(dataclasses.replace(scene, weights=weights))
    x = np.full(objective.size, 0.4)
    found = uncertainty.spread(objective, x, told(1e-8, objective, x), None)
    sigma = objective.layout.whole(np.sqrt(found.variance).max(axis=1))
    assert sigma[8, 5] > 0.15
    assert sigma[8, 6] < 0.1


def test_fewer_samples_than_unknowns_determine_nothing() -> None:
    scene, _, _ = scene_and_x(known_lights=True)
    one = dataclasses.replace(
        scene, images=scene.images[:1], lighting=known(scene.lighting)[:1], names=(), truth=None
    )
    objective = Objective(one)
    found = estimated(objective, np.full(objective.size, 0.4))
    assert found.noise is None
    assert found.summary()["noise"] is None
    assert {found.verdicts[name].level for name in ("roughness", "metallic")} == {"not determined"}


def moves_per_scale(objective: Objective, x: Array, variance: float) -> Array:
    """(P, D): what least squares move a pixel's materials by when all radiance grows, by numpy."""
    pixels = np.arange(objective.pixels, dtype=np.uint64)
    core, c = objective.for_core(x), objective.channels
    of_channel, _, _ = objective.problem.derivatives(core, pixels)
    rendered = objective.problem.residuals(core, pixels) + objective.pictures(pixels)
    rendered = rendered.transpose(1, 0, 2)
    found = np.empty((objective.pixels, c + 2))
    for pixel in range(objective.pixels):
        by_sample = np.zeros((rendered.shape[1], c, c + 2))
        for channel in range(c):
            by_sample[:, channel, channel] = of_channel[pixel, :, channel, 0]
        by_sample[..., c:] = of_channel[pixel, ..., 1:]
        rows = by_sample.reshape(-1, c + 2)
        matrix = rows.T @ rows + np.diag(discrepancy.prior_precision(c + 2, c, variance))
        found[pixel] = -np.linalg.solve(matrix, rows.T @ rendered[pixel].ravel())
    return found


def test_the_scale_is_in_all_deviations() -> None:
    """Albedo goes with its inverse, and roughness and metallic as least squares move with it."""
    _, objective, x = scene_and_x()
    deviation = 0.02
    known, unknown = (estimated(objective, x, scale=np.full(1, of)) for of in (0.0, deviation))
    inside = objective.layout.valid
    moves = deviation * moves_per_scale(objective, x, discrepancy.find(objective, x).of_pixel)
    for i, (name, most) in enumerate((("roughness", 0.22), ("metallic", 0.41))):
        before, after = (getattr(one.deviation, name)[inside] for one in (known, unknown))
        added = np.minimum(np.abs(moves[:, 3 + i]), most)
        expected = np.minimum(np.hypot(before, added), SIGMA_MAX)
        np.testing.assert_allclose(after, expected, rtol=1e-3)
        assert (added > 1e-3).any()
    expected = np.hypot(known.deviation.albedo, deviation * objective.unpack(x)[0].albedo)
    np.testing.assert_allclose(
        unknown.deviation.albedo[inside], np.minimum(expected, SIGMA_MAX)[inside], rtol=1e-5
    )
    assert unknown.albedo_scale == (deviation,) * 3


def test_shade_is_in_the_deviation_of_albedo_however_many_pictures() -> None:
    """Of two samples as uncertain, by noise or by what the model has not, only noise averages."""
    _, objective, x = scene_and_x()
    modes = np.zeros((0, objective.layout.pictures, objective.layout.coefficients, 3))
    shaded = Discrepancy(1e-5, 1e-4, modes, 0.0)
    noisy = Discrepancy(shaded.of_pixel / SAMPLE_USES, 0.0, modes, 0.0)
    assert noisy.of_pixel == pytest.approx(shaded.of_pixel)
    before, after = (uncertainty.spread(objective, x, of, None).variance for of in (noisy, shaded))
    albedo = x[objective.albedo].reshape(3, -1).T
    expected = np.square(np.maximum(albedo, albedo.mean(axis=0)) * shaded.misfit / MEAN_RADIANCE)
    np.testing.assert_allclose(
        after[:, :3], np.minimum(before[:, :3] + expected, SIGMA_MAX**2), rtol=1e-4
    )
    np.testing.assert_allclose(after[:, 3:], before[:, 3:], rtol=1e-4)
    assert (expected > 1e-6).all()


def test_a_result_folder_keeps_it(tmp_path: Path) -> None:
    scene, objective, x = scene_and_x()
    result = pbrfit.decompose(scene, solver="lbfgsb", iterations=2, uncertainty=False)
    saved = estimated(objective, x)
    dataclasses.replace(result, uncertainty=saved).save(tmp_path / "out")
    loaded = known(pbrfit.Result.load(tmp_path / "out").uncertainty)
    for name, layer in saved.layers().items():
        np.testing.assert_array_equal(
            loaded.layers()[name].astype(np.float32), layer.astype(np.float32), err_msg=name
        )
    for field in dataclasses.fields(saved):
        value = getattr(saved, field.name)
        if not isinstance(value, (np.ndarray, pbrfit.Materials)):
            assert getattr(loaded, field.name) == value
    layers = layers_of(tmp_path / "out" / "materials.exr")
    assert set(layer_names()) <= set(layers)  # names above 31 letters, too
    assert all(np.isfinite(layer).all() for layer in layers.values())
    content = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert set(content["uncertainty"]["verdicts"]) == set(PARAMETERS)
