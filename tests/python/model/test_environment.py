"""Panoramas as light with the full models: against sums over all of their pixels."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import Environment, InputError, Materials, _core
from pbrfit.model import panorama
from pbrfit.model.environment import render_environment
from pbrfit.model.reflection import MODELS, Model, render_directional

Array = NDArray[np.floating[Any]]

SIDE, FEW = 20, 12
"""Pixels across a ball, and across one under thousands of lights."""

SURFACES = {
    "matt": (0.8, 1.0, 0.0),
    "glossy plastic": (0.5, 0.3, 0.0),
    "metal, r = 1": (0.8, 1.0, 1.0),
    "metal, r = 0.7": (0.8, 0.7, 1.0),
    "metal, r = 0.5": (0.8, 0.5, 1.0),
    "metal, r = 0.35": (0.8, 0.35, 1.0),
    "metal, r = 0.2": (0.8, 0.2, 1.0),
}
"""Albedo, roughness, metallic."""


def sphere(
    albedo: float, roughness: float, metallic: float, side: int = SIDE
) -> tuple[Materials, Array]:
    """A ball seen from afar, up to 80 degrees from its middle; NaN outside."""
    at = (np.arange(side) + 0.5) / side * 2 - 1
    y, x = np.meshgrid(-at, at, indexing="ij")
    inside = x * x + y * y < np.sin(np.radians(80)) ** 2
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    normals = np.where(inside[..., None], np.stack([x, y, z], -1), np.nan)
    flat = np.where(inside, 1.0, np.nan)
    materials = Materials(
        np.repeat(albedo * flat[..., None], 3, -1), roughness * flat, metallic * flat
    )
    return materials, normals


def summed(
    pixels: Array, surface: tuple[float, float, float], model: Model, side: int = FEW
) -> Array:
    """The ball under every pixel of a panorama as a light from one direction."""
    height = len(pixels)
    directions = panorama.directions(height, 2 * height).reshape(-1, 3)
    angles = panorama.solid_angles(height, 2 * height).repeat(2 * height)
    colors = pixels.reshape(-1, 3) * angles[:, None] / np.pi
    materials, normals = sphere(*surface, side)
    total = np.zeros((side, side, 3))
    for first in range(0, len(colors), 2048):
        part = slice(first, first + 2048)
        given = (directions[part], colors[part], 0.0)
        total += render_directional(materials, normals, *given, 2, model=model).sum(axis=0)
    return total


def off(found: Array, expected: Array) -> float:
    """RMSE over RMS."""
    return float(np.sqrt(np.nanmean((found - expected) ** 2) / np.nanmean(expected**2)))


def lamps(height: int = 64) -> Array:
    """A dim sky with two lamps, of some 10 and 20 degrees."""
    d = panorama.directions(height, 2 * height)
    pixels = np.full((height, 2 * height, 3), 0.2) + 0.2 * d[..., 1:2]
    for way, size, color in (((0.6, 0.48, 0.64), 0.985, 30.0), ((-0.8, 0.0, 0.6), 0.94, 8.0)):
        pixels += color * np.clip((d @ np.array(way) - size) / 0.01, 0, 1)[..., None]
    return pixels


@pytest.mark.parametrize("model", MODELS)
def test_a_grey_panorama_is_reflected_as_a_furnace_has_it(model: Model) -> None:
    # A white surface of the principled model returns all of it.
    even = Environment(np.full((16, 32, 3), 2.0))
    for surface in SURFACES.values():
        materials, normals = sphere(1.0, *surface[1:], FEW)
        found = render_environment(materials, normals, even, 0.0, model=model)
        if model == "principled":
            np.testing.assert_allclose(found[np.isfinite(found)], 2.0, rtol=3e-3)
        if surface[1] >= 0.5:  # a lobe that pixels of six degrees sample
            expected = summed(np.full((32, 64, 3), 2.0), (1.0, *surface[1:]), model)
            assert off(found, expected) < 0.01


@pytest.mark.parametrize("name", ["glossy plastic", "metal, r = 0.5", "metal, r = 0.2"])
def test_reflections_of_lamps_are_those_of_all_pixels(name: str) -> None:
    pixels = lamps()
    ball = sphere(*SURFACES[name], FEW)
    found = render_environment(*ball, Environment(pixels), 0, model="principled")
    assert off(found, summed(pixels, SURFACES[name], "principled")) < 0.06


@pytest.mark.parametrize("model", MODELS)
def test_light_is_never_negative_and_the_same_on_any_threads(model: Model) -> None:
    rng = np.random.default_rng(3)
    pixels = (rng.random((24, 48, 3)) ** 12 * 1e4).astype(np.float32)
    one, many = (_core.Environment(pixels, threads) for threads in (1, 5))
    for first, second in zip(one.levels(), many.levels(), strict=True):
        np.testing.assert_array_equal(first, second)
        assert first.min() >= 0
    count = 2000
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    views = np.tile([0.0, 0.0, 1.0], (count, 1))
    albedo, roughness, metallic = rng.random((count, 3)), rng.random(count), rng.random(count)
    roughness[:4], metallic[:4] = [0, 1, 0, 1], [0, 0, 1, 1]
    albedo[:4] = np.array([0, 1, 1, 0])[:, None]
    given = (normals, views, albedo, roughness, metallic, 0.3)
    found = one.radiance(*given, 1, model)
    np.testing.assert_array_equal(found, one.radiance(*given, 4, model))
    assert found.min() >= 0


def test_levels_blur_by_doubling_widths_and_keep_the_light() -> None:
    pixels = np.zeros((64, 128, 3), np.float32)
    pixels[32, 64] = 1000.0
    *levels, even, matt = _core.Environment(pixels, 0).levels()
    assert [level.shape[1] for level in levels] == [1024 >> j for j in range(8)]
    angles = panorama.solid_angles(64, 128)
    whole = 1000 * angles[32]
    centre = panorama.directions(64, 128)[32, 64]
    for j, level in enumerate(levels):
        height = len(level)
        weights = panorama.solid_angles(height, 2 * height)[:, None]
        assert (level[..., 0] * weights).sum() == pytest.approx(whole, rel=0.02)
        apart = 1 - panorama.directions(height, 2 * height) @ centre
        # A von Mises-Fisher lobe has the mean 1 − cos of σ², where it is narrow.
        width = 2**j * 4 * np.pi / 1024
        mean = (level[..., 0] * apart * weights).sum() / (level[..., 0] * weights).sum()
        texel = 2 * np.pi / 128  # of what is given, linear between centres
        if texel <= width < 0.5:
            assert mean == pytest.approx(width**2 + texel**2 / 6, rel=0.1)
    for hemisphere, at_centre in ((matt, whole / np.pi), (even, whole / (np.pi * 1.8))):
        directions = panorama.directions(*hemisphere.shape[:2])
        facing = hemisphere[..., 0][directions @ centre > 0.995].mean()
        assert facing == pytest.approx(at_centre, rel=0.02)


def test_turning_goes_from_the_viewer_to_the_right() -> None:
    pixels = np.zeros((32, 64, 3))
    pixels[15:17, [0, -1]] = 50.0  # at the viewer, +Z
    materials, normals = sphere(0.5, 0.6, 0.0)
    light = Environment(pixels)

    def middle(light: Environment) -> float:
        picture = np.nan_to_num(render_environment(materials, normals, light, 0)).mean(axis=-1)
        return float((picture.sum(axis=0) * np.arange(SIDE)).sum() / picture.sum())

    front, right, left = (middle(light.turned(degrees)) for degrees in (0, 60, -60))
    assert left < front - 1 < front < right - 1
    np.testing.assert_array_equal(
        render_environment(materials, normals, light.turned(40), 0),
        render_environment(materials, normals, Environment(pixels, 40), 0),
    )
    assert light.turned(40).blurred is light.blurred


def test_colours_beyond_rec_709_count_as_none() -> None:
    pixels = np.ones((8, 16, 3))
    pixels[..., 2] = -0.1
    found = render_environment(*sphere(0.5, 0.5, 0.5), Environment(pixels), 0)
    assert np.nanmin(found) == 0
    assert np.nanmax(found[..., 2]) == 0


@pytest.mark.parametrize(
    ("pixels", "rotate", "message"),
    [
        (np.ones((8, 15, 3)), 0, r"pixels: expected a panorama of shape \(H, 2H, 3\)"),
        (np.ones((1, 2, 3)), 0, r"H 2 or more, found shape \(1, 2, 3\)"),
        (np.ones((8, 16)), 0, "pixels: expected a panorama"),
        ("sky", 0, "pixels: expected"),
        (np.ones((8, 16, 3)), np.inf, "rotate: expected a finite number"),
    ],
)
def test_what_is_no_panorama_is_refused(pixels: Any, rotate: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Environment(pixels, rotate)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("degrees", "most"), [(4.0, 0.02), (12.0, 0.04), (25.0, 0.08)])
@pytest.mark.parametrize("surface", ["matt", "glossy plastic", "metal, r = 0.5", "metal, r = 0.35"])
def test_a_soft_lamp_is_a_mean(model: Model, degrees: float, most: float, surface: str) -> None:
    middle = np.array([0.48, 0.6, 0.64])
    extent = np.radians(degrees)
    # Points of a spiral fill the disk evenly.
    k = np.arange(400) + 0.5
    radius, turn = extent * np.sqrt(k / len(k)), k * np.pi * (3 - 5**0.5)
    across = np.cross(middle, [0, 1, 0])
    across /= np.linalg.norm(across)
    up = np.cross(across, middle)
    points = np.cos(radius)[:, None] * middle + np.sin(radius)[:, None] * (
        np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * up
    )
    lit = partial(render_directional, *sphere(*SURFACES[surface]), fov=0.0, threads=2, model=model)
    found = lit(middle, np.ones(3), extents=extent)
    assert off(found, lit(points, np.ones((len(k), 3))).mean(axis=0)) < most
    assert np.nanmin(found) >= 0
    hard = lit(middle, np.ones(3))
    np.testing.assert_array_equal(hard, lit(middle, np.ones(3), extents=0.0))


@pytest.mark.parametrize("extent", [-0.1, 0.8, np.nan])
def test_lamps_beyond_a_disk_are_refused(extent: float) -> None:
    with pytest.raises(InputError, match="extents: expected 0 to π/4 radians"):
        render_directional(
            *sphere(0.5, 0.5, 0.5), np.array([0, 0, 1.0]), np.ones(3), 0, extents=extent
        )
