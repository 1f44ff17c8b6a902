"""Best materials, and normals, with known lights: against scipy on a slow model, at extremes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

import reference
from random_pixels import Array, Example, Kind, Pixels
from shared_system import check_best_albedo

ROUGHNESS = np.linspace(0.05, 1, 12)
METALLIC = np.linspace(0, 1, 6)
NODES = ROUGHNESS, METALLIC
NONE = np.empty(0), np.empty(0)

known = partial(Kind, known_lights=True)
KINDS = (
    known(),
    Kind(),
    known(sh_order=2),
    known(channels=1),
    known(metallic=0.3, weights=2),
    known(channels=1, sh_order=2, metallic=0.0),
    known(weights=3),
)
free = partial(known, free_normals=True)
FREE = (
    free(),
    free(weights=3),
    free(metallic=0.3, weights=2),
    free(channels=1, sh_order=2),
    free(channels=1, metallic=0.0),
)


def fit(
    example: Example,
    x: Array | None = None,
    pixels: Pixels | None = None,
    nodes: tuple[Array, Array] = NODES,
    *,
    exact: bool = True,
    **options: Any,
) -> tuple[Array, Array]:
    """Best materials from x, or from nothing, of pixels, or all, and their sums of squares."""
    single: dict[str, Any] = {"images": example.targets.swapaxes(0, 1).astype(np.float32)}
    problem = example.problem(**({} if exact else single))
    x = example.x(np.full_like(example.truth, 0.5)) if x is None else x
    pixels = example.everything if pixels is None else pixels
    return problem.fit_materials(x, pixels, *nodes, **options)


def explicit(example: Example, x: Array) -> Array:
    """Σ ω (I − T)² at x of all pixels, by the core's other path."""
    return example.problem().normal_equations(x, example.everything)[2]


@cache
def noisy(kind: Kind) -> Example:
    return Example(kind, 8, 8, noise=0.03)


def best_of_scipy(
    example: Example, p: int, mean: Array | None = None, precision: Array | None = None
) -> float:
    """Least Σ ω (I − T)² + Σ precision (v − mean)² of a pixel, from many starts."""
    kind = example.kind
    root = np.sqrt(example.omega[p])

    def residuals(v: Array) -> Array:
        values = v[None] if kind.metallic is None else np.append(v, kind.metallic)[None]
        radiance = example.radiance(values, pixels=slice(p, p + 1))[0]
        parts = [root * (radiance - example.targets[p])]
        if mean is not None and precision is not None:
            parts.append(np.sqrt(precision[p]) * (v[kind.channels :] - mean[p]))
        return np.concatenate([part.ravel() for part in parts])

    starts = [
        np.array([0.5] * kind.channels + [r, m])[: kind.unknowns]
        for r in (0.2, 0.5, 0.8)
        for m in ((0.1, 0.8) if kind.metallic is None else (0.0,))
    ]
    found = (least_squares(residuals, s, bounds=(0, 1), xtol=1e-12, ftol=1e-12) for s in starts)
    return min(2 * float(result.cost) for result in found)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_no_start_of_scipys_ends_lower(kind: Kind) -> None:
    example = noisy(kind)
    found, squares = fit(example, starts=4, steps=40, exact_steps=5)
    assert found.shape == (8, kind.unknowns)
    np.testing.assert_allclose(squares, example.squares(found), rtol=1e-11)
    for p in range(8):
        assert squares[p] <= best_of_scipy(example, p) * (1 + 1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [KINDS[0], KINDS[4]], ids=str)
