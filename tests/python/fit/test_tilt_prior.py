"""What is thought likely of changed normals, and the lattice on which it is used."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit.fit.normals.offset_prior import LARGEST_SPREAD, SMALLEST_SPREAD, TiltPrior
from pbrfit.fit.normals.strided_subset import Neighbourhood, lattice, numbered
from pbrfit.fit.parameters import ParameterLayout

Array = NDArray[np.float64]

VARIANCE = 0.7


def layout(valid: NDArray[np.bool_]) -> ParameterLayout:
    known: Any = SimpleNamespace(valid=valid, pixels=int(np.count_nonzero(valid)))
    return known  # type: ignore[no-any-return]


def unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def around(index: NDArray[np.intp], sigma: Array | None = None, bend: float = 0.0) -> Neighbourhood:
    """Of pixels whose normals are all the same, or bent at random."""
    count = int(index.max()) + 1
    normals = np.array([0.0, 0.0, 1.0]) + bend * np.random.default_rng(3).normal(size=(count, 3))
    return Neighbourhood.of(index, unit(normals), sigma)


def holed(height: int, width: int) -> NDArray[np.bool_]:
    valid = np.ones((height, width), bool)
    valid[1, 1:-1] = valid[2:4, 2] = False
    return valid


@pytest.fixture
def prior() -> TiltPrior:
    """Of 5 × 6 pixels with holes, bent, some pairs of them half let go."""
    found = around(numbered(layout(holed(5, 6))), bend=0.2)
    robust = np.random.default_rng(0).uniform(0.2, 1, len(found.pairs))
    return TiltPrior(found, spread=0.15, robust=robust)


def second_differences(prior: TiltPrior) -> Array:
    """Half of the second derivatives of the cost, (P, 2, P, 2): exact, for it is quadratic."""
    count = prior.around.count
    size = 2 * count
    steps = np.eye(size).reshape(size, count, 2)

    def cost(tilts: Array) -> float:
        return prior.cost(tilts, VARIANCE)

    single = np.array([cost(step) for step in steps])
    both = np.array([[cost(one + other) for other in steps] for one in steps])
    half = (both - single[:, None] - single) / 2
    return np.asarray(half.reshape(count, 2, count, 2))


# ------------------------------------------------------------------------------------ derivatives


def test_the_slope_of_the_prior_is_half_of_its_gradient(prior: TiltPrior) -> None:
    tilts = 0.3 * np.random.default_rng(1).normal(size=(prior.around.count, 2))
    found = np.empty_like(tilts)
    for place in np.ndindex(*tilts.shape):
        step = np.zeros_like(tilts)
        step[place] = 0.01
        higher, lower = (prior.cost(tilts + sign * step, VARIANCE) for sign in (1, -1))
        found[place] = (higher - lower) / 0.04
    expected = prior.slope(tilts, VARIANCE)
    np.testing.assert_allclose(expected, found, rtol=0, atol=1e-9 * np.abs(found).max())


def test_diagonal_and_coupling_are_second_derivatives_of_the_prior(prior: TiltPrior) -> None:
    count = prior.around.count
    expected = np.zeros((count, 2, count, 2))
    first, second = prior.around.pairs.T
    for i in range(2):
        expected[np.arange(count), i, np.arange(count), i] = prior.diagonal(VARIANCE)
        expected[first, i, second, i] = prior.coupling(VARIANCE)
        expected[second, i, first, i] = prior.coupling(VARIANCE)
    found = second_differences(prior)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * expected.max())


def test_beside_the_others_a_pixel_feels_the_prior_as_a_pull(prior: TiltPrior) -> None:
    rng = np.random.default_rng(2)
    tilts = rng.normal(size=(prior.around.count, 2))
    centre, precision = prior.beside_others(tilts, VARIANCE)
    for pixel in range(prior.around.count):
        costs = []
        trials = rng.normal(size=(3, 2))
        for trial in trials:
            moved = tilts.copy()
            moved[pixel] = trial
            costs.append(prior.cost(moved, VARIANCE))
        pull = (precision[pixel] * (trials - centre[pixel]) ** 2).sum(axis=1)
        np.testing.assert_allclose(np.diff(costs), np.diff(pull), rtol=1e-9, atol=1e-9)


def test_a_turn_that_all_normals_have_in_common_costs_next_to_nothing() -> None:
    prior = TiltPrior(around(np.arange(100).reshape(10, 10)), spread=np.radians(3.0))
    turned = np.tile(np.radians([10.0, -5.0]), (100, 1))
    scattered = turned * np.random.default_rng(0).choice([-1, 1], size=(100, 1))
    assert 300 * prior.cost(turned, 1.0) < prior.cost(scattered, 1.0)


# ----------------------------------------------------------------------------------------- spread


def chain(steps: Array) -> tuple[NDArray[np.intp], Array]:
    """A picture of one row whose neighbours differ by `steps` (P − 1, 2)."""
    return np.arange(len(steps) + 1)[None], np.concatenate([np.zeros((1, 2)), steps.cumsum(axis=0)])


def settled(prior: TiltPrior, tilts: Array, uncertain: Array) -> TiltPrior:
    for _ in range(60):
        prior = prior.learnt(tilts, uncertain)
    return prior


@pytest.mark.parametrize("degrees", [0.3, 2.0, 8.0])
def test_the_spread_of_known_fields_is_found(degrees: float) -> None:
    spread = np.radians(degrees)
    rng = np.random.default_rng(4)
    index, tilts = chain(spread * rng.normal(size=(4000, 2)))
    prior = settled(TiltPrior(around(index)), tilts, np.zeros(len(tilts)))
    assert prior.spread == pytest.approx(spread, rel=0.1)


def test_the_spread_is_found_from_estimates_that_are_unsure_of_it() -> None:
    """Pairs apart: their means lie too near each other, and their variances say by how much."""
    spread, noise, pairs = np.radians(4.0), np.radians(3.0), 5000
    rng = np.random.default_rng(5)
    index = np.full((2 * pairs, 2), -1)
    index[::2] = np.arange(2 * pairs).reshape(pairs, 2)
    # A difference of variance σ², seen with variance v: the mean of the rest, and its variance.
    seen = rng.normal(size=(pairs, 2)) * np.hypot(spread, noise)
    share = spread**2 / (spread**2 + noise**2)
    tilts = np.zeros((pairs, 2, 2))
    tilts[:, 1] = share * seen
    # Of both components of a pair; half of it each pixel's.
    uncertain = np.full(2 * pairs, share * noise**2)
    prior = settled(TiltPrior(around(index)), tilts.reshape(-1, 2), uncertain)
    assert prior.spread == pytest.approx(spread, rel=0.1)
    sure = settled(TiltPrior(around(index)), tilts.reshape(-1, 2), np.zeros(2 * pairs))
    assert sure.spread < 0.9 * spread


def test_steps_at_a_few_outlines_hardly_widen_the_spread() -> None:
    spread = np.radians(1.0)
    rng = np.random.default_rng(6)
    steps = spread * rng.normal(size=(4000, 2))
    outlines = np.arange(50, 4000, 100)
    steps[outlines] *= 30
    index, tilts = chain(steps)
    prior = settled(TiltPrior(around(index)), tilts, np.zeros(len(tilts)))
    assert np.sqrt(np.mean(steps**2)) > 2.5 * spread
    assert prior.spread == pytest.approx(spread, rel=0.2)
    assert prior.robust is not None
    within = np.delete(prior.robust, outlines)
    assert np.median(prior.robust[outlines]) < 0.1 < 0.5 < within.min()


@pytest.mark.parametrize(
    ("degrees", "expected"), [(0.0, SMALLEST_SPREAD), (1e-4, SMALLEST_SPREAD), (80, LARGEST_SPREAD)]
)
def test_the_spread_stays_within_its_limits(degrees: float, expected: float) -> None:
    index, tilts = chain(np.radians(degrees) * np.random.default_rng(7).normal(size=(200, 2)))
    assert settled(TiltPrior(around(index)), tilts, np.zeros(201)).spread == expected


def test_pixels_without_neighbours_tell_nothing_of_the_spread() -> None:
    index = np.array([[0, -1, 1], [-1, 2, -1]])
    prior = TiltPrior(around(index), spread=0.11)
    assert len(prior.around.pairs) == 0
    tilts = np.ones((3, 2))
    assert prior.learnt(tilts, np.ones(3)).spread == 0.11
    np.testing.assert_array_equal(prior.beside_others(tilts, 1.0)[0], 0)
    assert (prior.diagonal(1.0) > 0).all()


# ---------------------------------------------------------------------------------- neighbourhood


def test_neighbours_across_an_edge_need_not_be_alike() -> None:
    normals = unit(np.array([[0.0, 0, 1], [0.02, 0, 1], [1.0, 0, 0.2], [1.0, 0.02, 0.2]]))
    weights = Neighbourhood.of(np.arange(4)[None], normals, None).weights
    assert weights[0] > 0.99
    assert weights[2] > 0.99
    assert weights[1] < 1e-4


def test_normals_known_to_be_unsure_may_change_more_than_their_neighbours() -> None:
    index = np.arange(6)[None]
    sigma = np.array([2.0, 2, 2, 4, 4, 4])
    plain, known = around(index), around(index, sigma)
    np.testing.assert_allclose(plain.weights, 1.0)
    # Twice as unsure, twice as far: a quarter of the weight.
    assert known.weights[0] == pytest.approx(4 * known.weights[-1])
    assert known.weights[0] > 1 > known.weights[-1]
    # Where all are alike there is nothing to tell, in whatever unit.
    for same in (0.0, 1e-3, 70.0):
        np.testing.assert_allclose(around(index, np.full(6, same)).weights, 1.0)
    # Zero is not for ever: somebody who is sure may be wrong.
    part = around(index, np.array([0.0, 0, 0, 4, 4, 4])).weights
    assert np.isfinite(part).all()
    assert part[0] <= 1000


# ---------------------------------------------------------------------------------------- lattice


def where(valid: NDArray[np.bool_]) -> tuple[Array, Array]:
    return np.nonzero(valid)  # type: ignore[return-value]


def check_lattice(valid: NDArray[np.bool_], at_most: int) -> tuple[int, int]:
    """The lattice's pixels lie where its index says, all that are there; how many, and its step."""
    pixels, index = lattice(layout(valid), at_most)
    assert pixels.dtype == np.uint64
    assert np.all(np.diff(pixels.astype(int)) > 0)
    np.testing.assert_array_equal(np.sort(index[index >= 0]), np.arange(len(pixels)))
    rows, columns = (of_all[pixels.astype(int)] for of_all in where(valid))
    i, j = np.nonzero(index >= 0)
    order = index[i, j]
    steps = []
    for place, of_lattice in ((rows[order], i), (columns[order], j)):
        places = {int(k): set(place[of_lattice == k]) for k in np.unique(of_lattice)}
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


