"""Relighting from Python: directions, lights, and what they do to surfaces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit import DirectionalLight, Environment, InputError, PointLight, Result, relight
from pbrfit.model import panorama
from pbrfit.result.relighting import turned
from relit import ball, fitted, shaded_ball, side_lit
from scene_files import known, room

Array = NDArray[np.floating[Any]]


@pytest.fixture(scope="module")
def result() -> Result:
    return fitted()


@pytest.fixture(scope="module")
def sphere(result: Result) -> Result:
    return ball(result)


def spot(column: float, row: float = 0.5, height: int = 32) -> Array:
    """A panorama that is black but for a spot at these shares of its width and height."""
    pixels = np.zeros((height, 2 * height, 3))
    i, j = int(row * height), int(column * 2 * height)
    pixels[max(i - 1, 0) : i + 1, j - 1 : j + 1] = 50.0
    return pixels


@pytest.mark.parametrize(
    ("azimuth", "elevation", "direction"),
    [
        (0, 0, (0, 0, 1)),
        (90, 0, (1, 0, 0)),
        (-90, 0, (-1, 0, 0)),
        (180, 0, (0, 0, -1)),
        (0, 90, (0, 1, 0)),
        (123, -90, (0, -1, 0)),
        (360e6 + 90, 0, (1, 0, 0)),
        (45, 45, (0.5, math.sqrt(0.5), 0.5)),
    ],
)
def test_directions_of_azimuth_and_elevation(
    azimuth: float, elevation: float, direction: tuple[float, ...]
) -> None:
    found = DirectionalLight(azimuth, elevation).direction
    np.testing.assert_allclose(found, direction, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("lamp", "arguments", "message"),
    [
        (DirectionalLight, (math.nan, 0), "azimuth: .* finite number of degrees, found nan"),
        (DirectionalLight, (0, math.inf), "elevation: expected a finite number of degrees"),
        (DirectionalLight, ("left", 0), "azimuth: .* finite number of degrees, found 'left'"),
        *(
            (DirectionalLight, (0, 0, color), "color: expected three finite numbers, 0 or more")
            for color in ((1, 1, -0.1), (1, 1, math.nan), (1, 1), 3)
        ),
        *(
            (DirectionalLight, (0, 0, (1, 1, 1), softness), "softness: expected 0 to 45 degrees")
            for softness in (-1, 46, math.nan, "soft")
        ),
        (PointLight, ((0, 0),), "position: expected three finite numbers, found"),
        (PointLight, ((0, 0, math.nan),), "position: expected three finite numbers"),
        (PointLight, ((0, 0, 1), (1, -1, 1)), "color: expected three finite numbers, 0 or more"),
        (PointLight, ((0, 0, 1), (1, 1, 1), -1), "radius: expected a finite number, 0 or more"),
    ],
)
def test_unusable_lights_are_refused(
    lamp: type[DirectionalLight | PointLight], arguments: tuple[Any, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        lamp(*arguments)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "side"),
    [(90, 0, "right"), (-90, 0, "left"), (0, 90, "up"), (0, -90, "down"), (0, 0, "front")],
)
def test_a_light_lights_the_surfaces_that_face_it(
    sphere: Result, azimuth: float, elevation: float, side: str
) -> None:
    picture = relight(sphere, DirectionalLight(azimuth, elevation))
    assert side_lit(picture) == side
    n_l = sphere.normals @ DirectionalLight(azimuth, elevation).direction
    assert (picture[n_l < 0] == 0).all()
    assert (picture[n_l > 0] > 0).all()


@pytest.mark.parametrize(
    ("column", "row", "side"),
    [(0.75, 0.5, "right"), (0.5, 0.03, "up")],
)
def test_a_panorama_lights_its_side(sphere: Result, column: float, row: float, side: str) -> None:
    for light in (panorama.project(spot(column, row)), Environment(spot(column, row))):
        assert side_lit(relight(sphere, light)) == side


def test_turning_by_90_sends_what_is_behind_the_scene_to_the_left(sphere: Result) -> None:
    # A panorama's centre is −Z, azimuth 180; + 90 is −X. The viewer's light, at its edge, is at +X.
    behind, front = panorama.project(spot(0.5)), panorama.project(spot(0.99))
    assert side_lit(relight(sphere, turned(behind, 90))) == "left"
    assert side_lit(relight(sphere, turned(front, 90))) == "right"
    assert side_lit(relight(sphere, turned(DirectionalLight(0, 0), 90))) == "right"


def test_a_picture_of_a_hard_light_and_of_its_sh_light_agree_where_surfaces_are_matt(
    result: Result,
) -> None:
    # What albedo adds sees l ≤ 2 alone; of a lamp's clamped cosine the rest is 9 % (RMS).
    black = ball(result, albedo=0.0, roughness=1.0)
    white = ball(result, albedo=1.0, roughness=1.0)
    lamp = DirectionalLight(40, 20)
    projected = math.pi * pbrfit.kernel.sh_basis(lamp.direction)[:, None] * np.ones(3)
    hard, soft = (
        np.nan_to_num(relight(white, light) - relight(black, light)) for light in (lamp, projected)
    )
    error = np.sqrt(np.mean((hard - soft) ** 2) / np.mean(hard**2))
    assert error < 0.1
    assert np.corrcoef(hard.ravel(), soft.ravel())[0, 1] > 0.99


def test_the_light_of_a_picture_gives_its_reconstruction(result: Result) -> None:
    all_at_once = relight(result, result.lighting)
    expected = pbrfit.kernel.render(result.materials, result.normals, result.lighting, result.fov)
    np.testing.assert_array_equal(all_at_once, expected)
    error = float(np.sqrt(np.nanmean((all_at_once - np.asarray(room().images, np.float64)) ** 2)))
    assert error == pytest.approx(result.metrics["recon_rmse"], rel=1e-9)
    for asked in ({"light": result.lights[1]}, {"picture": 1}, {"picture": result.pictures[1]}):
        np.testing.assert_array_equal(result.relight(**asked), expected[1])
    for wrong in ({}, {"light": expected, "picture": 0}, {"picture": 3}, {"picture": "none"}):
        with pytest.raises(InputError, match=r"^(light|picture): expected "):
            result.relight(**wrong)
    assert result.verdicts == known(result.uncertainty).verdicts


def test_a_soft_lamp_lets_light_go_out_softly(sphere: Result) -> None:
    hard, soft = (relight(sphere, DirectionalLight(60, 0, softness=size)) for size in (0, 20))
    dark = np.nan_to_num(hard).max(axis=-1) == 0
    assert np.nan_to_num(soft)[dark & sphere.mask].max() > 0
    assert np.nanmax(soft) < np.nanmax(hard)


def test_surroundings_dim_a_panorama_and_never_make_it_negative() -> None:
    result = shaded_ball()
    light = Environment(spot(0.2, 0.3) + 0.05)
    shaded, whole = (relight(result, light, shadows=shadows) for shadows in (True, False))
    inside = result.mask
    assert (shaded[inside] <= whole[inside] + 1e-12).all()
    assert shaded[inside].min() >= 0
    assert shaded[inside].mean() < 0.95 * whole[inside].mean()
