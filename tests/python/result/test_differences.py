"""The one scale of residuals, errors and deviations."""

from __future__ import annotations

import numpy as np
import pytest

from pbrfit.result.differences import (
    OUTSIDE,
    SCALE,
    STEPS,
    TICKS,
    VERMILLION,
    WHITE,
    Difference,
    on_scale,
    palette,
    residual,
)


def test_the_scale_is_logarithmic_and_ends_where_it_says() -> None:
    low, high = SCALE
    assert on_scale(low) == 0.0
    assert on_scale(high) == 1.0
    assert on_scale(np.sqrt(low * high)) == pytest.approx(0.5)
    np.testing.assert_array_equal(on_scale(np.array([0.0, 7.0])), [0.0, 1.0])
    assert min(TICKS) == low
    assert max(TICKS) == high


def test_colours_of_values_of_marks_and_of_what_is_outside() -> None:
    values = np.array([[0.0, 0.001, 1.0, np.nan], [0.5, 0.5, np.nan, 2.0]])
    white, vermillion = np.zeros((2, *values.shape), bool)
    white[1, 0] = vermillion[1, 1] = True
    vermillion[1, 2] = True  # outside all the same
    found = Difference(values, white, vermillion).indices()
    assert found.tolist() == [[0, 0, STEPS - 1, OUTSIDE], [WHITE, VERMILLION, OUTSIDE, STEPS - 1]]
    assert palette()[WHITE].tolist() == [1.0, 1.0, 1.0]
    assert len(palette()) == OUTSIDE + 1


def test_samples_without_weight_are_white_and_do_not_count_in_the_rms() -> None:
    picture = np.full((1, 3, 3), 2.0)
    picture[0, 2] = np.nan
    weights = np.array([[[1.0] * 3, [0.5, 0.0, 0.0], [0.0] * 3]], dtype=np.float32)
    found = residual(np.full((1, 3, 3), 3.0), picture, weights)
    np.testing.assert_allclose(found.values, [[0.5, 0.5, 0.0]])
    assert found.white is not None
    assert found.white.tolist() == [[False, False, True]]
    assert found.indices()[0, 2] == WHITE


def test_a_black_picture_has_a_finite_residual() -> None:
    found = residual(np.full((1, 1, 3), 0.25), np.zeros((1, 1, 3)))
    assert found.values.tolist() == [[0.25]]