def test_a_lattice_of_more_pixels_than_there_are_is_all_of_them() -> None:
    for valid in (holed(7, 9), np.ones((1, 1), bool), np.ones((1, 5), bool), holed(6, 4)):
        assert check_lattice(valid, 1024) == (int(np.count_nonzero(valid)), 1)


def test_a_lattice_keeps_clear_of_holes() -> None:
    valid = np.ones((60, 80), bool)
    valid[10:30, 15:50] = valid[40:, :20] = False
    count, step = check_lattice(valid, 256)
    assert step == 4
    assert 200 <= count <= 300


@pytest.mark.parametrize("shape", [(1, 5000), (5000, 1), (2, 3000), (700, 4)])
def test_a_lattice_of_a_long_picture_has_no_more_pixels_than_others(shape: tuple[int, int]) -> None:
    count, _ = check_lattice(np.ones(shape, bool), 256)
    assert 100 <= count <= 320


def test_a_mask_with_a_pattern_of_its_own_still_has_pixels_on_the_lattice() -> None:
    rows = np.arange(64)[:, None] + np.zeros(64, int)
    for valid in (rows % 2 == 0, rows.T % 2 == 0, (rows % 8 == 0) | (rows.T % 8 == 3)):
        count, _ = check_lattice(valid, 256)
        assert 50 <= count <= 320
