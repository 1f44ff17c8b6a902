"""Radiance under lamps: its derivatives against central differences; samples that are bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit.fit.lamps import scale
from pbrfit.fit.lamps.joint import ALBEDO_SPREAD, Freedom, JointLamps, SurfacePrior
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance, slopes, tangents
from pbrfit.fit.lamps.sample_noise import Noise
from pbrfit.fit.lamps.surfaces import deviations, missing_highlights
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import MODELS, Model
from reference import unit

Array = NDArray[np.float64]

PIXELS, PICTURES = 6, 3
STEP = 1e-6
TERMS = 4
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
        light[:, :TERMS] = 0.1 * rng.normal(size=(PICTURES, TERMS, 3))
    albedo = rng.uniform(0.2, 0.8, (PIXELS, 3))
    roughness, metallic = rng.uniform(0.3, 0.7, PIXELS), rng.uniform(0.1, 0.9, PIXELS)
    return pixels, LampState(lamps, light, normals, albedo, roughness, metallic)


def difference(pixels: LampPixels, moved: Callable[[float], LampState]) -> Array:
    """(P, N, 3): central difference of the radiance."""
    ends = [radiance(pixels, moved(step)) for step in (STEP, -STEP)]
    return np.asarray((ends[0] - ends[1]) / (2 * STEP))


def assert_alike(found: Array, expected: Array) -> None:
    assert np.abs(found - expected).max() < 1e-6 * max(float(np.abs(expected).max()), 1.0)


every_model = pytest.mark.parametrize("model", MODELS)


@every_model
@pytest.mark.parametrize("ambient", [False, True])
def test_slopes_by_the_surface(model: Model, ambient: bool) -> None:
    pixels, state = example(model, ambient=ambient)
    found = slopes(pixels, state)
    np.testing.assert_allclose(found.radiance, radiance(pixels, state), rtol=1e-12)
    frames = tangents(state.normals)
    for unknown in range(7):

        def moved(step: float, unknown: int = unknown) -> LampState:
            normals, albedo = state.normals, state.albedo.copy()
            roughness, metallic = state.roughness, state.metallic
            if unknown < 2:
                normals = unit(normals + step * frames[:, unknown])
            elif unknown < 5:
                albedo[:, unknown - 2] += step
            elif unknown == 5:
                roughness = roughness + step
            else:
                metallic = metallic + step
            return state.with_surface(normals, albedo, roughness, metallic)

        assert_alike(found.by_surface[..., unknown], difference(pixels, moved))


@every_model
def test_slopes_by_near_lamps_with_and_without_lobes(model: Model) -> None:
    pixels, state = example(model)
    found, lamps = slopes(pixels, state), state.lamps
    for k in np.flatnonzero(NEAR):
        for axis in range(3):
            shift = np.zeros((4, 3))
            shift[k, axis] = 1.0

            def moved(step: float, shift: Array = shift) -> LampState:
                return replace(state, lamps=replace(lamps, places=lamps.places + step * shift))

            expected = difference(pixels, moved)
            assert_alike(found.by_place[:, k, :, axis], expected[:, lamps.pictures[k]])


@every_model
def test_slopes_by_far_lamps_are_those_across_the_direction(model: Model) -> None:
    pixels, state = example(model)
    found, lamps = slopes(pixels, state), state.lamps
    [k] = np.flatnonzero(~NEAR)
    for across in tangents(lamps.places[k : k + 1])[0]:

        def moved(step: float, across: Array = across) -> LampState:
            places = lamps.places.copy()
            places[k] = unit(places[k] + step * across)
            return replace(state, lamps=replace(lamps, places=places))

        expected = difference(pixels, moved)[:, lamps.pictures[k]]
        assert_alike(found.by_place[:, k] @ across, expected)


@every_model
def test_slopes_by_colours_and_ambient_light(model: Model) -> None:
    pixels, state = example(model)
    found, lamps = slopes(pixels, state), state.lamps
    for k in range(4):
        shift = np.zeros((4, 3))
        shift[k] = 1.0

        def tinted(step: float, shift: Array = shift) -> LampState:
            return replace(state, lamps=replace(lamps, colors=lamps.colors + step * shift))

        assert_alike(found.by_color[:, k], difference(pixels, tinted)[:, lamps.pictures[k]])
    for term in range(TERMS):

        def lit(step: float, term: int = term) -> LampState:
            ambient = state.ambient.copy()
            ambient[1, term] += step
            return replace(state, ambient=ambient)

        expected = difference(pixels, lit)
        assert_alike(found.by_ambient[..., term], expected[:, 1])
        assert (expected[:, [0, 2]] == 0).all()


@every_model
def test_the_joint_system_is_of_all_slopes_and_weights(model: Model) -> None:
    pixels, state = example(model)
    rng, shape = np.random.default_rng(1), pixels.samples.shape
    pixels = replace(pixels, samples=rng.uniform(0, 1, shape))
    pixels.limits[:, 0] = rng.integers(0, 3, (PIXELS, 3))
    nothing = SurfacePrior(np.zeros((PIXELS, 7)), np.zeros((PIXELS, 7)))
    noise = Noise(1.0, 0.0, np.zeros(PICTURES))
    fit = JointLamps(pixels, state, noise, nothing, Freedom(normals=True))
    fit.weights = rng.uniform(0, 1, shape)
    found, count = slopes(pixels, state), len(NEAR)
    size = 6 * count + 3 * PICTURES
    by_shared, channels = np.zeros((*shape, size)), np.arange(3)
    for k, picture in enumerate(state.lamps.pictures):
        by_shared[:, picture, :, 3 * k : 3 * k + 3] = found.by_place[:, k]
        by_shared[:, picture, channels, 3 * (count + k) + channels] = found.by_color[:, k]
    for i in range(PICTURES):
        by_shared[:, i, channels, 6 * count + 3 * i + channels] = found.by_ambient[..., 0]
    left = pixels.residuals(found.radiance)
    weights = np.where((left == 0) & (pixels.limits > 0), 0, fit.weights)
    by_all = np.concatenate([by_shared, found.by_surface[..., :6]], axis=-1)
    squares = np.einsum("pncu,pnc,pncv->puv", by_all, weights, by_all)
    pushes = np.einsum("pncu,pnc,pnc->pu", by_all, weights, left)
    shared, gradient, own, mixed, gradients = fit.system()
    precision, pulled = fit._priors(size)
    assert_alike(shared - precision, squares[:, :size, :size].sum(axis=0))
    assert_alike(gradient - pulled, pushes[:, :size].sum(axis=0))
    assert_alike(own, squares[:, size:, size:])
    assert_alike(mixed, squares[:, size:, :size])
    assert_alike(gradients, pushes[:, size:])
    along = rng.normal(size=size)
    solved = np.linalg.solve(own, gradients[..., None])
    each, of_priors = fit.scores(along)
    assert_alike(each, (pushes[:, :size] - (mixed * solved).sum(axis=1)) @ along)
    assert_alike(np.array(of_priors), pulled @ along)


def test_clipped_samples_are_bounds() -> None:
    pixels, _ = example("paper")
    limits = pixels.limits.copy()
    limits[:, 0], limits[:, 1] = AT_LEAST, AT_MOST
    weights = pixels.weights.copy()
    weights[0] = 0.0
    pixels = replace(pixels, samples=np.ones_like(weights), limits=limits, weights=weights)
    brighter, darker = (pixels.residuals(np.full(weights.shape, shown)) for shown in (1.5, 0.5))
    np.testing.assert_array_equal(brighter[1], np.repeat([[0.0], [0.5], [0.5]], 3, axis=1))
    np.testing.assert_array_equal(darker[1], np.repeat([[-0.5], [0.0], [-0.5]], 3, axis=1))
    assert (brighter[0] == 0).all()


def test_a_highlight_is_missing_where_a_sample_is_brighter_by_more_than_the_noise() -> None:
    pixels, state = example("paper")
    noise = Noise(0.1, 0.0, np.zeros(PICTURES))
    for off, missing in ((0.099, []), (0.101, [3]), (-0.101, [])):
        samples = radiance(pixels, state)
        samples[3, 1] += off
        found = missing_highlights(replace(pixels, samples=samples), state, noise)
        assert found.tolist() == missing


def test_matrices_that_rounding_made_indefinite_tell_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pixels, state = example("paper")
    own = np.tile(np.diag([1.0, 1, 1, 1, 1, -1e-3]), (PIXELS, 1, 1))
    noise, weights = Noise(1.0, 0.0, np.zeros(PICTURES)), np.ones((PIXELS, PICTURES, 3))
    parts = own, np.zeros((PIXELS, 6, 0)), None
    monkeypatch.setattr(JointLamps, "pixel_system", lambda _: parts)
    for found in deviations(pixels, state, noise, weights, Freedom(normals=True), np.zeros((0, 0))):
        assert np.isinf(found[:, 5]).all()
        np.testing.assert_allclose(found[:, :5], 1)


@pytest.mark.parametrize(("apart", "wrong"), [(0.49, 0.0), (-0.49, 0.0), (1.3, 2.3), (-1.3, 0.7)])
def test_a_scale_that_albedos_contradict_is_uncertain(apart: float, wrong: float) -> None:
    """Lamps e^1.3 too bright for usual albedos: these may be brighter by e^1.2 − 1, a factor."""
    pixels, state = example("paper")
    pixels = replace(pixels, samples=radiance(pixels, state))
    nothing = SurfacePrior(np.zeros((PIXELS, 7)), np.zeros((PIXELS, 7)))
    noise = Noise(1.0, 0.0, np.zeros(PICTURES))
    fit = JointLamps(pixels, state, noise, nothing, Freedom(normals=True))
    brighter = np.exp(apart - ALBEDO_SPREAD * fit.scale_of(state.lamps)[0])
    lamps = replace(state.lamps, colors=state.lamps.colors * brighter)
    fit.state = replace(state, lamps=lamps)
    covariance = 1e-9 * np.eye(6 * len(NEAR) + 3 * PICTURES)
    found = scale.deviation(fit, scale.with_pulls(covariance, fit, PIXELS))
    assert found == pytest.approx(wrong, abs=0.1)
