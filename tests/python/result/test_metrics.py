"""Errors between arrays: by hand, with NaN left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pbrfit.result.metrics import rmse, scaled_per_channel

FOUND, TRUE = [[1.0, 2.0], [3.0, 9.0]], [[2.0, 4.0], [6.0, 9.0]]
SKEWED = [[1.0, 2.0], [0.5, 4.0]]
INF = np.inf


@pytest.mark.parametrize(
    ("found", "true", "weights", "expected"),
    [
        ([1.0, 2.0], [4.0, 6.0], None, 12.5),
        ([1.0, 1.0], [1.0, 1.0], None, 0.0),
        ([1.0, np.nan, 3.0, 5.0], [2.0, 1.0, np.nan, 5.0], None, 0.5),  # in neither
        (np.full(10, 1e-30, np.float32), np.zeros(10), None, 1e-60),  # which float32 cannot hold
        (FOUND, TRUE, SKEWED, (1 * 1 + 2 * 4 + 0.5 * 9) / 7.5),
        (FOUND, TRUE, [[1.0], [0.0]], 2.5),
        (FOUND, TRUE, np.full((2, 2), 0.3), 3.5),
        ([1.0, INF, np.nan, 3.0], [2.0, INF, 0.0, INF], [1.0, 0.0, 0.0, 0.0], 1.0),
    ],
)
def test_rmse_by_hand(found: Any, true: Any, weights: Any, expected: float) -> None:
    given = None if weights is None else np.asarray(weights)
    of = rmse(np.asarray(found), np.asarray(true), given)
    assert of == pytest.approx(np.sqrt(expected), rel=1e-6, abs=0)


def test_rmse_refuses_what_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match=r"equal shapes, found \(2,\) and \(3,\)"):
        rmse(np.ones(2), np.ones(3))
    with pytest.raises(ValueError, match="at least one entry"):
        rmse(np.array([np.nan]), np.ones(1))
    with pytest.raises(ValueError, match="at least one entry"):
        rmse(np.zeros(2), np.array([np.nan, 1.0]), np.array([1.0, 0.0]))


def test_the_best_scale_is_least_squares() -> None:
    rng = np.random.default_rng(1)
    found, true = rng.uniform(size=(2, 30, 3))
    best = rmse(scaled_per_channel(found, true), true)
    for factor in (0.99, 1.01):
        assert best < rmse(factor * scaled_per_channel(found, true), true)


def test_the_best_scale_of_a_black_map_is_one() -> None:
    np.testing.assert_array_equal(scaled_per_channel(np.zeros((2, 3)), np.ones((2, 3))), 0.0)
