"""Levels: strided subsets and even shares of the pixels, and the objective of these alone."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import Objective, Scene, decompose
from pbrfit.fit import settings
from pbrfit.fit.levels import Level
from pbrfit.fit.pixels import taken
from pbrfit.fit.sampling import evenly_spaced, evenly_spaced_over
from pbrfit.fit.settings import PATCH_SIDE
from pbrfit.model.reflection import MODELS, Model
from pbrfit.synthetic import make_scene
from scene_kinds import FREE_LIGHTS, all_pixels, holed, of_kind, sum_sq_at


@pytest.fixture(scope="module")
def noisy() -> Scene:
    return make_scene("room", size=24, lights=8, noise=0.01, seed=2001, held_out=2)


def level_of(valid: NDArray[np.bool_], at_most: int) -> Level:
    whole: Any = SimpleNamespace(layout=SimpleNamespace(valid=valid), restricted=lambda _: None)
    return Level.of(whole, at_most)


def check_subset(valid: NDArray[np.bool_], at_most: int) -> tuple[int, int]:
    """The subset's pixels lie where its index says, all that are there; how many, and its step."""
    level = level_of(valid, at_most)
    pixels, index = level.pixels, level.index
    assert pixels.dtype == np.uint64
    assert np.all(np.diff(pixels.astype(int)) > 0)
    np.testing.assert_array_equal(np.sort(index[index >= 0]), np.arange(len(pixels)))
    rows, columns = (of_all[pixels.astype(int)] for of_all in np.nonzero(valid))
    i, j = np.nonzero(index >= 0)
    order = index[i, j]
    steps = []
    for place, at in ((rows[order], i), (columns[order], j)):
        places = {int(k): set(place[at == k]) for k in np.unique(at)}
        assert all(len(found) == 1 for found in places.values())
        known = sorted((k, found.pop()) for k, found in places.items())
        steps += [(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(known)]
    assert len(set(steps)) <= 1
    step = int(steps[0]) if steps else 1
    first = rows[order[0]] - step * i[0], columns[order[0]] - step * j[0]
    there = np.zeros_like(valid)
    there[first[0] :: step, first[1] :: step] = True
    assert np.count_nonzero(there & valid) == len(pixels)
    return len(pixels), step


def test_a_subset_of_more_pixels_than_there_are_is_all_of_them() -> None:
    for valid in (holed(7, 9), np.ones((1, 1), bool), np.ones((1, 5), bool), holed(6, 4)):
        assert check_subset(valid, 1024) == (int(np.count_nonzero(valid)), 1)


def test_a_subset_with_holes_or_of_a_long_picture_has_no_more_pixels_than_others() -> None:
    valid = np.ones((60, 80), bool)
    valid[10:30, 15:50] = valid[40:, :20] = False
    assert check_subset(valid, 256)[1] == 4
    for one in (valid, *(np.ones(size, bool) for size in [(1, 5000), (5000, 1), (700, 4)])):
        assert 100 <= check_subset(one, 256)[0] <= 320


@pytest.mark.parametrize(("height", "width"), [(32, 32), (20, 37), (8, 8), (3, 50)])
def test_patches_are_squares_that_cover_a_level_once(height: int, width: int) -> None:
    valid = holed(height, width) if height > 4 else np.ones((height, width), bool)
    level = level_of(valid, 10**6)
    patches = level.patches()
    assert len(patches) == -(-height // PATCH_SIDE) * -(-width // PATCH_SIDE)
    np.testing.assert_array_equal(np.sort(np.concatenate(patches)), np.arange(len(level.pixels)))
    places = np.stack([*np.nonzero(level.index >= 0)])
    for patch in patches:
        assert (np.diff(patch.astype(int)) > 0).all()
        here = places[:, patch.astype(int)] // PATCH_SIDE
        assert (here == here[:, :1]).all()


@pytest.mark.parametrize("count", [0, 5, 19_999, 20_000, 20_001, 23_456, 1 << 20])
def test_evenly_spaced_indices_are_distinct_and_favour_no_column(count: int) -> None:
    most = 20_000
    chosen = evenly_spaced(count, most)
    assert chosen.dtype == np.uint64
    assert len(chosen) == min(count, most)
    # They rise, and no more than two pieces lie between neighbours.
    gaps = np.diff(chosen.astype(np.int64), prepend=-1, append=count)
    assert gaps.min() > 0
    assert gaps.max() <= 2 * -(-count // max(len(chosen), 1)) + 1
    if count == 1 << 20:
        columns = np.bincount(chosen.astype(np.int64) % 1024, minlength=1024)
        assert columns.min() >= 10  # 19.5 on average
        assert columns.max() <= 30


def test_evenly_spaced_over_labels() -> None:
    labels = np.zeros(10_000, np.intp)
    labels[5000:5040] = 1
    labels[9000:9003] = 2
    chosen = evenly_spaced_over(labels, 400)
    assert len(chosen) == 400
    assert len(np.unique(chosen)) == 400
    of_labels = labels[chosen.astype(np.intp)]
    assert (of_labels == 2).sum() == 3
    assert (of_labels == 1).sum() >= 40
    np.testing.assert_array_equal(evenly_spaced_over(labels, 10**5), np.arange(10_000))
    assert len(evenly_spaced_over(np.arange(1000), 100)) == 100


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("free_normals", [False, True])
@pytest.mark.parametrize("kind", FREE_LIGHTS)
def test_the_objective_of_some_pixels_is_a_part_of_the_whole_one(
    noisy: Scene, kind: str, free_normals: bool, model: Model
) -> None:
    scene, options = of_kind(noisy, kind)
    objective = Objective(scene, **options, free_normals=free_normals, model=model)
    rng = np.random.default_rng(1)
    chosen = np.sort(rng.permutation(objective.pixels)[:100]).astype(np.uint64)
    x = objective.start()
    x[objective.layout.maps] = rng.uniform(0, 1, objective.layout.maps.stop)
    few, part = objective.restricted(chosen), objective.part_of(x, chosen)
    assert few.size == len(part)
    assert (few.pixels, few.model) == (100, model)
    np.testing.assert_array_equal(taken(few, part, slice(None)), taken(objective, x, chosen))
    np.testing.assert_array_equal(part[few.layout.lighting], x[objective.layout.lighting])
    np.testing.assert_array_equal(few.normals(part), objective.normals(x)[chosen.astype(int)])
    for one, other in zip(
        few.problem.normal_equations(few.for_core(part), all_pixels(few)),
        objective.problem.normal_equations(objective.for_core(x), chosen),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())
    # The same units: a mean over pixels whose weights are a share of all.
    loss = few.data_value_and_grad(part)[0]
    assert few.total_weight == pytest.approx(objective.total_weight * 100 / objective.pixels)
    if objective.weights is None:
        total = sum_sq_at(objective, x)[chosen].sum()
        assert loss == pytest.approx(total / few.total_weight, rel=1e-5)
    again = objective.start()
    objective.put_part(again, chosen, part)
    np.testing.assert_array_equal(taken(objective, again, chosen), taken(objective, x, chosen))


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_lights_of_a_level_serve_all_pixels(noise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted scenes stay exact, and of noisy ones hardly more is left than by those of all."""
    scene = make_scene("room", size=64, lights=8, noise=noise, seed=2001, held_out=2)
    left = []
    for few in (settings.LIGHTS_PIXELS, 1500):
        monkeypatch.setattr(settings, "LIGHTS_PIXELS", few)
        left.append(decompose(scene, priors=None, refine_normals="off").metrics["recon_rmse"])
    assert left[1] < 1.02 * left[0] + 1e-12
    assert noise or max(left) < 1e-12
