"""PSNR and SSIM beside their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit_evaluation.similarity import psnr, ssim

Array = NDArray[np.float64]


def test_psnr_by_hand() -> None:
    assert psnr(np.full(4, 0.3), np.full(4, 0.2)) == pytest.approx(20.0)
    assert psnr(np.array([0.5, np.nan]), np.array([0.51, 1.0])) == pytest.approx(40.0)
    assert psnr(np.ones(2), np.ones(2)) == np.inf


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
