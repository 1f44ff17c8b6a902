"""How far residuals are from independent noise, by planted noise and planted misfit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import Objective, Scene
from pbrfit.fit import misfit, settings
from pbrfit.fit.coarse import judged
from pbrfit.fit.misfit import Misfit
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from scene_kinds import at_truth

NOISE = 0.01


def room(seed: int = 1, size: int = 32, noise: float = NOISE) -> Scene:
    return make_scene("room", size=size, lights=8, noise=noise, seed=seed, held_out=1)


def with_pattern(scene: Scene) -> Scene:
    """Squares of 4 × 4 pixels are brighter in every other picture, or darker, and by turns."""
    rng = np.random.default_rng(0)
    side = scene.normals.shape[0] // 4
    squares = np.kron(rng.normal(size=(side, side)), np.ones((4, 4)))
    signs = (-1.0) ** np.arange(len(scene.images))
    pattern = 5 * NOISE * signs[:, None, None] * squares
    return replace(scene, images=scene.images + pattern[..., None].astype(np.float32))


def left_at_truth(scene: Scene) -> Misfit:
    """Under the lights of the truth."""
    objective = Objective(scene)
    return judged(objective, at_truth(objective, scene)).misfit


@pytest.mark.parametrize("size", [32, 64])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_is_independent(seed: int, size: int) -> None:
    scene = room(seed, size)
    left = left_at_truth(scene)
    assert left.variance == pytest.approx((NOISE / Objective(scene).scale) ** 2, rel=0.1)
    assert left.independent_share > 0.95
    assert 0.5 < left.design_effect < 1.2
    assert left.of_likelihood == pytest.approx(left.of_camera, rel=0.05)


def test_what_neighbours_and_pictures_share_is_not_independent() -> None:
    left = left_at_truth(with_pattern(room(size=64)))
    assert left.independent_share < 0.5
    assert left.design_effect > 2
    assert left.of_likelihood > 2 * left.variance


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_wrong_field_of_view_is_no_noise(seed: int) -> None:
    assert left_at_truth(replace(room(seed), fov=90.0)).design_effect > 2


def test_where_nothing_is_left_nothing_is_divided_by(monkeypatch: pytest.MonkeyPatch) -> None:
    left = left_at_truth(room(size=16, noise=0.0))
    assert settings.NOISE_VARIANCE_MIN <= left.variance < 1e-13
    assert np.isfinite([left.design_effect, left.of_likelihood]).all()
    assert 0 < left.independent_share <= 1

    class Exact:
        def residuals(self, _: Array, pixels: NDArray[np.uint64]) -> NDArray[np.float32]:
            return np.zeros((8, len(pixels), 3), np.float32)

    objective = Objective(room(size=16))
    x = objective.start()
    assert misfit.variance(objective, np.zeros(256)) == settings.NOISE_VARIANCE_MIN
    monkeypatch.setattr(objective, "problem", Exact())
    assert misfit.independent_share(objective, x) == 1
