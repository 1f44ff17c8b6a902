"""Panoramas and SH lights: axes, quadrature, rotation, what is lost, ringing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pbrfit import InputError
from pbrfit.io import images
from pbrfit.kernel import sh_basis
from pbrfit.model import panorama
from pbrfit.model.lighting import rotated

AXES = [
    ((0.5, 0.5), (0, 0, -1)),
    ((0.75, 0.5), (1, 0, 0)),
    ((0.25, 0.5), (-1, 0, 0)),
    ((0.0, 0.5), (0, 0, 1)),
    ((0.5, 0.0), (0, 1, 0)),
    ((0.5, 1.0), (0, -1, 0)),
]
"""Share of width and height, and the direction that is seen there."""


def light(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(16, 3))


def lamp(direction: tuple[float, float, float], height: int = 64) -> np.ndarray:
    """A small bright disc in grey surroundings."""
    near = panorama.directions(height, 2 * height) @ np.array(direction, dtype=float) > 0.95
    return np.asarray(np.where(near, 20.0, 0.2)[..., None] * np.array([1.0, 0.9, 0.8]))


@pytest.mark.parametrize(("at", "direction"), AXES)
def test_the_centre_is_minus_z_the_right_plus_x_the_top_plus_y(
    at: tuple[float, float], direction: tuple[int, int, int]
) -> None:
    height, width = 500, 1000
    row, column = min(round(at[1] * height), height - 1), min(round(at[0] * width), width - 1)
    seen = panorama.directions(height, width)[row, column]
    np.testing.assert_allclose(seen, direction, atol=0.01)


@pytest.mark.parametrize("height", [1, 2, 3, 7, 8, 65, 512])
def test_solid_angles_are_positive_and_fill_the_sphere(height: int) -> None:
    weights = panorama.solid_angles(height, 2 * height)
    assert weights.min() > 0
    assert weights.sum() * 2 * height == pytest.approx(4 * np.pi, rel=1e-14)


@pytest.mark.parametrize("height", [7, 8, 33, 128])
def test_an_sh_light_comes_back_from_its_panorama_to_rounding(height: int) -> None:
    there = panorama.radiance(light(), height)
    assert np.abs(panorama.project(there) - light()).max() < 1e-13


@given(st.floats(-720, 720), st.integers(0, 2**32 - 1))
def test_a_turned_light_comes_from_turned_directions(degrees: float, seed: int) -> None:
    t = np.radians(degrees)
    turn = np.array([[np.cos(t), 0, np.sin(t)], [0, 1, 0], [-np.sin(t), 0, np.cos(t)]])
    d = panorama.directions(5, 10)
    there = sh_basis(d @ turn.T) @ rotated(light(seed), degrees)
    np.testing.assert_allclose(there, sh_basis(d) @ light(seed), atol=1e-12)


def test_rotate_takes_light_from_the_viewer_to_the_right() -> None:
    from_viewer = lamp((0, 0, 1))
    from_right = panorama.project(lamp((1, 0, 0)))
    np.testing.assert_allclose(rotated(panorama.project(from_viewer), 90), from_right, atol=2e-2)
    assert np.abs(rotated(panorama.project(from_viewer), -90) - from_right).max() > 1


def test_damping_against_ringing() -> None:
    rings = panorama.project(lamp((0.6, 0.48, 0.64)))
    assert panorama.darkest(rings) < -0.05
    mended = panorama.nonnegative(rings)
    np.testing.assert_array_equal(mended[0], rings[0])  # the mean light
    # No stronger than it has to be: somewhere there is no light left.
    assert 0 <= panorama.darkest(mended) < 1e-6
    assert np.linalg.norm(mended[1:4]) > 0.5 * np.linalg.norm(rings[1:4])


def test_a_light_that_does_not_ring_is_left_alone() -> None:
    soft = np.zeros((16, 3))
    soft[0], soft[2] = 1.0, 0.1
    np.testing.assert_array_equal(panorama.nonnegative(soft), soft)
    np.testing.assert_array_equal(panorama.nonnegative(0 * soft), 0 * soft)


def one_negative(value: float) -> np.ndarray:
    pixels = np.ones((8, 16, 3))
    pixels[2, 5, 0] = value
    return pixels


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (np.ones((8, 8, 3)), r"expected a panorama twice as wide as high .*, found 8 × 8"),
        (np.full((8, 16, 3), np.nan), "found NaN or infinity in 128 pixels, the first in column 0"),
        (np.full((8, 16, 3), np.inf), "found NaN or infinity in 128 pixels"),
        (np.full((8, 16, 3), -1.0), "found negative radiance in 128 pixels"),
        (one_negative(-3.0), "found negative radiance in 1 pixels, the first in column 5 of ro"),
        (np.ones((6, 12, 3)), "expected a panorama of 14 × 7 pixels or more, found 12 × 6"),
    ],
)
def test_what_is_no_panorama_is_refused(pixels: np.ndarray, message: str, tmp_path: Path) -> None:
    path = tmp_path / "sky.exr"
    images.write_exr(path, {name: pixels[..., c] for c, name in enumerate("RGB")})
    with pytest.raises(InputError, match=message) as caught:
        panorama.read(path)
    assert str(caught.value).startswith(str(path))


def test_wrong_pixels_are_mended_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "sky.exr"
    for value, mended in ((-1e-3, 0), (-0.3, 0), (np.inf, 65504)):
        images.write_exr(path, {c: one_negative(value)[..., i] for i, c in enumerate("RGB")})
        np.testing.assert_array_equal(panorama.read(path), one_negative(mended))
        assert f"sky.exr: 1 pixels are {'inf' if value > 0 else 'neg'}" in caplog.text
        caplog.clear()


def test_colours_beyond_rec_709_are_light_too(tmp_path: Path) -> None:
    """Such as the green of ACEScg, whose red is negative in Rec.709."""
    path = tmp_path / "green.exr"
    green = {"R": np.zeros((8, 16)), "G": np.ones((8, 16)), "B": np.zeros((8, 16))}
    images.write_exr(path, green)
    read = panorama.read(path, "acescg")
    assert (read[..., 0] < 0).all()
    found = panorama.project(read)
    np.testing.assert_allclose(found[0], 2 * np.sqrt(np.pi) * read[0, 0], rtol=1e-6)


def test_clipped_panoramas_are_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    codes = np.full((8, 16, 3), 100, np.uint8)
    path = tmp_path / "sky.png"
    images.write_png(path, codes, "srgb")
    panorama.read(path)
    assert not caplog.messages
    codes[0, :4] = 255
    images.write_png(path, codes, "srgb")
    panorama.read(path)
    assert "3.1 % of the pixels are clipped" in caplog.text
