"""Robust losses in the core, and their scale from residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from finite_differences import ridders
from pbrfit import InputError, _core
from pbrfit.fit.robust import SCALES, loss_scale, noise_sigma, weighted_median

PIXELS, PICTURES = 40, 5
LOSSES: dict[str, Callable[[float], reference.Loss]] = {
    "huber": reference.huber,
    "cauchy": reference.cauchy,
}


@dataclass(frozen=True)
class Case:
    """Pictures that a point x explains but for noise and, in a tenth of the samples, shadows."""

    images: NDArray[np.float32]
    normals: NDArray[np.float64]
    views: NDArray[np.float64]
    x: NDArray[np.float64]
    weights: NDArray[np.float32]

    def core(self, weighted: bool = True) -> _core.Problem:
        weights = self.weights if weighted else None
        return _core.Problem(self.images, self.normals, self.views, 1, weights=weights)

    def residuals(self) -> NDArray[np.float64]:
        rendered = reference.render(self.normals, self.views, self.x)
        return np.asarray(rendered - self.images, dtype=np.float64)


@pytest.fixture(scope="module")
def case() -> Case:
    rng = np.random.default_rng(8)
    normals = reference.unit(rng.normal((0, 0, 2), 1.0, (PIXELS, 3)))
    views = reference.unit(rng.normal((0, 0, 1), 0.3, (PIXELS, 3)))
    maps = rng.uniform(0.1, 0.9, 5 * PIXELS)
    lights = rng.normal(0, 0.2, (PICTURES, 16, 3)) + np.eye(16)[:1, :, None] * 1.5
    x = np.concatenate([maps, lights.ravel()])
    images = reference.render(normals, views, x)
    images *= np.where(rng.random(images.shape) < 0.1, 0.3, 1.0)
    images += rng.normal(0, 0.02, images.shape)
    weights = rng.uniform(0, 1, (PICTURES, PIXELS))
    weights[rng.random(weights.shape) < 0.1] = 0
    return Case(images.astype(np.float32), normals, views, x, weights.astype(np.float32))


def assert_agrees(case: Case, name: str, scale: float, weighted: bool = True) -> None:
    loss, gradient = case.core(weighted).value_and_grad(case.x, (name, scale))
    weights = case.weights[..., None] if weighted else None
    expected, expected_gradient = reference.value_and_grad(
        case.images, case.normals, case.views, case.x, weights, LOSSES[name](scale)
    )
    assert loss == pytest.approx(expected, rel=1e-6)
    for part in reference.Unknowns(PIXELS, PICTURES).blocks.values():
        off = np.linalg.norm(gradient[part] - expected_gradient[part])
        assert off < 1e-5 * np.linalg.norm(expected_gradient[part])


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("scale", [0.003, 0.03, 100.0])
@pytest.mark.parametrize("name", LOSSES)
def test_core_agrees_with_reference(case: Case, name: str, scale: float, weighted: bool) -> None:
    assert_agrees(case, name, scale, weighted)


@pytest.mark.parametrize("name", LOSSES)
def test_core_agrees_where_all_residuals_are_the_scale(case: Case, name: str) -> None:
    """In float32, so that some fall on either side of Huber's corner."""
    images = reference.render(case.normals, case.views, case.x) - 0.05
    corner = Case(images.astype(np.float32), case.normals, case.views, case.x, case.weights)
    sizes = corner.residuals()
    assert (sizes > 0.05).any()
    assert (sizes < 0.05).any()
    assert_agrees(corner, name, 0.05)


@pytest.mark.parametrize("name", LOSSES)
def test_slope_is_the_derivative(name: str) -> None:
    """At 0, beside and at the corner from both sides, and far out."""
    scale = 0.3
    at = np.array([0.0, 0.1, 0.29, 0.3, 0.31, 5.0])
    at = np.concatenate([-at, at])
    loss = LOSSES[name](scale)
    for sign in (-1.0, 1.0):

        def aside(h: float, sign: float = sign) -> reference.Array:
            return loss(at + sign * h)[0]

        value, error = ridders(aside, 1e-3, one_sided=True)
        assert (error < 1e-8).all()
        np.testing.assert_allclose(sign * value, loss(at)[1], atol=1e-8)


@pytest.mark.parametrize("name", LOSSES)
def test_gradient_is_that_of_the_loss(case: Case, name: str) -> None:
    """Along random directions, of the core's own loss, as far as float32 lets see."""
    problem = case.core()
    _, gradient = problem.value_and_grad(case.x, (name, 0.05))
    rng = np.random.default_rng(3)
    for part in reference.Unknowns(PIXELS, PICTURES).blocks.values():
        direction = np.zeros_like(case.x)
        direction[part] = rng.choice([-1.0, 1.0], direction[part].shape)

        def along(h: float, direction: NDArray[np.float64] = direction) -> float:
            return problem.value_and_grad(case.x + h * direction, (name, 0.05))[0]

        value, error = ridders(along, 2e-2)
        found = gradient @ direction
        assert abs(value - found) < 3 * error + 1e-3 * abs(found)


