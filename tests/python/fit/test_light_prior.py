"""The prior on lights: its matrix, product, cost and gradient are those of one quadratic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit import Objective, Scene, decompose
from pbrfit.fit.light_prior import BAND_SIGMA, SCALE_SIGMA, LightPrior
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


def test_a_fit_may_start_in_the_dark(room: Scene) -> None:
    start = truth_of(room).materials, np.zeros((4, 16, 3))
    result = decompose(room, start=start, priors=None, refine_normals="off", uncertainty=False)
    assert result.metrics["recon_rmse"] < 0.02  # of a fit that stays in the dark it is 0.4
