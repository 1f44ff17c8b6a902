"""Radiance under lamps: its derivatives against central differences, highlights, the scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit.fit.lamps import scale
from pbrfit.fit.lamps.joint import ALBEDO_SPREAD, Freedom, JointLamps, SurfacePrior, minimize
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance, tangents
from pbrfit.fit.lamps.sample_noise import Noise
from pbrfit.fit.lamps.surfaces import deviations
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import MODELS, Model
from pbrfit.values.arrays import Array
from reference import unit

PIXELS, PICTURES = 6, 3
STEP = 1e-6
NEAR = np.array([True, False, True, True])
"""Of the lamps: one is alike to all sides, two have lobes; the second picture has two."""


def example(model: Model, *, ambient: bool = True) -> tuple[LampPixels, LampState]:
    rng = np.random.default_rng(0)
    normals = unit(rng.normal(size=(PIXELS, 3)) * 0.3 + [0, 0, 1])
    views = unit(rng.normal(size=(PIXELS, 3)) * 0.2 + [0, 0, 1])
    points = rng.normal(size=(PIXELS, 3)) * 0.3 - [0, 0, 2]
    blank = np.zeros((PIXELS, PICTURES, 3))
    samples = blank, np.ones_like(blank), np.zeros(blank.shape, np.uint8)
    of_places = np.zeros(PIXELS, np.intp), np.arange(PIXELS)
    pixels = LampPixels(*samples, views, points, normals, *of_places, 1.0, model, 1)
    lamps = Lamps(
        np.array([0, 1, 1, 2]),
        np.array([[0.3, 0.2, 0.1], [0, 0.6, 0.8], [-0.4, 0.3, -0.2], [0.1, -0.5, 0.1]]),
        near=NEAR,
        colors=rng.uniform(1, 2, (4, 3)),
        axes=unit(np.array([[0, 0, -1], [0, 0, -1], [0.1, 0.2, -1], [0, 0.2, -1]])),
        exponents=np.array([0, 0, 2.0, 3.5]),
    )
    light = np.zeros((PICTURES, 16, 3))
    if ambient:
        light[:, 0] = 0.1 * rng.normal(size=(PICTURES, 3))
    albedo = rng.uniform(0.2, 0.8, (PIXELS, 3))
    roughness, metallic = rng.uniform(0.3, 0.7, PIXELS), rng.uniform(0.1, 0.9, PIXELS)
    return pixels, LampState(lamps, light, normals, albedo, roughness, metallic)


def differences(pixels: LampPixels, state: LampState) -> Array:
    """(P, N, 3, M + 6): of the radiance by places, colours, ambient light and surfaces."""
    lamps, frames, columns = state.lamps, tangents(state.normals), []

    def moved(step: float, part: str, *at: int) -> LampState:
        normals, albedo, roughness = state.normals, state.albedo.copy(), state.roughness
        places, colors, ambient = lamps.places.copy(), lamps.colors.copy(), state.ambient.copy()
        if part == "place":
            places[at] += step
            places[~lamps.near] = unit(places[~lamps.near])
        elif part == "color":
            colors[at] += step
        elif part == "ambient":
            ambient[at[0], 0, at[1]] += step
        elif part == "offset":
            normals = unit(normals + step * frames[:, at[0]])
        elif part == "albedo":
            albedo[:, at[0]] += step
        else:
            roughness = roughness + step
        lights = replace(state, lamps=replace(lamps, places=places, colors=colors), ambient=ambient)
        return lights.with_surface(normals, albedo, roughness, state.metallic)

    for part, shape in {
        "place": lamps.places.shape,
        "color": lamps.colors.shape,
        "ambient": (pixels.pictures, 3),
        "offset": (2,),
        "albedo": (3,),
        "roughness": (1,),
    }.items():
        for at in np.ndindex(shape):
            ends = [radiance(pixels, moved(step, part, *at)) for step in (STEP, -STEP)]
            columns.append((ends[0] - ends[1]) / (2 * STEP))
    return np.stack(columns, axis=-1)


def assert_alike(found: Array, expected: Array) -> None:
    assert np.abs(found - expected).max() < 1e-6 * max(float(np.abs(expected).max()), 1.0)


def joint(pixels: LampPixels, state: LampState) -> JointLamps:
    """Without priors on surfaces."""
    nothing = SurfacePrior(np.zeros((PIXELS, 7)), np.zeros((PIXELS, 7)))
    noise = Noise(1.0, 0.0, np.zeros(PICTURES))
    return JointLamps(pixels, state, noise, nothing, Freedom(normals=True))


every_model = pytest.mark.parametrize("model", MODELS)


@pytest.mark.parametrize("ambient", [False, True])
@every_model
def test_the_joint_system_is_of_all_slopes_and_weights(model: Model, ambient: bool) -> None:
    pixels, state = example(model, ambient=ambient)
    rng, shape = np.random.default_rng(1), pixels.samples.shape
    pixels = replace(pixels, samples=rng.uniform(0, 1, shape))
    pixels.limits[:, 0] = rng.integers(0, 3, (PIXELS, 3))
    fit = joint(pixels, state)
    fit.weights = rng.uniform(0, 1, shape)
    by_all, size = differences(pixels, state), 6 * len(NEAR) + 3 * PICTURES
    left = pixels.residuals(radiance(pixels, state))
    weights = np.where((left == 0) & (pixels.limits > 0), 0, fit.weights)
    squares = np.einsum("pncu,pnc,pncv->puv", by_all, weights, by_all)
    pushes = np.einsum("pncu,pnc,pnc->pu", by_all, weights, left)
    shared, gradient, own, mixed, gradients = fit.system()
    precision, pulled = fit._priors(size)
    assert_alike(shared - precision, squares[:, :size, :size].sum(axis=0))
    assert_alike(gradient - pulled, pushes[:, :size].sum(axis=0))
    assert_alike(own, squares[:, size:, size:])
    assert_alike(mixed, squares[:, size:, :size])
    assert_alike(gradients, pushes[:, size:])
    for alone, of_all in zip(fit.pixel_system(), (own, mixed), strict=True):
        np.testing.assert_array_equal(alone, of_all)
    along = rng.normal(size=size)
    solved = np.linalg.solve(own, gradients[..., None])
    each, of_priors = fit.scores(along)
    assert_alike(each, (pushes[:, :size] - (mixed * solved).sum(axis=1)) @ along)
    assert_alike(np.array(of_priors), pulled @ along)


@pytest.mark.parametrize("black", [-0.1, 0.1])
def test_ambient_light_is_never_negative(black: float) -> None:
    """Pictures whose black is too high, or whose levels were cut too low."""
    pixels, state = example("paper", ambient=False)
    fit = joint(replace(pixels, samples=radiance(pixels, state) + black), state)
    assert minimize(fit, steps=10) > 1
    of_pictures = fit.state.ambient[:, 0]
    assert (of_pictures >= 0).all()
    assert (of_pictures == 0).all() == (black < 0)
    np.testing.assert_array_equal(fit.state.ambient[:, 1:], 0)


def test_matrices_that_rounding_made_indefinite_tell_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pixels, state = example("paper")
    own = np.tile(np.diag([1.0, 1, 1, 1, 1, -1e-3]), (PIXELS, 1, 1))
    noise, weights = Noise(1.0, 0.0, np.zeros(PICTURES)), np.ones((PIXELS, PICTURES, 3))
    parts = own, np.zeros((PIXELS, 6, 0))
    monkeypatch.setattr(JointLamps, "pixel_system", lambda _: parts)
    for found in deviations(pixels, state, noise, weights, Freedom(normals=True), np.zeros((0, 0))):
        assert np.isinf(found[:, 5]).all()
        np.testing.assert_allclose(found[:, :5], 1)
    own[:, 4:, 4:] = 1e15  # singular: the other numbers are what they were, these are not certain
    for found in deviations(pixels, state, noise, weights, Freedom(normals=True), np.zeros((0, 0))):
        assert (found[:, 4:] > 1e-3).all()
        np.testing.assert_allclose(found[:, :4], 1)


@pytest.mark.parametrize(("apart", "wrong"), [(0.49, 0.0), (-0.49, 0.0), (1.3, 2.3), (-1.3, 0.7)])
def test_a_scale_that_albedos_contradict_is_uncertain(apart: float, wrong: float) -> None:
    """Lamps e^1.3 too bright for usual albedos: these may be brighter by e^1.2 − 1, a factor."""
    pixels, state = example("paper")
    fit = joint(replace(pixels, samples=radiance(pixels, state)), state)
    brighter = np.exp(apart - ALBEDO_SPREAD * fit.scale_of(state.lamps)[0])
    lamps = replace(state.lamps, colors=state.lamps.colors * brighter)
    fit.state = replace(state, lamps=lamps)
    covariance = 1e-9 * np.eye(6 * len(NEAR) + 3 * PICTURES)
    found = scale.deviation(fit, scale.with_pulls(covariance, fit, PIXELS))
    assert found == pytest.approx(wrong, abs=0.1)
