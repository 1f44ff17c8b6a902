"""The one scale of residuals, errors and deviations."""

from __future__ import annotations

import numpy as np

from pbrfit.result.differences import (
    WHITE,
    residual,
)


def test_samples_without_weight_are_white_and_do_not_count_in_the_rms() -> None:
    picture = np.full((1, 3, 3), 2.0)
    picture[0, 2] = np.nan
    weights = np.array([[[1.0] * 3, [0.5, 0.0, 0.0], [0.0] * 3]], dtype=np.float32)
    found, *_ = residual(np.full((1, 3, 3), 3.0), picture, weights)
    np.testing.assert_allclose(found.values, [[0.5, 0.5, 0.0]])
    assert found.white is not None
    assert found.white.tolist() == [[False, False, True]]
    assert found.indices()[0, 2] == WHITE


def test_a_black_picture_has_a_finite_residual() -> None:
    found, *_ = residual(np.full((1, 1, 3), 0.25), np.zeros((1, 1, 3)))
    assert found.values.tolist() == [[0.25]]
