"""What noise makes of samples under lamps, sample by sample; metals among dielectrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit.fit.lamps.estimator import first_prior
from pbrfit.fit.lamps.joint import Freedom
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance
from pbrfit.fit.lamps.sample_noise import NOISE_MIN, Noise
from pbrfit.fit.lamps.surfaces import Band, fit_band
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.model.lamps import Lamps
from reference import unit

PICTURES = 11


def example(count: int) -> tuple[LampPixels, LampState]:
    """Pixels of which some samples are dark, some bright, some no data, some bounds."""
    rng = np.random.default_rng(0)
    shape, forward = (count, PICTURES, 3), [0, 0, 1]
    normals, views = (unit(rng.normal(size=(count, 3)) * 0.3 + forward) for _ in range(2))
    weights = rng.uniform(0.5, 1, shape) * (rng.random(shape) > 0.2)
    limits = rng.choice([0, 0, AT_LEAST, AT_MOST], shape).astype(np.uint8)
    flat = np.zeros(count, np.intp), np.arange(count)
    pixels = LampPixels(
        np.zeros(shape), weights, limits, views, None, normals, *flat, 1.0, "principled", 2
    )
    places = unit(rng.normal(size=(PICTURES, 3)) * 0.5 + forward)
    lamps = Lamps(np.arange(PICTURES), places, colors=rng.uniform(1, 2, (PICTURES, 3)))
    ambient = np.zeros((PICTURES, 16, 3))
    ambient[:, 0] = 0.1 * rng.random((PICTURES, 3))
    materials = rng.random((count, 3)), rng.uniform(0.2, 0.9, count), rng.random(count)
    state = LampState(lamps, ambient, normals, *materials)
    return replace(
        pixels, samples=radiance(pixels, state) * rng.choice([0, 0.5, 1.1], shape)
    ), state


@pytest.mark.parametrize("proportional", [False, True])
def test_samples_are_judged_by_the_formulas(proportional: bool) -> None:
    pixels, state = example(20)
    shadows = np.linspace(0.0, 0.6, PICTURES)
    found = Noise(0.05, 0.1, shadows, proportional).judged(pixels, state)
    shown = radiance(pixels, state)
    left = pixels.residuals(shown)
    dark = 0
    for p, i in np.ndindex(pixels.samples.shape[:2]):
        used = pixels.weights[p, i] > 0
        level = np.maximum(pixels.samples[p, i], NOISE_MIN)
        variance = 0.05**2 + 0.1**2 * (level**2 if proportional else MEAN_RADIANCE * level)
        terms = left[p, i] ** 2 / variance + np.log(2 * np.pi * variance)
        share = np.clip(shadows[i], 1e-3, 0.5)
        lit = np.log(1 - share) - 0.5 * (terms[used].mean() if used.any() else 0.0)
        expected, odds = lit * used.any(), np.inf
        if left[p, i].sum() > 0:
            shadow = np.log(share) - np.log(np.maximum(shown[p, i], NOISE_MIN).mean())
            expected, odds, dark = np.logaddexp(lit, shadow), lit - shadow, dark + 1
        found.likelihoods[p] -= expected
        assert found.odds[p, i] == pytest.approx(odds)
        size = np.maximum(shown[p, i], NOISE_MIN) * np.maximum(np.abs(left[p, i]), NOISE_MIN)
        weights = [np.minimum(1 / size, 1 / variance), 1 / variance] * pixels.weights[p, i]
        np.testing.assert_allclose(found.weights[p, i], weights, rtol=1e-9)
    assert 0 < dark < found.odds.size
    np.testing.assert_allclose(found.likelihoods, 0, atol=1e-9)


METALS, ODD = np.arange(100) % 10 >= 6, np.arange(100) < 50
"""Of 10 × 10 pixels."""


def fitted(metals: tuple[float, float], off: float = 0.0) -> Band:
    """Dielectrics of roughness 0.6 beside metals of 0.15, by priors on roughness: mean, deviation.

    Samples of odd pixels have the relative deviation `off`.
    """
    pixels, state = example(100)
    rough = np.where(METALS, 0.15, 0.6)
    state = replace(state, roughness=rough, metallic=METALS.astype(float))
    rng, blank = np.random.default_rng(1), np.zeros(pixels.samples.shape)
    errors = off * rng.normal(size=blank.shape) * ODD[:, None, None]
    samples = np.maximum(radiance(pixels, state) * (1 + errors), 0)
    limits = np.zeros(blank.shape, np.uint8)
    pixels = replace(pixels, samples=samples, weights=blank + 1, limits=limits)
    priors = []
    for mean, sigma in ((0.6, 0.02), metals):
        prior = first_prior(pixels, 0.09)
        prior.mean[:, 5], prior.precision[:, 5] = mean, sigma**-2
        priors.append(prior)
    begin = state.with_surface(pixels.normals, state.albedo, np.full(100, 0.6), np.zeros(100))
    noise, freedom = Noise(0.01, 0.05, np.full(PICTURES, 0.01)), Freedom(normals=True)
    nothing = np.zeros((9 * PICTURES, 9 * PICTURES))
    known = noise, priors[0], freedom, 10
    return fit_band(pixels, begin, *known, metals=priors[1], uncertain=nothing)


def test_metals_are_not_as_rough_as_the_dielectrics_around_them() -> None:
    among_metals = np.arange(100) % 10 >= 7
    assert fitted((0.5, 0.25)).state.metallic[among_metals].mean() > 0.98
    assert fitted((0.6, 0.02)).state.metallic[METALS].mean() < 0.8  # were they


def test_pixels_that_neither_kind_explains_tell_less_of_theirs() -> None:
    found = fitted((0.5, 0.25), off=1.0)
    of_matt = ~METALS & ODD
    assert found.state.metallic[of_matt].mean() < 0.3  # 1 by the misfit of most pixels
    assert np.sqrt(found.marginal[of_matt, 6]).mean() > 0.05
    assert (found.marginal[:, 6] > 0).all()  # 0 is what is given
