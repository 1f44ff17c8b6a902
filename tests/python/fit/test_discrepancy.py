"""What samples are off by: noise, what neighbours share; how much pixels tell together."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

import scene_kinds
from pbrfit.fit import discrepancy, settings
from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors import posterior
from pbrfit.fit.priors.population import population
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from scene_files import truth_of


def at_truth(scene: Scene) -> Discrepancy:
    """Under the true lights of a scene."""
    objective = Objective(scene)
    return discrepancy.find(objective, scene_kinds.at_truth(objective, scene))


def room(noise: float) -> Scene:
    return make_scene("room", size=24, lights=8, held_out=1, noise=noise, seed=2011)


def test_noise_is_shared_by_no_neighbours() -> None:
    found = at_truth(room(0.01))
    assert found.misfit == 0
    assert found.of_pixel == pytest.approx(settings.SAMPLE_USES * found.variance)
    assert found.effective_share == pytest.approx(1 / settings.SAMPLE_USES)


def test_what_the_model_has_not_is_shared() -> None:
    scene = room(0.002)
    dark = np.ones((24, 24, 1))
    dark[6:18, 6:18] = 0.6  # a shadow, of half of the pictures
    images = scene.images.copy()
    images[::2] *= dark
    clean, shadowed = at_truth(scene), at_truth(dataclasses.replace(scene, images=images))
    assert clean.misfit == 0
    assert shadowed.misfit > 0.02
    assert shadowed.pooling.tempering > 3 * clean.pooling.tempering


def test_known_lights_share_nothing_and_others_do() -> None:
    scene = room(0.01)
    assert at_truth(scene).light_share > 0
    known = at_truth(dataclasses.replace(scene, lighting=truth_of(scene).lighting))
    assert known.light_share == 0
    assert len(known.modes) == 0


def test_surfaces_are_mostly_dielectric_and_seldom_mirrors() -> None:
    roughness, metallic = (of.ravel() for of in np.meshgrid(np.linspace(0.03, 1, 33), [0, 0.5, 1]))
    found = population(roughness, metallic)
    assert found.sum() == pytest.approx(1, rel=1e-5)
    assert found[metallic == 0].sum() == pytest.approx(0.72, abs=1e-5)
    assert found[metallic == 1].sum() == pytest.approx(0.2, abs=1e-5)
    assert found[roughness < 0.1].sum() < 0.05
    assert (found * roughness).sum() == pytest.approx(0.5, abs=0.02)


def test_pixels_that_share_an_error_leave_more_to_the_prior() -> None:
    """A thousand pixels that say the same are one, where nothing of what they say is their own."""
    nodes = np.linspace(0, 1, 21)
    one = np.exp(-((nodes - 0.8) ** 2) / (2 * 0.1**2)).astype(np.float32)
    likelihood = np.repeat(one[None], 1000, axis=0)
    prior = np.full(21, 1 / 21, np.float32)
    alone, sharing = (
        posterior.mixture_of(
            likelihood, prior, posterior.Pooling(light_share=share).prior_pixels(1000)
        )
        for share in (0.0, 1.0)
    )

    def spread(of: NDArray[np.float32]) -> float:
        return float(np.sqrt((of * nodes**2).sum() - (of * nodes).sum() ** 2))

    assert spread(alone) < 0.1 < spread(sharing)
    assert posterior.Pooling(channels=1).prior_pixels(10) == 3 * posterior.Pooling().prior_pixels(
        10
    )
