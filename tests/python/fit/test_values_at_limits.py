"""Values at limits take no part in the squares; the other channels of their samples do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pbrfit import decompose
from pbrfit.fit.objective import Objective
from pbrfit.fit.windows import Window, cut
from pbrfit.synthetic import make_scene
from scene_files import known


def test_values_at_limits_do_not_count_and_others_of_their_samples_do() -> None:
    scene = make_scene("room", size=16, lights=4, held_out=1, seed=2, noise=0.01)
    limits = np.zeros(scene.images.shape, np.uint8)
    limits[1, 3, 4, 0], limits[2, 5, 6, 1:] = 1, 2
    bounded, plain = Objective(replace(scene, limits=limits)), Objective(scene)
    assert bounded.samples == bounded.total_weight == plain.samples - 3
    x = plain.start()
    residuals = plain.problem.residuals(x, np.arange(plain.pixels, dtype=np.uint64))
    kept = np.stack([of[scene.valid] for of in limits]) == 0
    squares = np.square(residuals, dtype=np.float64)[kept].sum()
    assert bounded.value_and_grad(x)[0] == pytest.approx(squares / kept.sum(), rel=1e-5)
    part = known(bounded.restricted(np.arange(40, dtype=np.uint64)).sample_weights)
    np.testing.assert_array_equal(part, kept[:, :40])


ONE_WAY: dict[str, Any] = {
    "light": "sh",
    "refine_normals": "off",
    "robust": "none",
    "priors": None,
}


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize(
    ("size", "seeds", "options"),
    [(16, (3,), ONE_WAY), pytest.param(24, (3, 4), {}, marks=pytest.mark.slow)],
)
def test_clipped_pictures_are_fitted_as_whole_ones(
    size: int, seeds: tuple[int, ...], options: dict[str, Any]
) -> None:
    errors = []
    for seed in seeds:
        scene = make_scene("room", size=size, lights=8, held_out=1, seed=seed, noise=0.01)
        highest = np.quantile(scene.images[:, scene.valid], 0.97)
        clipped = replace(scene, images=np.minimum(scene.images, highest))
        taken_as_data = replace(clipped, limits=np.zeros_like(known(clipped.limits)))
        each = [
            decompose(one, uncertainty=False, threads=1, **options)
            for one in (scene, clipped, taken_as_data)
        ]
        errors.append([one.metrics["albedo_rmse"] for one in each])
        values = np.count_nonzero(known(clipped.limits)[:, clipped.valid])
        assert f"{values:,} over- or underexposed values" in each[1].left_out
    whole, found, as_data = np.sum(errors, axis=0)
    assert found < 1.2 * whole
    assert as_data > 1.3 * found


def test_windows_of_a_scene_have_its_limits() -> None:
    scene = make_scene("room", size=16, lights=4, held_out=1, seed=2, noise=0.01)
    limits = np.zeros(scene.images.shape, np.uint8)
    limits[1, 3, 4, 0], limits[:, 9, 9] = 1, 2
    part = cut(replace(scene, limits=limits), Window(slice(2, 12), slice(4, 12)))
    np.testing.assert_array_equal(part.limits, limits[:, 2:12, 4:12])
    assert np.argwhere(~part.valid).tolist() == [[7, 5]]
    assert part.noise_floor(0) is None
