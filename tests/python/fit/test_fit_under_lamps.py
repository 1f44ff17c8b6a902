"""Single pixels under known lamps: planted ones recovered, limits, priors, extremes, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from pbrfit import _core
from pbrfit.model.reflection import MODELS
from reference import unit
from under_lamps import of_lamp_samples

Array = NDArray[Any]
Arguments = dict[str, Any]

PICTURES, LAMPS = 12, 18
UNKNOWNS = 7
"""Tangent offsets, albedos, roughness, metallic."""

every_model = pytest.mark.parametrize("model", MODELS)


def example(count: int, seed: int, model: str, *, ambient: bool = False) -> tuple[Arguments, Array]:
    """Pixels with pictures of what is planted, and a start beside that; and what is planted (P, 8).

    Half of the pictures have two lamps, and where there is SH light a third of them have none.
    """
    rng = np.random.default_rng(seed)
    forward = np.array([0.0, 0.0, 1.0])
    normals = unit(forward + 0.3 * rng.normal(size=(count, 3)))
    views = unit(forward + 0.1 * rng.normal(size=(count, 3)))
    directions = unit(forward + 0.6 * rng.normal(size=(count, LAMPS, 3)) * [1, 1, 0])
    albedo = rng.uniform(0.1, 0.9, (count, 3))
    roughness, metallic = rng.uniform(0.25, 0.8, count), rng.uniform(0.1, 0.9, count)
    intensities = rng.uniform(0.5, 2.0, (count, LAMPS, 3))
    light = np.zeros((PICTURES, 3))
    if ambient:
        light[:] = np.linspace(0.4, 0.6, PICTURES)[:, None] * [1.0, 0.9, 0.8]
        light[::3] = 0
    given = {
        "weights": np.ones((count, PICTURES, 3)),
        "limits": None,
        "views": views,
        "directions": directions,
        "intensities": intensities,
        "picture_of": np.sort(np.arange(LAMPS) % PICTURES).astype(np.uint64),
        "ambient": light,
        "base_normals": unit(normals + 0.05 * rng.normal(size=(count, 3))),
        "albedo": np.clip(albedo + rng.uniform(-0.1, 0.1, albedo.shape), 0, 1),
        "roughness": roughness * rng.uniform(0.8, 1.2, count),
        "metallic": np.clip(metallic + rng.uniform(-0.1, 0.1, count), 0, 1),
        "prior_mean": np.zeros((count, UNKNOWNS)),
        "prior_precision": np.zeros((count, UNKNOWNS)),
        "free_normals": True,
        "free_metallic": True,
        "free_roughness": True,
        "iterations": 60,
        "threads": 1,
        "model": model,
    }
    given["start_normals"] = given["base_normals"]
    planted = (normals, albedo, roughness, metallic)
    given["pictures"] = rendered(given, *planted)
    return given, np.column_stack(planted)


def rendered(given: Arguments, *pixels: Array) -> Array:
    """Pictures (P, N, 3) of normals and materials."""
    normals, albedo, roughness, metallic = (np.ascontiguousarray(a) for a in pixels)
    views, model = given["views"], given["model"]
    maps = (normals, views, albedo, roughness, metallic)
    radiance = _core.lamp_radiance(*maps, given["directions"], 1, model) * given["intensities"]
    pictures = _core.shade(*maps, model)[:, None, :, 0] * given["ambient"]
    for k, picture in enumerate(given["picture_of"].astype(int)):
        pictures[:, picture] += radiance[:, k]
    return np.asarray(pictures)


def fitted(given: Arguments, **changed: Any) -> tuple[Array, Array]:
    """Normals and materials (P, 8), and costs."""
    *pixels, cost = of_lamp_samples("fit", given | changed)
    assert all(np.isfinite(a).all() for a in (*pixels, cost))
    return np.column_stack(pixels), cost


def start_of(given: Arguments) -> Array:
    return np.column_stack(
        [given[name] for name in ("start_normals", "albedo", "roughness", "metallic")]
    )


def share(found: Array, planted: Array, tolerance: float = 1e-6) -> float:
    """Share of the pixels that are recovered."""
    return float(np.mean(np.abs(found - planted).max(axis=1) < tolerance))


@every_model
@pytest.mark.parametrize("ambient", [False, True])
def test_planted_pixels_are_recovered(model: str, ambient: bool) -> None:
    given, planted = example(200, 0, model, ambient=ambient)
    assert share(start_of(given), planted) == 0
    found, cost = fitted(given)
    assert share(found, planted) >= 0.99
    assert np.median(cost) < 1e-20


@every_model
def test_limits_recover_what_is_cut_off(model: str) -> None:
    """Bright samples are known to be at least, dark ones at most so much."""
    given, planted = example(200, 1, model)
    low, high = np.quantile(given["pictures"], [0.1, 0.85])
    cut = np.clip(given["pictures"], low, high)
    limits = np.where(given["pictures"] > high, 1, np.where(given["pictures"] < low, 2, 0))
    found, cost = fitted(given, pictures=cut, limits=limits.astype(np.uint8))
    assert share(found, planted) >= 0.9
    assert np.median(cost) < 1e-20
    taken_as_data, *_ = fitted(given, pictures=cut)
    assert share(taken_as_data, planted) < 0.3


@every_model
def test_what_is_held_stays_and_the_rest_is_recovered(model: str) -> None:
    given, planted = example(100, 2, model)
    normals, roughness, metallic = planted[:, :3].copy(), planted[:, 6].copy(), planted[:, 7].copy()
    known = {"start_normals": normals, "roughness": roughness, "metallic": metallic}
    for free, columns in [
        ("free_normals", slice(0, 3)),
        ("free_roughness", slice(6, 7)),
        ("free_metallic", slice(7, 8)),
    ]:
        found, _ = fitted(given | known, **{free: False})
        np.testing.assert_array_equal(found[:, columns], planted[:, columns])
        assert share(found, planted) >= 0.99


@every_model
def test_a_prior_alone_is_its_mean(model: str) -> None:
    """About the base normals, from wherever normals start."""
    given, _ = example(30, 4, model)
    rng = np.random.default_rng(1)
    mean = np.column_stack([rng.uniform(-0.4, 0.4, (30, 2)), rng.uniform(0.1, 0.9, (30, 5))])
    precision = rng.uniform(0.1, 10, (30, UNKNOWNS))
    found, cost = fitted(
        given,
        weights=np.zeros_like(given["weights"]),
        start_normals=unit(given["base_normals"] + 0.1),
        prior_mean=mean,
        prior_precision=precision,
    )
    expected = np.column_stack(
        [reference.turned(given["base_normals"], mean[:, :2].T), mean[:, 2:]]
    )
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert (cost < 1e-6).all()


@every_model
def test_extreme_pictures_are_fitted_without_end_or_nan(model: str) -> None:
    given, _ = example(40, 7, model, ambient=True)
    given["albedo"][::3], given["albedo"][1::3] = 0, 1
    given["metallic"][::4], given["metallic"][1::4] = 0, 1
    given["roughness"][::5], given["roughness"][1::5] = 0, 1
    ones = np.ones_like(given["pictures"])
    _, at_start = fitted(given, iterations=0)
    for pictures, limits in [(0 * ones, 0), (1e15 * ones, 0), (0 * ones, 2), (ones, 1), (-ones, 0)]:
        changed = {"pictures": pictures, "limits": np.full(ones.shape, limits, np.uint8)}
        _, before = fitted(given, iterations=0, **changed)
        found, after = fitted(given, **changed)
        assert (after <= before).all()
        assert (found[:, 3:] >= 0).all()
        assert (found[:, 3:] <= 1).all()
        np.testing.assert_allclose(np.linalg.norm(found[:, :3], axis=1), 1, rtol=1e-9)
    assert (at_start > 0).all()


@every_model
def test_normals_stay_on_the_side_of_the_camera(model: str) -> None:
    """Lamps from aside pull them beyond the edge: white pixels are brightest there."""
    given, _ = example(60, 8, model)
    views = given["views"]
    across = unit(np.cross(views, [1.0, 0.2, 0.1]))
    edge = unit(across + 0.1 * views)
    directions = unit(across - 0.5 * views)[:, None]
    found, _ = fitted(
        given,
        directions=np.repeat(directions, LAMPS, axis=1),
        base_normals=edge,
        start_normals=edge,
        pictures=np.full_like(given["pictures"], 3.0),
    )
    assert (np.sum(found[:, :3] * views, axis=1) >= 0.01).all()


@every_model
def test_a_mirror_that_is_none_leaves_its_start(model: str) -> None:
    """The slope by roughness is 0 at 0. Narrow lobes have many minima, so not all get far."""
    given, planted = example(100, 9, model)
    given["roughness"][:] = 0
    found, cost = fitted(given)
    assert (found[:, 6] > 0.1).mean() > 0.7
    stuck, at_zero = fitted(given, free_roughness=False)
    assert (stuck[:, 6] == 0).all()
    assert np.median(cost) < 0.1 * np.median(at_zero)
    assert (cost <= fitted(given, iterations=0)[1]).all()
    assert share(found[:, 6:7], planted[:, 6:7], 1e-3) > 0.2
