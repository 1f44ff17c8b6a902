"""Errors between arrays: by hand, with NaN left out."""

from __future__ import annotations

import numpy as np
import pytest

from pbrfit.metrics import rmse, scaled_per_channel


def test_rmse_by_hand() -> None:
    assert rmse(np.array([1.0, 2.0]), np.array([4.0, 6.0])) == pytest.approx(np.sqrt(12.5))
    assert rmse(np.ones(3), np.ones(3)) == 0.0


def test_rmse_leaves_out_what_is_nan_in_either() -> None:
    found = np.array([1.0, np.nan, 3.0, 5.0])
    assert rmse(found, np.array([2.0, 1.0, np.nan, 5.0])) == pytest.approx(np.sqrt(0.5))


def test_rmse_in_float64() -> None:
    found = np.full(10, 1e-30, dtype=np.float32)  # whose square float32 cannot hold
    assert rmse(found, np.zeros(10)) == pytest.approx(1e-30)


def test_rmse_with_weights_by_hand() -> None:
    found, true = np.array([[1.0, 2.0], [3.0, 9.0]]), np.array([[2.0, 4.0], [6.0, 9.0]])
    assert rmse(found, true, np.array([[1.0, 2.0], [0.5, 4.0]])) == pytest.approx(
        np.sqrt((1 * 1 + 2 * 4 + 0.5 * 9) / 7.5)
    )
    assert rmse(found, true, np.array([[1.0], [0.0]])) == pytest.approx(np.sqrt(2.5))
    assert rmse(found, true, np.full((2, 2), 0.3)) == pytest.approx(rmse(found, true))


def test_entries_of_weight_zero_may_be_anything() -> None:
    found, true = np.array([1.0, np.inf, np.nan, 3.0]), np.array([2.0, np.inf, 0.0, np.inf])
    assert rmse(found, true, np.array([1.0, 0.0, 0.0, 0.0])) == 1.0


def test_rmse_refuses_what_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match=r"equal shapes, found \(2,\) and \(3,\)"):
        rmse(np.ones(2), np.ones(3))
    with pytest.raises(ValueError, match="at least one entry"):
        rmse(np.array([np.nan]), np.ones(1))
    with pytest.raises(ValueError, match="at least one entry"):
        rmse(np.zeros(2), np.array([np.nan, 1.0]), np.array([1.0, 0.0]))


def test_the_best_scale_undoes_a_scale_by_channel() -> None:
    true = np.random.default_rng(0).uniform(size=(4, 5, 3))
    found = true / [2.0, 3.0, 0.5]
    found[1, 2] = np.nan
    scaled = scaled_per_channel(found, true)
    assert np.isnan(scaled[1, 2]).all()
    assert rmse(scaled, true) <= 1e-15
    assert found[0, 0, 0] == true[0, 0, 0] / 2  # not changed in place


def test_the_best_scale_is_least_squares() -> None:
    rng = np.random.default_rng(1)
    found, true = rng.uniform(size=(2, 30, 3))
    best = rmse(scaled_per_channel(found, true), true)
    for factor in (0.99, 1.01):
        assert best < rmse(factor * scaled_per_channel(found, true), true)


def test_the_best_scale_of_a_black_map_is_one() -> None:
    np.testing.assert_array_equal(scaled_per_channel(np.zeros((2, 3)), np.ones((2, 3))), 0.0)
