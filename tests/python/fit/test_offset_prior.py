"""The prior on tangent offsets, and which pixels are neighbours in it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit.fit.normals.prior import Neighbourhood, TangentOffsetPrior
from pbrfit.fit.sampling import pixel_index
from pbrfit.fit.settings import NORMALS_OFFSET_SIGMA_ALONE, NORMALS_OFFSET_SIGMA_RANGE
from pbrfit.model.geometry import unit
from pbrfit.values.arrays import Array
from scene_kinds import holed

VARIANCE = 0.7


def around(
    index: NDArray[np.intp], normal_sigma: Array | None = None, bend: float = 0.0
) -> Neighbourhood:
    """Of pixels whose normals are all the same, or bent at random."""
    count = int(index.max()) + 1
    normals = np.array([0.0, 0.0, 1.0]) + bend * np.random.default_rng(3).normal(size=(count, 3))
    return Neighbourhood.of(index, unit(normals), normal_sigma)


@pytest.fixture
def prior() -> TangentOffsetPrior:
    """Of 5 × 6 pixels with holes, bent, some pairs of them half let go."""
    found = around(pixel_index(holed(5, 6)), bend=0.2)
    robust = np.random.default_rng(0).uniform(0.2, 1, len(found.pairs))
    return TangentOffsetPrior(found, sigma=0.15, robust_weights=robust)


def cost_of(prior: TangentOffsetPrior, offsets: Array, variance: float) -> float:
    """The penalty of the module's first formula."""
    first, second = prior.neighbourhood.pairs.T
    weights = prior.neighbourhood.weights
    if prior.robust_weights is not None:
        weights = weights * prior.robust_weights
    pairs = np.square(offsets[first] - offsets[second]).sum(axis=1) @ weights / prior.sigma**2
    alone = np.square(offsets).sum() / NORMALS_OFFSET_SIGMA_ALONE**2
    return float(variance * (pairs + alone))


def test_beside_the_others_a_pixel_has_a_gaussian_prior(prior: TangentOffsetPrior) -> None:
    rng = np.random.default_rng(2)
    offsets = rng.normal(size=(int(prior.neighbourhood.pairs.max()) + 1, 2))
    mean, precision = prior.conditional(offsets, VARIANCE)
    for pixel in range(len(offsets)):
        costs = []
        trials = rng.normal(size=(3, 2))
        for trial in trials:
            moved = offsets.copy()
            moved[pixel] = trial
            costs.append(cost_of(prior, moved, VARIANCE))
        penalty = (precision[pixel] * (trials - mean[pixel]) ** 2).sum(axis=1)
        np.testing.assert_allclose(np.diff(costs), np.diff(penalty), rtol=1e-9, atol=1e-9)


def chain(steps: Array) -> tuple[NDArray[np.intp], Array]:
    """A picture of one row whose neighbours differ by `steps` (P − 1, 2)."""
    return np.arange(len(steps) + 1)[None], np.concatenate([np.zeros((1, 2)), steps.cumsum(axis=0)])


def settled(prior: TangentOffsetPrior, offsets: Array, variances: Array) -> TangentOffsetPrior:
    for _ in range(60):
        prior = prior.fitted(offsets, variances)
    return prior


@pytest.mark.parametrize("degrees", [0.3, 2.0, 8.0])
def test_sigma_of_known_fields_is_found(degrees: float) -> None:
    sigma = np.radians(degrees)
    rng = np.random.default_rng(4)
    index, offsets = chain(sigma * rng.normal(size=(4000, 2)))
    prior = settled(TangentOffsetPrior(around(index)), offsets, np.zeros(len(offsets)))
    assert prior.sigma == pytest.approx(sigma, rel=0.1)


def test_sigma_is_found_from_estimates_that_are_unsure_of_it() -> None:
    """Pairs apart: their means lie too near each other, and their variances say by how much."""
    sigma, noise, pairs = np.radians(4.0), np.radians(3.0), 5000
    rng = np.random.default_rng(5)
    index = np.full((2 * pairs, 2), -1)
    index[::2] = np.arange(2 * pairs).reshape(pairs, 2)
    # A difference of variance σ², seen with variance v: the mean of the rest, and its variance.
    seen = rng.normal(size=(pairs, 2)) * np.hypot(sigma, noise)
    share = sigma**2 / (sigma**2 + noise**2)
    offsets = np.zeros((pairs, 2, 2))
    offsets[:, 1] = share * seen
    # Of both components of a pair; half of it each pixel's.
    variances = np.full(2 * pairs, share * noise**2)
    prior = settled(TangentOffsetPrior(around(index)), offsets.reshape(-1, 2), variances)
    assert prior.sigma == pytest.approx(sigma, rel=0.1)
    sure = settled(TangentOffsetPrior(around(index)), offsets.reshape(-1, 2), np.zeros(2 * pairs))
    assert sure.sigma < 0.9 * sigma


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [
        (0.0, NORMALS_OFFSET_SIGMA_RANGE[0]),
        (1e-4, NORMALS_OFFSET_SIGMA_RANGE[0]),
        (80, NORMALS_OFFSET_SIGMA_RANGE[1]),
    ],
)
def test_sigma_stays_within_its_limits(degrees: float, expected: float) -> None:
    index, offsets = chain(np.radians(degrees) * np.random.default_rng(7).normal(size=(200, 2)))
    assert settled(TangentOffsetPrior(around(index)), offsets, np.zeros(201)).sigma == expected


def test_pixels_without_neighbours_tell_nothing_of_sigma() -> None:
    index = np.array([[0, -1, 1], [-1, 2, -1]])
    prior = TangentOffsetPrior(around(index), sigma=0.11)
    assert len(prior.neighbourhood.pairs) == 0
    offsets = np.ones((3, 2))
    assert prior.fitted(offsets, np.ones(3)).sigma == 0.11
    np.testing.assert_array_equal(prior.conditional(offsets, 1.0)[0], 0)
    assert (prior.conditional(offsets, 1.0)[1] > 0).all()


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
