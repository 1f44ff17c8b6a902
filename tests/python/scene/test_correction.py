"""Tone curves: what a camera does to radiance, and what undoes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbrfit import Scene
from pbrfit.scene.correction import DARKEST, Correction
from pbrfit.synthetic import make_scene

REFERENCE = 2.0
NUMBERS = (-0.2, 0.1, 0.15)


def shown(correction: Correction, radiance: np.ndarray) -> np.ndarray:
    """As the module's formula has it."""
    log = np.log(radiance / correction.reference)
    a, b, c = correction.numbers
    curve = log - a * log - b * np.minimum(log - np.log(1 / 3), 0)
    curve -= c * np.maximum(log - np.log(3), 0)
    return np.asarray(correction.reference * np.exp(curve))


def some() -> np.ndarray:
    return np.exp(np.random.default_rng(0).uniform(np.log(0.1), np.log(200), (50, 3)))


def test_what_a_camera_did_is_undone() -> None:
    correction, radiance = Correction(REFERENCE, NUMBERS), some()
    undone = correction.applied(shown(correction, radiance))
    np.testing.assert_allclose(undone, radiance, rtol=1e-12)


def test_without_numbers_nothing_changes() -> None:
    np.testing.assert_allclose(Correction(REFERENCE).applied(some()), some(), rtol=1e-14)


def test_below_the_darkest_the_gain_is_constant_and_noise_stays_what_it_is() -> None:
    correction = Correction(REFERENCE, NUMBERS)
    low = 0.1 * REFERENCE * np.exp(DARKEST)
    samples = np.array([[-low, 0.0, low]])
    undone = correction.applied(samples)
    assert undone[0, 1] == 0
    assert undone[0, 0] == -undone[0, 2]


def test_directions_are_derivatives() -> None:
    correction, radiance = Correction(REFERENCE, NUMBERS), some()
    pictures, step = shown(correction, radiance), 1e-5
    found, slope = correction.directions(radiance)
    for index, direction in enumerate(found):
        sides = []
        for by in (step, -step):
            numbers = list(NUMBERS)
            numbers[index] += by
            sides.append(Correction(REFERENCE, tuple(numbers)).applied(pictures))
        np.testing.assert_allclose((sides[0] - sides[1]) / (2 * step), direction, atol=1e-5)
    more, less = (shown(correction, radiance * (1 + by)) for by in (step, -step))
    np.testing.assert_allclose((more - less) / (2 * step * radiance), slope, rtol=1e-3)


def test_a_scene_shows_corrected_samples() -> None:
    scene = make_scene("room", size=8, lights=2, seed=1)
    correction = Correction(scene.mean_brightness(), NUMBERS)
    seen = scene.through(scene.fov, correction)
    expected = correction.applied(scene.images[1])
    np.testing.assert_allclose(seen.picture(1, slice(2, 5)), expected[2:5])
    np.testing.assert_allclose(seen.samples(1), expected.reshape(-1, 3), rtol=1e-6)
    assert seen.samples(1).dtype == scene.images.dtype
    assert replace(seen, lighting=None).correction == correction
    assert scene.correction is None
    assert isinstance(seen, Scene)


def test_words() -> None:
    words = Correction(1.0, (-0.1, 0.0, 0.0)).in_words()
    assert words.endswith("of exponents 1.10, 1.10, 1.10")
