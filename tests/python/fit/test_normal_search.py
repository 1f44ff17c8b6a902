"""The search for lights and normals on a subset: its starts, and what it keeps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit.fit.normals.noise import degrees_of_freedom, mean_over_median, pixel_sums
from pbrfit.fit.normals.search import explains_more, fit_subset, with_scaled_lights
from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import NORMALS_LIGHT_SCALE_STARTS, NORMALS_MEAN_OVER_MEDIAN_MAX
from pbrfit.synthetic import make_scene
from scene_files import truth_of

Array = NDArray[np.float64]

SCENE = make_scene("room", size=16, lights=8, seed=2002, noise=0.01)
FREE = Objective(SCENE, priors=None, free_normals=True)


def true_x() -> Array:
    """Materials and lights of the scene, and tangent offsets of 0."""
    maps = truth_of(SCENE).materials
    held = Objective(SCENE, priors=None)
    packed = held.pack(maps.albedo, maps.roughness, maps.metallic, truth_of(SCENE).lighting)
    x = FREE.start()
    x[FREE.layout.materials] = packed[held.layout.materials]
    x[FREE.layout.maps.stop :] = packed[held.layout.maps.stop :]
    return x


def unexplained() -> Array:
    """Every other pixel is black, the rest as it is."""
    x = true_x()
    x[FREE.albedo].reshape(3, -1)[:, ::2] = 0
    return x


def started(x: Array, stop: bool = False) -> tuple[Array, int]:
    """What is kept of starts from x without any round, and how many of them did not end well."""
    asked: list[None] = []

    def out_of_time() -> bool:
        asked.append(None)
        return stop

    given = np.asarray(SCENE.normals, np.float64)[SCENE.valid]
    return fit_subset(FREE, x, given, None, out_of_time, rounds=0).x, len(asked)


def test_noise_has_the_mean_that_its_median_asks_for() -> None:
    rng = np.random.default_rng(0)
    sums = rng.chisquare(degrees_of_freedom(FREE), 20_000)
    assert mean_over_median(FREE, sums) == pytest.approx(1, abs=0.02)
    assert mean_over_median(FREE, 1e-9 * sums) == pytest.approx(1, abs=0.02)
    sums[::50] *= 50
    assert mean_over_median(FREE, sums) > NORMALS_MEAN_OVER_MEDIAN_MAX
    assert np.isfinite(mean_over_median(FREE, np.zeros(5)))


def test_a_search_that_explains_all_is_the_only_one() -> None:
    x = true_x()
    found, failed = started(x)
    np.testing.assert_array_equal(found, x)
    assert failed == 0


@pytest.mark.parametrize("factor", NORMALS_LIGHT_SCALE_STARTS[1:])
def test_of_all_starts_the_one_that_explains_most_is_kept(factor: float) -> None:
    x = with_scaled_lights(FREE, true_x(), 1 / factor)
    found, _ = started(x)
    np.testing.assert_array_equal(found, with_scaled_lights(FREE, x, factor))
    sums = pixel_sums(FREE, found)
    for other in NORMALS_LIGHT_SCALE_STARTS:
        assert not explains_more(pixel_sums(FREE, with_scaled_lights(FREE, x, other)), sums)


def test_all_starts_are_tried_while_none_explains_all() -> None:
    assert started(unexplained())[1] == len(NORMALS_LIGHT_SCALE_STARTS)


def test_scaled_lights_leave_all_else() -> None:
    x = true_x()
    found = with_scaled_lights(FREE, x, 2.0)
    assert FREE.lighting is not None
    np.testing.assert_array_equal(found[FREE.lighting], 2 * x[FREE.lighting])
    np.testing.assert_array_equal(found[FREE.albedo], x[FREE.albedo] / 2)
    others = slice(FREE.albedo.stop, FREE.lighting.start)
    np.testing.assert_array_equal(found[others], x[others])


def test_out_of_time_there_is_no_other_start() -> None:
    assert started(unexplained(), stop=True)[1] == 1
