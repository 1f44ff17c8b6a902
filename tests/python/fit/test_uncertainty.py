"""Uncertainty: normal equations against a slow reference, and deviations against dense algebra."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import pbrfit
from pbrfit.fit import light_spectrum, normal_equations, uncertainty
from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import SIGMA_MAX
from pbrfit.io.images import read_channels, write_exr
from pbrfit.result.uncertainty import PARAMETERS, layer_names
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.normal_errors import facing, turned
from scene_files import truth_of

Array = NDArray[np.float64]

PIXELS = 6 * 12
"""Of the small scene, in its lower half."""


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


def stacked(maps: pbrfit.Materials, objective: Objective) -> Array:
    """(P, D) of maps."""
    layout = objective.layout
    columns = [maps.albedo[layout.valid][:, : layout.channels].T, maps.roughness[layout.valid]]
    if not layout.metallic_known:
        columns.append(maps.metallic[layout.valid])
    return np.vstack(columns).T


OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"sh_order": 2, "metallic": 0.5},
    {"grey": True, "sh_order": 2},
    {"mono_light": True},
    {"known_lights": True},
)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_deviations_are_those_of_dense_algebra(
    options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uncertainty, "OMITTED_VARIANCE_SHARE_MAX", 0.0)
    _, objective, x = scene_and_x(**options)
    x[[3, 40]] = 0.0, 1.0
    if objective.lighting is not None:
        x = objective.with_best_lights(x)
    found = uncertainty.estimate(objective, x)
    assert found.noise is not None
    with threadpool_limits(1):
        conditional, marginal = dense_deviations(objective, x, found.noise / objective.scale)
    for kind, expected in (("conditional", conditional), ("marginal", marginal)):
        expected = np.minimum(expected, SIGMA_MAX)
        np.testing.assert_allclose(
            stacked(getattr(found, kind), objective), expected, rtol=1e-5, err_msg=kind
        )
    if objective.lighting is None:
        assert found.light_modes == 0
        np.testing.assert_array_equal(found.marginal.albedo, found.conditional.albedo)
        assert found.albedo_scale == (0, 0, 0)
    else:
        assert found.light_modes > 0
        assert (marginal > 1.05 * conditional).any()  # the comparison was one of two things


def test_few_modes_say_what_they_leave_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uncertainty, "SIGMA_MAX", np.inf)
    _, objective, x = scene_and_x()
    few = uncertainty.estimate(objective, x)
    monkeypatch.setattr(uncertainty, "OMITTED_VARIANCE_SHARE_MAX", 0.0)
    all_modes = uncertainty.estimate(objective, x)
    assert 0 < few.light_modes < all_modes.light_modes
    a, b = stacked(few.marginal, objective), stacked(all_modes.marginal, objective)
    assert float((1 - a / b).max()) == pytest.approx(few.omitted, rel=1e-3)
    assert few.omitted < 0.1
    assert all_modes.omitted == 0


def test_many_lights_need_few_of_their_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    _, objective, x = scene_and_x()
    monkeypatch.setattr(uncertainty, "OMITTED_VARIANCE_SHARE_MAX", 0.0)
    whole = uncertainty.estimate(objective, x)
    monkeypatch.setattr(light_spectrum, "DENSE_UNKNOWNS_MAX", 6 * 16 * 3 - 1)
    few = uncertainty.estimate(objective, x)
    assert few.light_modes == light_spectrum.LEADING_EIGENVALUES < whole.light_modes
    np.testing.assert_allclose(
        stacked(few.marginal, objective), stacked(whole.marginal, objective), rtol=0.01
    )
    np.testing.assert_allclose(few.albedo_scale, whole.albedo_scale, rtol=1e-3)


@pytest.mark.parametrize("options", [{}, {"grey": True}, {"mono_light": True}], ids=str)
def test_what_materials_imitate_is_what_they_take_away(options: dict[str, Any]) -> None:
    _, objective, x = scene_and_x(**options)
    layout = objective.layout
    pixels = np.arange(layout.pixels, dtype=np.uint64)
    held = normal_equations.held_at_bounds(x, layout)
    part = normal_equations.eliminate(
        objective.problem, objective.for_core(x), layout, pixels, held
    )
    n, lit, k = layout.pictures, layout.light_channels, layout.coefficients
    lights = np.random.default_rng(6).normal(size=(n, lit, k, 3))
    alone = np.einsum("nlkj,nljr->nlkr", part.information_alone(layout), lights)
    left = (part.information(layout) @ lights.reshape(n * lit * k, 3)).reshape(lights.shape)
    found, expected = part.imitated(lights, layout), alone - left
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_a_subsample_gives_nearly_the_same() -> None:
    scene = make_scene("room", size=48, lights=6, held_out=1, noise=0.01, seed=2003)
    objective = Objective(scene)
    x = objective.start()
    whole = uncertainty.estimate(objective, x)
    part = uncertainty.estimate(objective, x, light_pixels=600)
    assert (whole.light_pixels, part.light_pixels) == (48 * 48, 600)
    ratio = stacked(part.marginal, objective) / stacked(whole.marginal, objective)
    assert abs(np.median(ratio) - 1) < 0.1
    assert np.mean(np.abs(ratio - 1) < 0.2) > 0.95


def test_noise_has_its_degrees_of_freedom() -> None:
    _, objective, x = scene_and_x()
    x[7] = 1.0
    loss, _ = objective.value_and_grad(x)
    found = uncertainty.estimate(objective, x)
    samples = PIXELS * 6 * 3
    unknowns = PIXELS * 5 - 1 + 6 * 16 * 3
    expected = objective.scale * np.sqrt(loss * samples / (samples - unknowns))
    assert found.noise == pytest.approx(expected, rel=1e-5)


def test_samples_of_no_weight_are_no_samples() -> None:
    scene, _, _ = scene_and_x()
    weights = np.ones((6, 12, 12), dtype=np.float32)
    weights[4:] = 0
    weights[4, 6] = weights[5, :8] = 1e-6  # every picture needs some weight
    objective = Objective(dataclasses.replace(scene, weights=weights))
    assert objective.samples == 3 * (PIXELS * 4 + 12 + 2 * 12)


def test_a_parameter_on_a_bound_is_held_and_flagged() -> None:
    _, objective, x = scene_and_x()
    metallic = objective.layout.metallic
    assert metallic is not None
    free = uncertainty.estimate(objective, x)
    x[metallic] = 0.0
    held = uncertainty.estimate(objective, x)
    inside = objective.layout.valid
    assert held.on_bound[..., 2][inside].all()
    assert not held.on_bound[..., :2].any()
    assert not held.undetermined[..., 2].any()
    assert (held.marginal.metallic[inside] == 0).all()
    assert not free.on_bound.any()
    assert (free.marginal.metallic[inside] > 0).all()
    assert not held.on_bound[~inside].any()


def test_what_no_picture_shows_is_not_determined() -> None:
    """A pixel in one picture: three samples for five unknowns, and its neighbour has them all."""
    scene, _, _ = scene_and_x(known_lights=True)
    weights = np.ones((6, 12, 12), dtype=np.float32)
    weights[1:, 8, 5] = 0
    objective = Objective(dataclasses.replace(scene, weights=weights))
    x = np.full(objective.size, 0.4)
    found = uncertainty.estimate(objective, x)
    assert found.undetermined[8, 5].any()
    deviations = [found.marginal.roughness[8, 5], found.marginal.metallic[8, 5]]
    assert max(deviations) == SIGMA_MAX
    assert np.isfinite(stacked(found.marginal, objective)).all()
    assert not found.undetermined[8, 6, 0]


def test_equal_lights_leave_materials_undetermined() -> None:
    """N copies of one picture are one picture: any material has lights that explain it."""
    scene, _, _ = scene_and_x()
    images = np.broadcast_to(scene.images[:1], scene.images.shape).copy()
    objective = Objective(dataclasses.replace(scene, images=images, truth=None))
    x = objective.with_best_lights(np.full(objective.layout.maps.stop, 0.4))
    found = uncertainty.estimate(objective, x)
    assert found.undetermined[objective.layout.valid].any(axis=-1).mean() > 0.9
    assert np.isfinite(stacked(found.marginal, objective)).all()


def test_fewer_samples_than_unknowns_determine_nothing() -> None:
    scene, _, _ = scene_and_x(known_lights=True)
    assert scene.lighting is not None
    one = dataclasses.replace(
        scene, images=scene.images[:1], lighting=scene.lighting[:1], names=(), truth=None
    )
    objective = Objective(one)
    x = np.full(objective.size, 0.4)
    x[0] = 1.0
    found = uncertainty.estimate(objective, x)
    inside = objective.layout.valid
    assert found.noise is None
    assert found.undetermined[inside].all()
    assert found.marginal.albedo[inside][0].tolist() == [0, 1, 1]
    assert found.summary()["noise"] is None


def test_refined_normals_are_held_as_they_were_found() -> None:
    """Deviations of a refined fit are those of a fit to which its normals were given."""
    made = make_scene("room", size=16, lights=6, held_out=1, noise=0.004, seed=5)
    wrong = facing(turned(made.normals, np.full(made.normals.shape, 6.0)), made.views)
    scene = dataclasses.replace(made, normals=wrong)
    result = pbrfit.decompose(scene, iterations=3, priors=None, refine_normals="on")
    assert result.refinement.refined
    assert result.uncertainty is not None
    objective = Objective(dataclasses.replace(scene, normals=result.normals))
    x = objective.pack(result.albedo, result.roughness, result.metallic, result.lighting)
    given = uncertainty.estimate(objective, x)
    assert result.uncertainty.noise == pytest.approx(given.noise)
    for name in ("albedo", "roughness", "metallic"):
        found = getattr(result.uncertainty.marginal, name)
        np.testing.assert_allclose(found, getattr(given.marginal, name), rtol=1e-6, atol=1e-9)
    as_given = uncertainty.estimate(Objective(scene), x)
    assert as_given.noise is not None
    assert given.noise is not None
    assert as_given.noise > 2 * given.noise


def test_deviations_grow_with_the_noise_alone() -> None:
    """Ten times the exposure is ten times the noise in picture units, and nothing else."""
    scene, objective, x = scene_and_x()
    brighter = Objective(dataclasses.replace(scene, images=10 * scene.images, truth=None))
    one, ten = uncertainty.estimate(objective, x), uncertainty.estimate(brighter, x)
    assert one.noise is not None
    assert ten.noise == pytest.approx(10 * one.noise, rel=1e-5)
    np.testing.assert_allclose(
        stacked(ten.marginal, brighter), stacked(one.marginal, objective), rtol=1e-4
    )


def test_what_pictures_share_is_in_the_deviations() -> None:
    _, objective, x = scene_and_x()
    one, four = (uncertainty.estimate(objective, x, picture_effect=n) for n in (1.0, 4.0))
    assert four.noise == one.noise
    for name in ("conditional", "marginal"):
        before, after = (stacked(getattr(of, name), objective) for of in (one, four))
        np.testing.assert_allclose(after, np.minimum(2 * before, SIGMA_MAX), rtol=1e-6)


def with_uncertainty() -> pbrfit.Result:
    scene, objective, x = scene_and_x()
    result = pbrfit.decompose(scene, iterations=2)
    return dataclasses.replace(result, uncertainty=uncertainty.estimate(objective, x, priors=True))


def test_a_result_folder_keeps_it(tmp_path: Path) -> None:
    result = with_uncertainty()
    result.save(tmp_path / "out")
    loaded = pbrfit.Result.load(tmp_path / "out").uncertainty
    saved = result.uncertainty
    assert loaded is not None
    assert saved is not None
    for name, layer in saved.layers().items():
        np.testing.assert_array_equal(
            loaded.layers()[name].astype(np.float32), layer.astype(np.float32), err_msg=name
        )
    for field in dataclasses.fields(saved):
        value = getattr(saved, field.name)
        if not isinstance(value, (np.ndarray, pbrfit.Materials)):
            assert getattr(loaded, field.name) == value
    assert loaded.priors
    [part] = OpenEXR.File(str(tmp_path / "out" / "materials.exr"), separate_channels=True).parts
    assert set(layer_names()) <= set(part.channels)  # names above 31 letters, too
    assert all(np.isfinite(channel.pixels).all() for channel in part.channels.values())
    content = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert set(content["uncertainty"]["undetermined"]) == set(PARAMETERS)


def test_a_result_without_it_has_none(tmp_path: Path) -> None:
    result = dataclasses.replace(with_uncertainty(), uncertainty=None)
    result.save(tmp_path / "out")
    assert pbrfit.Result.load(tmp_path / "out").uncertainty is None
    assert not any("uncertainty" in name for name in read_channels(tmp_path / "out/materials.exr"))


def test_a_lost_layer_is_named(tmp_path: Path) -> None:
    with_uncertainty().save(tmp_path / "out")
    file = tmp_path / "out" / "materials.exr"
    channels = dict(read_channels(file))
    del channels["uncertainty.marginal.metallic.Y"]
    write_exr(file, channels)
    with pytest.raises(
        pbrfit.InputError, match=r"expected channel uncertainty\.marginal\.metallic\.Y"
    ):
        pbrfit.Result.load(tmp_path / "out")
