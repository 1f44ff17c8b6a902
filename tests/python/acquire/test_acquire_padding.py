"""Sizes that networks take: pictures come back pixel on pixel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire.padding import FLUX2_KLEIN, GPT_IMAGE_2, Frame, Limits, frame, resized_srgb8

sides = st.integers(64, 6000)


def picture(height: int, width: int) -> NDArray[np.uint8]:
    """Waves of 17 to 57 pixels in several directions: every shift shows, and no scaling aliases."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    waves = np.stack(
        [
            np.sin(x / 5 + 0.3) + np.cos(y / 4),
            np.sin((x + y) / 6) + np.cos((x - 2 * y) / 9),
            np.cos(x / 3) * np.sin(y / 6 + 1),
        ],
        axis=-1,
    )
    return np.asarray(np.rint(128 + 50 * waves), dtype=np.uint8)


def shift_between(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """How far b lies from a, in pixels: the least squares of b − a = −∇a · shift (Lucas-Kanade)."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    down, across = (np.gradient(a, axis=k)[8:-8, 8:-8].ravel() for k in (0, 1))
    steps = np.stack([down, across], axis=1)
    shift, *_ = np.linalg.lstsq(steps, (a - b)[8:-8, 8:-8].ravel(), rcond=None)
    return float(np.hypot(*shift))


def check_proportions(found: Frame) -> None:
    """Scaling keeps them to half a pixel."""
    scale = max(found.scaled) / max(found.size)
    for side, whole in zip(found.scaled, found.size, strict=True):
        assert abs(side - scale * whole) <= 0.5 + 1e-9


@settings(deadline=None)  # a busy machine is no error
@given(sides, sides)
def test_flux_gets_whole_blocks_that_it_neither_cuts_nor_scales(height: int, width: int) -> None:
    found = frame((height, width), FLUX2_KLEIN)
    check_proportions(found)
    rows, columns = found.padded
    assert rows % 16 == columns % 16 == 0
    assert min(rows, columns) >= 64
    assert rows * columns <= 1024 * 1024
    assert max(rows, columns) <= 8 * min(rows, columns)
    assert all(0 <= inner <= whole for inner, whole in zip(found.scaled, found.padded, strict=True))
    if -(-height // 16) * -(-width // 16) * 256 <= 1024 * 1024 and max(height, width) <= 1024:
        assert found.scaled == found.size  # nothing is scaled that need not be


@settings(deadline=None)  # a busy machine is no error
@given(sides, sides)
def test_gpt_image_gets_a_size_that_it_takes(height: int, width: int) -> None:
    found = frame((height, width), GPT_IMAGE_2)
    check_proportions(found)
    rows, columns = found.padded
    assert rows % 16 == columns % 16 == 0
    assert max(rows, columns) <= 3840
    assert 655_360 <= rows * columns <= 2560 * 1440
    assert max(rows, columns) <= 3 * min(rows, columns)


@pytest.mark.parametrize(
    "size", [(97, 131), (131, 97), (64, 64), (768, 1024), (1024, 1024), (640, 480), (65, 1000)]
)
def test_a_network_that_changes_nothing_gives_the_same_bytes_back(size: tuple[int, int]) -> None:
    photo = picture(*size)
    found = frame(size, FLUX2_KLEIN)
    assert found.scaled == size
    np.testing.assert_array_equal(found.from_model(found.to_model(photo)), photo)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "limits"),
    [
        ((1500, 2000), FLUX2_KLEIN),
        ((2000, 1500), FLUX2_KLEIN),
        ((1001, 1049), FLUX2_KLEIN),
        ((300, 5000), FLUX2_KLEIN),
        ((97, 131), GPT_IMAGE_2),
        ((131, 97), GPT_IMAGE_2),
        ((100, 700), GPT_IMAGE_2),
        ((2001, 2503), GPT_IMAGE_2),
    ],
)
def test_a_scaled_picture_comes_back_where_it_was(size: tuple[int, int], limits: Limits) -> None:
    photo = picture(*size)
    found = frame(size, limits)
    assert found.scaled != size
    back = found.from_model(found.to_model(photo))
    assert back.shape == photo.shape
    assert shift_between(photo, back) < 0.01
    # What is left is the smoothing of waves of 17 pixels and more, at scales down to 0.57.
    assert np.sqrt(np.mean((back.astype(float) - photo) ** 2)) < 1.2


def test_scaling_is_in_linear_light_and_stays_in_the_range_of_the_values() -> None:
    stripes = np.zeros((64, 128, 3), dtype=np.uint8)
    stripes[:, ::2] = 255
    # Half of the light is code 188, not 128.
    np.testing.assert_array_equal(resized_srgb8(stripes, (32, 64)), np.uint8(188))
    step = np.full((64, 64, 3), 60, dtype=np.uint8)
    step[:, 32:] = 200
    grown = resized_srgb8(step, (150, 130))
    assert (grown.min(), grown.max()) == (60, 200)
    flat = np.full((100, 100, 3), 77, dtype=np.uint8)  # one side grows and the other shrinks
    np.testing.assert_array_equal(resized_srgb8(flat, (60, 150)), np.uint8(77))


def test_other_sizes_are_refused() -> None:
    found = frame((97, 131), FLUX2_KLEIN)
    with pytest.raises(InputError, match="generated picture: expected 144 × 112 pixels"):
        found.from_model(picture(112, 128))
    with pytest.raises(InputError, match="photo: expected a size that the network can be given"):
        frame((100, 100), Limits(least_side=512, most_area=256 * 256))
