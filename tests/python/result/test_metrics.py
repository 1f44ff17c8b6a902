"""Errors between arrays: by hand, with NaN left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit.result.metrics import display, psnr, rmse, scaled_per_channel, ssim, white_of

Array = NDArray[np.float64]


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


def test_psnr_by_hand() -> None:
    assert psnr(np.full(4, 0.3), np.full(4, 0.2)) == pytest.approx(20.0)
    assert psnr(np.array([0.5, np.nan]), np.array([0.51, 1.0])) == pytest.approx(40.0)
    assert psnr(np.ones(2), np.ones(2)) == np.inf


def test_display_by_hand() -> None:
    shown = display(np.array([0.0, 0.428, 2.0, 4.0, -1.0]), 2.0)
    np.testing.assert_allclose(shown, [0.0, 0.5, 1.0, 1.0, 0.0], atol=1e-3)
    assert white_of(np.array([*np.linspace(0, 1, 101), np.nan])) == pytest.approx(0.98)
    assert white_of(np.zeros(3)) == 1.0


def ssim_of_pixel(x: Array, y: Array, i: int, j: int) -> float:
    """The definition, one window at a time."""
    weights, a, b = [], [], []
    for u, v in np.ndindex(x.shape):
        if max(abs(u - i), abs(v - j)) <= 5 and not np.isnan(x[u, v] + y[u, v]):
            weights.append(np.exp(-((u - i) ** 2 + (v - j) ** 2) / (2 * 1.5**2)))
            a.append(x[u, v])
            b.append(y[u, v])
    w = np.array(weights) / np.sum(weights)
    mx, my = np.dot(w, a), np.dot(w, b)
    vx, vy = np.dot(w, (np.array(a) - mx) ** 2), np.dot(w, (np.array(b) - my) ** 2)
    cov = np.dot(w, (np.array(a) - mx) * (np.array(b) - my))
    c1, c2 = 1e-4, 9e-4
    return float((2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2)))


@pytest.mark.parametrize("masked", [False, True])
def test_ssim_is_its_definition(masked: bool) -> None:
    x, y = np.random.default_rng(2).uniform(size=(2, 17, 14))
    y = 0.6 * x + 0.4 * y
    if masked:
        x[3:9, 5:] = np.nan
        y[0, 0] = np.nan
    expected = [
        ssim_of_pixel(x, y, i, j) for i, j in np.ndindex(x.shape) if not np.isnan(x[i, j] + y[i, j])
    ]
    assert ssim(x, y) == pytest.approx(np.mean(expected), rel=1e-12)
    channels = ssim(np.stack([x, x], axis=-1), np.stack([y, x], axis=-1))
    assert channels == pytest.approx((np.mean(expected) + 1) / 2, rel=1e-12)


def test_ssim_of_constant_pictures_by_hand() -> None:
    expected = (2 * 0.5 * 0.25 + 1e-4) / (0.5**2 + 0.25**2 + 1e-4)
    assert ssim(np.full((6, 6), 0.5), np.full((6, 6), 0.25)) == pytest.approx(expected)
    assert ssim(np.full((3, 2), 0.5), np.full((3, 2), 0.5)) == pytest.approx(1.0)


def test_ssim_refuses_what_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match=r"one shape, found \(2, 2\) and \(3, 2\)"):
        ssim(np.ones((2, 2)), np.ones((3, 2)))
    with pytest.raises(ValueError, match="at least one pixel"):
        ssim(np.full((2, 2), np.nan), np.ones((2, 2)))
