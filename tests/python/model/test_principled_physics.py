"""The principled model against brute force, and facts about it, each under its own name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import principled_reference
from pbrfit import _core
from principled_reference import EVEN
from reference import frames, unit

Array = NDArray[np.floating[Any]]
Doubles = NDArray[np.float64]
Pixels = tuple[Doubles, Doubles, Doubles, Doubles, Doubles]
"""Normals, views and albedo (P, 3), roughness and metallic (P,)."""

# The light whose radiance is 1 from everywhere: Y_00 = 1/(2√π).
CONSTANT_LIGHT = 2 * math.sqrt(math.pi)
COSINE_TRANSFER = np.array([math.pi, 2 * math.pi / 3, math.pi / 4, 0.0])
DEGREE = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3])


def pixels(*parts: Array | float) -> Pixels:
    """From arrays with leading dimensions that broadcast against each other."""
    arrays = [np.asarray(part, dtype=np.float64) for part in parts]
    trailing = [(3,), (3,), (3,), (), ()]
    count = np.broadcast_shapes(
        (1,), *(a.shape[: a.ndim - len(t)] for a, t in zip(arrays, trailing, strict=True))
    )
    normal, view, albedo, r, metallic = (
        np.broadcast_to(a, count + t).copy() for a, t in zip(arrays, trailing, strict=True)
    )
    return normal, view, albedo, r, metallic


def shade(*parts: Array | float) -> Doubles:
    """Weights (P, 3, 16)."""
    return _core.shade(*pixels(*parts), "principled").reshape(-1, 3, 16)


def random_pixels(count: int, seed: int) -> Pixels:
    """Frames with n·v > 0, and materials."""
    rng = np.random.default_rng(seed)
    normal, view = frames(count, rng)
    return normal, view, rng.random((count, 3)), rng.random(count), rng.random(count)


def seen_at(cosine: float | Array, seed: int = 0) -> tuple[Array, Array]:
    """Normals in random directions, and views with these n·v."""
    cosine = np.atleast_1d(cosine)[:, None]
    normal, other = unit(np.random.default_rng(seed).normal(size=(2, len(cosine), 3)))
    aside = unit(np.cross(normal, other))
    return normal, unit(cosine * normal + np.sqrt(1 - cosine**2) * aside)


@pytest.mark.parametrize("seed", range(4))
def test_weights_are_integrals_over_light_directions(seed: int) -> None:
    """Of the BRDF as it is written down, in world space, without the table or a local frame."""
    _, _, albedo, r, metallic = random_pixels(7, seed)
    r = 0.12 + 0.88 * r  # narrower lobes at grazing angles are too much for the reference
    grazing = 0.04 + 0.02 * seed
    normal, view = seen_at(np.array([grazing, 1, 0.1, 0.3, 0.5, 0.7, 0.9]), seed)
    view[1] = normal[1]
    albedo[2], metallic[2:4] = 1, (0, 1)
    found = shade(normal, view, albedo, r, metallic)
    for i in range(len(r)):
        expected = principled_reference.shade(normal[i], view[i], albedo[i], r[i], metallic[i])
        np.testing.assert_allclose(found[i], expected, rtol=0, atol=6e-6)


FURNACE_R = np.concatenate((np.linspace(0, 0.05, 26), np.linspace(0.05, 1, 40)))
FURNACE_COSINE = np.concatenate((np.geomspace(1e-4, 0.05, 30), np.linspace(0.05, 1, 40)))


def furnace(albedo: float, metallic: float) -> Array:
    """What comes back of light that is 1 from everywhere, at all roughness and angles (R, X)."""
    normal, view = seen_at(np.tile(FURNACE_COSINE, len(FURNACE_R)))
    r = np.repeat(FURNACE_R, len(FURNACE_COSINE))
    weights = shade(normal, view, np.full(3, albedo), r, metallic)
    return np.asarray(CONSTANT_LIGHT * weights[:, 0, 0].reshape(len(FURNACE_R), -1))


@pytest.mark.parametrize("metallic", [0.0, 0.3, 1.0])
def test_a_white_surface_reflects_all_light(metallic: float) -> None:
    # A metal by M, a dielectric because its ground gets what its lobe leaves.
    np.testing.assert_allclose(furnace(1.0, metallic), 1, rtol=0, atol=1e-12)


def test_metals_reflect_less_than_all_and_more_with_albedo() -> None:
    darker = furnace(0.0, 1.0)
    assert darker.min() >= -1e-6
    for albedo in (0.1, 0.5, 0.9, 1.0):
        lighter = furnace(albedo, 1.0)
        assert (lighter >= darker - 1e-12).all()
        assert (lighter <= 1 + 1e-6).all()
        darker = lighter


def test_dielectrics_reflect_less_than_all_and_more_with_albedo() -> None:
    black = furnace(0.0, 0.0)
    assert (black > 0.01).all()
    assert (black < 1).all()
    for albedo in (0.1, 0.5, 0.9):
        # What the lobe leaves, times the albedo.
        expected = black + albedo * (1 - black)
        np.testing.assert_allclose(furnace(albedo, 0.0), expected, rtol=0, atol=1e-12)


def test_only_functions_even_across_the_plane_of_view_answer() -> None:
    # Light that is odd across the plane of normal and view gives nothing.
    normal, view = np.array([0.0, 0, 1]), np.array([-0.6, 0, 0.8])
    odd = np.setdiff1d(np.arange(16), EVEN)
    assert np.abs(shade(normal, view, np.full(3, 0.5), 0.3, 0.5)[0][:, odd]).max() < 1e-15


@pytest.mark.parametrize("cosine", [1e-4, 5e-5, 0.0, -0.4])
def test_beyond_the_least_cosine_lobes_stand_still_and_all_is_finite(cosine: float) -> None:
    for r in (0.0, 0.01, 0.5, 1.0):
        pixel = pixels(*seen_at(cosine, 5), np.full((1, 3), 0.5), r, 0.5)
        weights = shade(*pixel)
        assert np.isfinite(weights).all()
        assert CONSTANT_LIGHT * np.abs(weights[0, :, 0]).max() <= 1 + 1e-6