@pytest.mark.parametrize("name", LOSSES)
def test_wide_scale_gives_squares(case: Case, name: str) -> None:
    plain, gradient = case.core().value_and_grad(case.x)
    wide, wide_gradient = case.core().value_and_grad(case.x, (name, 1e6))
    assert wide == pytest.approx(plain, rel=1e-6)
    np.testing.assert_allclose(wide_gradient, gradient, rtol=1e-5, atol=1e-6 * abs(gradient).max())


@pytest.mark.parametrize("scale", [1e-15, 1e15])
@pytest.mark.parametrize("name", LOSSES)
def test_extreme_pictures_stay_finite(case: Case, name: str, scale: float) -> None:
    bright = Case(case.images * np.float32(1e15), case.normals, case.views, case.x, case.weights)
    loss, gradient = bright.core().value_and_grad(case.x, (name, scale))
    assert 0 < loss < np.inf
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize(
    ("robust", "message"),
    [
        (("huber", 0.0), "robust: expected a scale from 1e-15 to 1e15, found 0e0"),
        (("cauchy", -1.0), "robust: expected a scale from 1e-15 to 1e15, found -1e0"),
        (("cauchy", np.nan), "robust: expected a scale from 1e-15 to 1e15, found NaN"),
        (("huber", np.inf), "robust: expected a scale from 1e-15 to 1e15, found inf"),
        (("tukey", 1.0), "robust: expected huber or cauchy, found tukey"),
    ],
)
def test_refuses_other_losses(case: Case, robust: tuple[str, float], message: str) -> None:
    with pytest.raises(InputError) as error:
        case.core().value_and_grad(case.x, robust)
    assert str(error.value) == message


def test_residuals_of_chosen_pixels(case: Case) -> None:
    chosen = np.array([39, 0, 7, 7], dtype=np.uint64)
    found = case.core().residuals(case.x, chosen)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, case.residuals()[:, chosen], atol=1e-7)
    assert case.core().residuals(case.x, chosen[:0]).shape == (PICTURES, 0, 3)
    with pytest.raises(InputError, match="pixels: expected indices below 40, found 40"):
        case.core().residuals(case.x, np.array([40], dtype=np.uint64))
    with pytest.raises(InputError, match="pixels: expected an array of uint64"):
        case.core().residuals(case.x, np.array([1.5]))
    with pytest.raises(InputError, match="x: expected"):
        case.core().residuals(case.x[1:], chosen)


# --- The scale ---


@pytest.mark.parametrize("name", SCALES)
def test_scales_are_95_percent_efficient(name: str) -> None:
    """E[φ'']² / E[φ'²] by quadrature over a normal distribution; φ'' by differences of φ'."""
    e, width = np.linspace(-12, 12, 2_400_001, retstep=True)
    density = np.exp(-(e**2) / 2) / np.sqrt(2 * np.pi) * width
    slope = LOSSES[name](loss_scale(name, 1.0))(e)[1]
    curvature = np.gradient(slope, width)
    efficiency = (curvature @ density) ** 2 / (slope**2 @ density)
    assert efficiency == pytest.approx(0.95, abs=1e-4)


def noise(outliers: float = 0.0, seed: int = 0) -> NDArray[np.float64]:
    """Residuals of σ = 0.02, of which a share are larger by 0.5."""
    rng = np.random.default_rng(seed)
    e = rng.normal(0, 0.02, (8, 2_000, 3))
    return e + 0.5 * (rng.random(e.shape) < outliers)


def test_sigma_of_gaussian_noise() -> None:
    assert noise_sigma(noise()) == pytest.approx(0.02, rel=0.02)


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
    weights = np.zeros(residuals.shape[:2])
    weights[2:5, 100:900] = 0.7
    assert noise_sigma(residuals, weights, unknowns=100) == pytest.approx(
        noise_sigma(residuals[2:5, 100:900], unknowns=100), rel=1e-12
    )


def test_weighted_median_counts_like_copies() -> None:
    rng = np.random.default_rng(2)
    values, copies = rng.normal(size=101), rng.integers(0, 4, 101)
    repeated = np.sort(np.repeat(values, copies))
    expected = repeated[(len(repeated) - 1) // 2]
    assert weighted_median(values, copies.astype(np.float64)) == expected


def test_sigma_of_nothing_is_zero() -> None:
    assert noise_sigma(np.zeros((2, 3, 1))) == 0


@pytest.mark.parametrize(
    ("residuals", "weights", "unknowns", "message"),
    [
        (np.zeros((2, 3)), None, 0, "residuals: expected shape"),
        (np.zeros((2, 3, 1)), np.ones((3, 2)), 0, "weights: expected shape"),
        (np.zeros((2, 3, 1)), np.zeros((2, 3)), 0, "residuals: expected samples of some weight"),
        (np.zeros((2, 0, 1)), None, 0, "residuals: expected samples of some weight"),
    ],
)
def test_sigma_refuses(residuals: Any, weights: Any, unknowns: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        noise_sigma(residuals, weights, unknowns=unknowns)


def test_loss_scale_refuses() -> None:
    with pytest.raises(InputError, match="robust: expected huber or cauchy, found none"):
        loss_scale("none", 1.0)
    for sigma in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="sigma: expected a positive number"):
            loss_scale("huber", sigma)
