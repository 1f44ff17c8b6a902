"""Distributions of noise with tails: their densities, weights, and which is likeliest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from pbrfit.fit.tails import NORMAL, StudentT, Tails, WithOutliers, likeliest

ALL: list[Tails] = [
    NORMAL,
    StudentT(1.5),
    StudentT(20.0),
    WithOutliers(0.002, 300.0),
    WithOutliers(0.1, 10.0),
]


@pytest.mark.parametrize("tails", ALL, ids=str)
def test_densities_are_of_one(tails: Tails) -> None:
    def density(r: float) -> float:
        return math.exp(-float(tails.deviances(np.array(r * r))) / 2) / math.sqrt(2 * math.pi)

    ends = ((0.0, 8.0), (8.0, 100.0), (100.0, np.inf))
    total = sum(quad(density, low, high, limit=200)[0] for low, high in ends)
    assert 2 * total == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize("tails", ALL, ids=str)
def test_weights_are_the_slopes_of_deviances(tails: Tails) -> None:
    squares = np.array([0.0, 0.3, 2.0, 9.0, 20.0, 80.0, 1e4])
    step = 1e-5 * (1 + squares)
    below = np.maximum(squares - step, 0)
    change = tails.deviances(squares + step) - tails.deviances(below)
    np.testing.assert_allclose(
        tails.weights(squares), change / (squares + step - below), rtol=2e-4, atol=2e-9
    )
    assert tails.weights(np.zeros(1))[0] == pytest.approx(tails.largest_weight, rel=0.02)
    assert np.isfinite(tails.weights(np.array([1e30]))).all()


def test_the_likeliest_is_what_samples_were_drawn_from() -> None:
    rng = np.random.default_rng(2)
    normal = rng.standard_normal(20_000)
    assert likeliest(normal**2).is_normal
    found = likeliest(rng.standard_t(3, 20_000) ** 2)
    assert isinstance(found, StudentT)
    assert found.freedom == 3
    hot = np.where(rng.random(20_000) < 0.004, 100 * normal, normal)
    found = likeliest(hot**2)
    assert isinstance(found, WithOutliers)
    assert found.share == pytest.approx(0.004, rel=0.3)
    assert found.remark().startswith("0.")
    assert "outliers, and weigh next to nothing" in found.remark()
