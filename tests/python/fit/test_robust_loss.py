"""The scale of robust losses from residuals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from pbrfit.fit.robust import CAUCHY_SCALE, noise_sigma


def test_the_scale_is_95_percent_efficient() -> None:
    """E[φ'']² / E[φ'²] by quadrature over a normal distribution; φ'' by differences of φ'."""
    e, width = np.linspace(-12, 12, 2_400_001, retstep=True)
    density = np.exp(-(e**2) / 2) / np.sqrt(2 * np.pi) * width
    slope = reference.cauchy(CAUCHY_SCALE)(e)[1]
    curvature = np.gradient(slope, width)
    efficiency = (curvature @ density) ** 2 / (slope**2 @ density)
    assert efficiency == pytest.approx(0.95, abs=1e-4)


def noise(outliers: float = 0.0, seed: int = 0) -> NDArray[np.float64]:
    """Residuals of σ = 0.02, of which a share are larger by 0.5."""
    rng = np.random.default_rng(seed)
    e = rng.normal(0, 0.02, (8, 2_000, 3))
    return e + 0.5 * (rng.random(e.shape) < outliers)


def test_sigma_of_noise_with_outliers() -> None:
    """The median of 90 % noise is that of all at 0.5/0.9: the 0.778 quantile, 13 % above."""
    with_outliers = noise(0.1)
    assert noise_sigma(with_outliers) == pytest.approx(1.135 * 0.02, rel=0.02)
    assert np.sqrt(np.mean(with_outliers**2)) > 0.1


def test_sigma_makes_up_for_what_the_fit_took() -> None:
    """Residuals of a straight line through five points a pixel: two unknowns of five samples."""
    rng = np.random.default_rng(1)
    samples = rng.normal(0, 0.02, (5, 4_000))
    design = np.stack([np.ones(5), np.arange(5)], axis=1)
    residuals = samples - design @ np.linalg.lstsq(design, samples, rcond=None)[0]
    sigma = noise_sigma(residuals[..., None], unknowns=2 * 4_000)
    # Points at the ends pull the line more: the five residuals differ in variance.
    assert sigma == pytest.approx(0.02, rel=0.05)
    assert noise_sigma(residuals[..., None]) < 0.8 * sigma


def test_sigma_of_weighted_samples() -> None:
    residuals = noise()
    weights = np.zeros((*residuals.shape[:2], 1))
    weights[2:5, 100:900] = 0.7
    assert noise_sigma(residuals, weights, unknowns=100) == pytest.approx(
        noise_sigma(residuals[2:5, 100:900], unknowns=100), rel=1e-12
    )
    weights = weights * [1.0, 0.0, 1.0]
    assert noise_sigma(residuals, weights, unknowns=100) == pytest.approx(
        noise_sigma(residuals[2:5, 100:900, ::2], unknowns=100), rel=1e-12
    )
