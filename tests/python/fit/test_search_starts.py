"""The search for lights and normals on a lattice: when it starts again, and what it then keeps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit.fit.normals import search
from pbrfit.fit.normals.joint_step import State
from pbrfit.fit.normals.noise import degrees_of_freedom, mean_over_median
from pbrfit.fit.objective import Objective
from pbrfit.synthetic import make_scene

Array = NDArray[np.float64]

SCENE = make_scene("room", size=16, lights=8, seed=2002, noise=0.01)
FREE = Objective(SCENE, priors=None, free_normals=True)


def true_x() -> Array:
    """Materials and lights of the scene, and no tilts."""
    assert SCENE.truth is not None
    maps = SCENE.truth.materials
    held = Objective(SCENE, priors=None)
    packed = held.pack(maps.albedo, maps.roughness, maps.metallic, SCENE.truth.lighting)
    x = FREE.start()
    x[FREE.layout.materials] = packed[held.layout.materials]
    x[FREE.layout.maps.stop :] = packed[held.layout.maps.stop :]
    return x


def unexplained() -> Array:
    """Where every other pixel is black, the rest as it is."""
    x = true_x()
    x[FREE.albedo].reshape(3, -1)[:, ::2] = 0
    return x


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """Where searches began; none of them goes anywhere."""
    starts: list[Array] = []

    def stay(_: Objective, prior: Any, x: Array, *__: Any) -> Any:
        starts.append(x.copy())
        return SimpleNamespace(state=State(x, np.zeros((1, 2))), prior=prior)

    monkeypatch.setattr(search, "_searched", stay)
    return starts


def find(x: Array, stop: bool = False) -> search.Found:
    given = np.asarray(SCENE.normals, np.float64)[SCENE.valid]
    return search.find(FREE, x, given, None, lambda: stop)


def test_noise_has_the_mean_that_its_median_asks_for() -> None:
    rng = np.random.default_rng(0)
    squares = rng.chisquare(degrees_of_freedom(FREE), 20_000)
    assert mean_over_median(FREE, squares) == pytest.approx(1, abs=0.02)
    assert mean_over_median(FREE, 1e-9 * squares) == pytest.approx(1, abs=0.02)
    squares[::50] *= 50
    assert mean_over_median(FREE, squares) > search.WELL
    assert np.isfinite(mean_over_median(FREE, np.zeros(5)))


def test_a_search_that_explains_all_is_the_only_one(begun: list[Array]) -> None:
    x = true_x()
    found = find(x)
    assert len(begun) == 1
    np.testing.assert_array_equal(begun[0], x)
    np.testing.assert_array_equal(found.x, x)


def test_one_that_does_not_starts_again_from_brighter_lights(begun: list[Array]) -> None:
    x = unexplained()
    find(x)
    assert FREE.lighting is not None
    factors = [np.median(start[FREE.lighting] / x[FREE.lighting]) for start in begun]
    np.testing.assert_allclose(factors, search.STARTS)
    for start, factor in zip(begun, factors, strict=True):
        np.testing.assert_allclose(start[FREE.albedo], np.clip(x[FREE.albedo] / factor, 0, 1))
        others = slice(FREE.albedo.stop, FREE.lighting.start)
        np.testing.assert_array_equal(start[others], x[others])


def test_what_explains_most_is_kept(monkeypatch: pytest.MonkeyPatch, begun: list[Array]) -> None:
    stay = search._searched
    truth, x = true_x(), unexplained()

    def second_is_right(few: Objective, prior: Any, start: Array, *others: Any) -> Any:
        return stay(few, prior, truth if len(begun) == 1 else start, *others)

    monkeypatch.setattr(search, "_searched", second_is_right)
    np.testing.assert_array_equal(find(x).x, truth)
    assert len(begun) == 2
    begun.clear()
    monkeypatch.setattr(search, "WELL", 0.0)
    np.testing.assert_array_equal(find(x).x, truth)
    assert len(begun) == len(search.STARTS)


def test_out_of_time_there_is_no_other(begun: list[Array]) -> None:
    find(unexplained(), stop=True)
    assert len(begun) == 1
