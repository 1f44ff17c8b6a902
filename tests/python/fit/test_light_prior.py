"""The prior on lights: its matrix, product, cost and gradient are those of one quadratic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit import Objective, Scene, decompose
from pbrfit.fit.light_prior import BAND_SIGMA, DIM_SHARE, SCALE_SIGMA, LightPrior
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.synthetic import make_scene
from scene_files import truth_of
from scene_kinds import FREE_LIGHTS, objective_of

WEIGHTS = {"bands": (0.7, 0.0), "grey": (0.0, 0.3), "both": (0.7, 0.3), "none": (0.0, 0.0)}
each_weight = pytest.mark.parametrize("weights", WEIGHTS)


@pytest.fixture(scope="module")
def room() -> Scene:
    return make_scene("room", size=12, lights=4, noise=0.01, seed=2, held_out=1)


def prior_of(objective: Objective, weights: str) -> LightPrior:
    weight, grey = WEIGHTS[weights]
    # With one pixel it weighs what noise and what pixels share weigh together.
    prior = LightPrior.around(objective, objective.start())
    return replace(prior, noise=0.4 * weight, shared=0.6 * weight, grey=grey)


@each_weight
@pytest.mark.parametrize("kind", FREE_LIGHTS)
def test_all_of_it_is_one_quadratic(room: Scene, kind: str, weights: str) -> None:
    prior = prior_of(objective_of(room, kind), weights)
    rng = np.random.default_rng(1)
    size = np.abs(prior.mean).max()
    lights, v = size * rng.normal(size=(2, prior.mean.size))
    matrix = prior.matrix()
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() >= -1e-12 * np.abs(matrix).max()
    product = prior.product(v)
    np.testing.assert_allclose(product, matrix @ v, atol=1e-12 * np.abs(product).max())
    # Central differences of a quadratic are exact.
    slope = (prior.cost(lights + v) - prior.cost(lights - v)) / 4
    assert prior.half_gradient(lights) @ v == pytest.approx(slope, rel=1e-9, abs=1e-12)
    bent = (prior.cost(lights + v) + prior.cost(lights - v)) / 2 - prior.cost(lights)
    assert v @ product == pytest.approx(bent, rel=1e-9, abs=1e-12)
    assert prior.cost(lights) >= 0


def test_it_is_the_normal_distribution_of_its_definition(room: Scene) -> None:
    """Of bands around a constant light, and of a scale that all lights share."""
    objective = objective_of(room, "colour")
    prior = prior_of(objective, "bands")
    constant = np.abs(objective.start()[objective.layout.lighting].reshape(4, 16, 3)[:, 0])
    np.testing.assert_allclose(prior.mean.reshape(3, 4, 16)[..., 0], constant.T)
    sigmas = np.repeat(BAND_SIGMA * constant.T, 16)
    covariance = np.diag(sigmas**2) + SCALE_SIGMA**2 * np.outer(prior.mean, prior.mean)
    product = prior.matrix() @ covariance
    np.testing.assert_allclose(product, 0.7 * np.eye(len(sigmas)), atol=1e-9)
    # Lights of another scale are likelier than one light alone of another.
    all_brighter, one_brighter = 2 * prior.mean, prior.mean.copy()
    one_brighter[:16] *= 2
    assert prior.cost(prior.mean) == 0
    assert prior.cost(all_brighter) < prior.cost(one_brighter)


def test_bands_of_a_dark_light_are_not_known_to_be_dark(room: Scene) -> None:
    objective = objective_of(room, "colour")
    x, lights = objective.start(), objective.layout.lighting
    assert lights is not None
    x[lights].reshape(4, 16, 3)[1] = 0
    prior = LightPrior.around(objective, x)
    darkest = 1 / np.sqrt(prior.diagonal.max()) / BAND_SIGMA
    assert darkest == pytest.approx(DIM_SHARE * np.abs(x[lights].reshape(4, 16, 3)[:, 0]).mean())
    x[lights] = 0
    assert LightPrior.around(objective, x).mean[0] == MEAN_RADIANCE  # they may become brighter


def test_grey_lights_cost_nothing_as_to_colour(room: Scene) -> None:
    for kind in FREE_LIGHTS:
        prior = prior_of(objective_of(room, kind), "grey")
        of_one = np.random.default_rng(3).normal(size=prior.mean.size // prior.channels)
        assert prior.cost(np.tile(of_one, prior.channels)) == pytest.approx(0, abs=1e-25)
        if prior.channels > 1:
            assert prior.cost(np.concatenate([of_one, np.tile(0 * of_one, 2)])) > 0


def test_pixels_outweigh_noise_and_nothing_else(room: Scene) -> None:
    objective = objective_of(room, "colour")
    prior = LightPrior.around(objective, objective.start())
    v = np.random.default_rng(4).normal(size=prior.mean.size)
    for weight, noise in ((0.7, 0.2), (0.2, 0.2), (0.1, 0.2)):
        judged = replace(prior.weighing(weight, noise, 50), grey=0.3)
        assert judged.of_pixels(50).weight == pytest.approx(weight)
        assert judged.noise == min(weight, noise)
        for few, many in ((1, 250), (50, 1000)):
            # Of a pixel's squares, many have so many times more; of noise there is no more.
            one, more = judged.of_pixels(few), judged.of_pixels(many)
            of_noise = replace(one, shared=0.0, grey=0.0)
            grown = many / few * (one.product(v) - of_noise.product(v)) + of_noise.product(v)
            np.testing.assert_allclose(more.product(v), grown, rtol=1e-9, atol=1e-12)


def test_a_fit_may_start_in_the_dark(room: Scene) -> None:
    start = truth_of(room).materials, np.zeros((4, 16, 3))
    result = decompose(room, start=start, priors=None, refine_normals="off", uncertainty=False)
    assert result.metrics["recon_rmse"] < 0.02  # of a fit that stays in the dark it is 0.4