def test_a_prior_is_minimised_with_the_squares(kind: Kind) -> None:
    example = noisy(kind)
    rng = np.random.default_rng(0)
    shape = 8, kind.unknowns - kind.channels
    prior: dict[str, Any] = {
        "mean": rng.uniform(0.1, 0.9, shape),
        "precision": rng.uniform(0, 0.3, shape),
    }
    found, squares = fit(example, starts=4, steps=40, exact_steps=5, **prior)
    # What is handed out is without the prior, what is least is with it.
    np.testing.assert_allclose(squares, example.squares(found), rtol=1e-11)
    off = found[:, kind.channels :] - prior["mean"]
    total = squares + (prior["precision"] * off**2).sum(axis=1)
    for p in range(8):
        assert total[p] <= best_of_scipy(example, p, **prior) * (1 + 1e-7)
    stiff, _ = fit(example, mean=prior["mean"], precision=np.full(shape, 1e12))
    np.testing.assert_allclose(stiff[:, kind.channels :], prior["mean"], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_best_albedo_is_best_and_the_grid_has_what_it_leaves(kind: Kind) -> None:
    check_best_albedo(Example(kind, 10, 6, noise=0.3))


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_noise_free_materials_are_found_from_nothing(kind: Kind) -> None:
    example = Example(kind, 60, 16)
    truth = example.unknowns(example.truth)
    for exact, median, most in ((False, 1e-7, 2e-6), (True, 1e-14, 1e-12)):
        found, squares = fit(example, exact=exact, starts=2, exact_steps=2)
        error = np.abs(found - truth).max(axis=1)
        assert np.median(error) < median
        assert error.max() < most
        if exact:
            assert squares.max() < 1e-27


@pytest.mark.parametrize(
    ("unknown", "value", "tolerance"),
    [
        (0, 0.0, 1e-10),
        (1, 1.0, 1e-10),
        (4, 0.0, 1e-10),
        (4, 1.0, 1e-10),
        (3, 1.0, 1e-10),
        # Radiance depends on r⁴ ln r: what is below is as good as 0.
        (3, 0.0, 2e-3),
        (3, 0.03, 2e-7),
    ],
)
def test_materials_on_bounds_are_found(unknown: int, value: float, tolerance: float) -> None:
    def change(truth: Array) -> None:
        truth[:, unknown] = value

    example = Example(known(), 60, 16, change=change)
    found, squares = fit(example, starts=3, steps=40, exact_steps=6)
    assert ((found >= 0) & (found <= 1)).all()
    assert np.abs(found[:, unknown] - value).max() < tolerance
    assert squares.max() < 1e-16


def test_roughness_0_is_left() -> None:
    """Nothing depends on roughness there, so no gradient says that the pixel should go."""
    example = Example(known(), 60, 16)
    given = example.truth.copy()
    given[:, 3] = 0
    found, squares = fit(example, example.x(given), nodes=NONE, steps=60)
    assert (squares < example.squares(given)).all()
    # Most get to the bottom; a few may end in another minimum.
    assert np.mean(np.abs(found - example.truth).max(axis=1) < 1e-9) > 0.9


def dark(example: Example) -> None:
    example.targets[:] = 0


def unlit(example: Example) -> None:
    example.lights[:] = 0


def blind(example: Example) -> None:
    """Half of the pixels count in no picture."""
    assert example.weights is not None
    example.weights[:, ::2] = 0


@pytest.mark.parametrize("brightness", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("pictures", [1, 2, 16])
@pytest.mark.parametrize("change", [dark, unlit, blind, None])
def test_whatever_the_pictures_show_it_ends_no_worse(
    change: Callable[[Example], None] | None, pictures: int, brightness: float
) -> None:
    kind = known(weights=3) if change is blind else known()
    example = Example(kind, 40, pictures, noise=0.05 * brightness, brightness=brightness)
    if change is not None:
        change(example)
    rng = np.random.default_rng(1)
    given = rng.uniform(0, 1, (40, 5))
    given[rng.random((40, 5)) < 0.2] = 0
    given[rng.random((40, 5)) < 0.2] = 1
    x = example.x(given)
    before = explicit(example, x)
    every: tuple[dict[str, Any], ...] = (
        {},
        {"starts": 3, "exact_steps": 4},
        {"steps": 0},
        {"starts": 0},
    )
    for options in every:
        found, squares = fit(example, x, **options)
        assert ((found >= 0) & (found <= 1)).all()
        assert (squares <= before).all()
        # To the last bit what the normal equations say there.
        np.testing.assert_array_equal(squares, explicit(example, example.x(found)))
        if change is unlit:
            np.testing.assert_array_equal(squares, before)
    scale = (example.omega * example.targets**2).sum(axis=(1, 2))
    found, squares = fit(example, x, nodes=NONE, exact_steps=0)
    assert (squares <= before + 1e-13 * scale + 1e-13 * before).all()
    ends = explicit(example, example.x(found))
    np.testing.assert_allclose(squares, ends, atol=1e-13 * scale.max())


def away(example: Example, degrees: float) -> Array:
    """Tangent offsets (P, 2) at which normals are so far from the true ones."""
    angle = np.random.default_rng(1).uniform(0, 2 * np.pi, (example.pixels, 1))
    first, second = reference.tangents(example.normals)
    aside = np.cos(angle) * first + np.sin(angle) * second
    wrong = example.normals + np.tan(np.radians(degrees)) * aside
    along = np.sum(wrong * example.given, axis=1)
    axes = reference.tangents(example.given)
    return np.column_stack([np.sum(wrong * axis, axis=1) / along for axis in axes])


def degrees_off(example: Example, offsets: Array) -> Array:
    """Between normals at offsets and the true ones."""
    found = reference.turned(example.given, offsets.T)
    apart = np.linalg.norm(found - example.normals, axis=1)
    return np.asarray(np.degrees(2 * np.arcsin(apart / 2)))


STEPS: dict[str, Any] = {"starts": 2, "steps": 20, "exact_steps": 40}


@pytest.mark.parametrize("kind", FREE, ids=str)
def test_materials_and_normals_are_found_from_normals_5_degrees_off(kind: Kind) -> None:
    example = Example(kind)
    start = away(example, 5)
    np.testing.assert_allclose(degrees_off(example, start), 5, atol=1e-9)
    found, squares = fit(example, example.x(np.full_like(example.truth, 0.5), start), **STEPS)
    assert found.shape == (300, kind.unknowns)
    np.testing.assert_allclose(squares, example.squares(found), rtol=1e-6, atol=1e-24)
    error = np.abs(found - example.unknowns(example.truth))
    assert np.mean(error.max(axis=1) < 1e-7) > 0.95
    assert np.median(degrees_off(example, found[:, -2:])) < 1e-9


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("kind", FREE, ids=str)
def test_with_normals_it_ends_no_worse_than_it_began(kind: Kind, held: bool) -> None:
    """Squared residuals and prior, from any materials and normals, however few steps."""
    example = Example(kind, noise=0.05, grazing=True)
    rng = np.random.default_rng(3)
    values = np.clip(rng.uniform(-0.2, 1.2, example.truth.shape), 0, 1)
    start = rng.normal(size=(300, 2)) * rng.choice([0.0, 0.1, 1.0, 30.0], (300, 1))
    x, began = example.x(values, start), example.unknowns(values, start)
    shape = 300, kind.unknowns - kind.channels
    prior: dict[str, Any] = {
        "mean": rng.uniform(-0.5, 1, shape),
        "precision": rng.uniform(0, 1, shape),
    }

    def cost(unknowns: Array) -> Array:
        off = unknowns[:, kind.channels :] - prior["mean"]
        return np.asarray((prior["precision"] * off**2).sum(axis=1))

    before = explicit(example, x)
    for steps in ({}, {"starts": 0, "exact_steps": 1}, {"steps": 0}):
        options: dict[str, Any] = STEPS | steps | {"held_normals": held}
        found, squares = fit(example, x, **options)
        assert (squares <= before).all()
        np.testing.assert_array_equal(squares, explicit(example, found.T.ravel()))
        found, squares = fit(example, x, **prior, **options)
        assert (squares + cost(found) <= (before + cost(began)) * (1 + 1e-12)).all()
        lengths = np.linalg.norm(found[:, -2:], axis=1)
        longest = np.maximum(np.sqrt(3), np.linalg.norm(start, axis=1))
        assert (lengths <= longest * (1 + 1e-12)).all()
        assert ((found[:, :-2] >= 0) & (found[:, :-2] <= 1)).all()
        if held:
            np.testing.assert_array_equal(found[:, -2:], start)


@pytest.mark.parametrize("kind", FREE, ids=str)
def test_held_normals_leave_the_fit_of_materials(kind: Kind) -> None:
    """To the rounding of normals, of a problem that was given the changed ones."""
    example = Example(kind, noise=0.02)
    steps = STEPS | {"exact_steps": 3}
    found, squares = fit(example, held_normals=True, **steps)
    held = example.problem(normals=example.normals, free_normals=False)
    maps = np.full(kind.of_material * example.pixels, 0.5)
    expected, least = held.fit_materials(maps, example.everything, *NODES, **steps)
    np.testing.assert_allclose(squares, least, rtol=1e-8)
    same = np.abs(found[:, :-2] - expected).max(axis=1) < 1e-6
    assert np.mean(same) > 0.98
    # Without steps on residuals normals stay as well.
    found, _ = fit(example, **(STEPS | {"exact_steps": 0}))
    np.testing.assert_array_equal(found[:, -2:], example.offsets)
