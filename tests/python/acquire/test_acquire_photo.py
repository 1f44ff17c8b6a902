"""The photograph: read upright, at a size, with what a network is shown of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire.photo import read_photo
from pbrfit.io import images
from pbrfit.io.color import decode_srgb
from scene_files import known

ORIENTATION, FOCAL_LENGTH_35MM, EXIF_IFD = 0x0112, 0xA405, 0x8769


def noise(*shape: int) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)


LONG = Image.fromarray(noise(100, 3000, 3))


@pytest.mark.parametrize("size", [(97, 131), (131, 97)])
def test_a_network_is_shown_the_bytes_of_an_8_bit_file(
    size: tuple[int, int], tmp_path: Path
) -> None:
    Image.fromarray(noise(*size, 3)).save(tmp_path / "photo.png")
    photo = read_photo(tmp_path / "photo.png")
    assert photo.size == photo.full_size == size
    np.testing.assert_array_equal(photo.srgb8(), noise(*size, 3))
    np.testing.assert_allclose(
        photo.pixels, decode_srgb(noise(*size, 3) / 255), rtol=1e-6, atol=1e-9
    )
    assert photo.mask is None
    assert photo.fov is None
    assert photo.exposure == 0


def test_a_photograph_is_turned_as_its_exif_says(tmp_path: Path) -> None:
    codes = noise(80, 120, 3)
    exif = Image.Exif()
    exif[ORIENTATION] = 6  # to be turned clockwise
    exif.get_ifd(EXIF_IFD)[FOCAL_LENGTH_35MM] = 28
    Image.fromarray(codes).save(tmp_path / "photo.png", exif=exif)
    photo = read_photo(tmp_path / "photo.png")
    assert photo.full_size == (120, 80)
    np.testing.assert_array_equal(photo.srgb8(), np.rot90(codes, -1))
    # 28 mm across the diagonal of 36 × 24 mm, the shorter side horizontal.
    diagonal = np.hypot(36, 24)
    half = diagonal / 2 * 80 / np.hypot(80, 120) / 28
    assert photo.fov == pytest.approx(2 * np.degrees(np.arctan(half)))


@pytest.mark.parametrize("max_size", [256, 64])
def test_transparent_pixels_are_left_out_and_shown_as_the_mean(
    tmp_path: Path, max_size: int
) -> None:
    """And what is under them does not run into outlines."""
    codes = np.full((256, 256, 4), 255, dtype=np.uint8)
    codes[..., :3] = (200, 100, 50)
    codes[:, :101] = (0, 255, 0, 0)
    Image.fromarray(codes, "RGBA").save(tmp_path / "photo.png")
    photo = read_photo(tmp_path / "photo.png", max_size=max_size)
    first = -(-101 * max_size // 256) - (max_size == 64)
    np.testing.assert_array_equal(np.flatnonzero(known(photo.mask)[0]), np.arange(first, max_size))
    shown = np.broadcast_to((200, 100, 50), (max_size, max_size, 3))
    np.testing.assert_array_equal(photo.srgb8(), shown)
    assert photo.assumed["alpha"].endswith("transparent or infinite pixels left out")


@pytest.mark.parametrize("unit", [1e-3, 1.0, 700.0])
def test_a_float_file_is_shown_at_an_exposure_that_fits(unit: float, tmp_path: Path) -> None:
    radiance = np.random.default_rng(0).uniform(0.01, 1, (80, 90)).astype(np.float32)
    radiance[:5, :5] = 50  # a lamp: 0.3 % of the pixels
    images.write_exr(tmp_path / "photo.exr", dict.fromkeys("RGB", unit * radiance))
    photo = read_photo(tmp_path / "photo.exr")
    np.testing.assert_allclose(photo.pixels[..., 0], np.float32(unit * radiance), rtol=1e-6)
    above_white = np.mean(photo.pixels * 2**photo.exposure > 1)
    assert above_white == pytest.approx(0.01, abs=1e-3)
    assert np.mean(photo.srgb8() == 255) == pytest.approx(above_white, abs=0.005)  # code 254.5 on
    assert photo.exposure == pytest.approx(-np.log2(unit), abs=0.05)
    assert "below white" in photo.assumed["exposure"]


def test_the_least_photograph_has_64_pixels_a_side(tmp_path: Path) -> None:
    Image.fromarray(noise(64, 64, 3)).save(tmp_path / "least.png")
    assert read_photo(tmp_path / "least.png").size == (64, 64)


def black(path: Path) -> None:
    images.write_exr(path, {"Y": np.zeros((80, 80), dtype=np.float32)})


@pytest.mark.parametrize(
    ("name", "write", "max_size", "message"),
    [
        (
            "small.png",
            Image.fromarray(noise(63, 200, 3)).save,
            1024,
            "small.png: expected a photograph of at least 64 × 64 pixels, found 200 × 63",
        ),
        ("long.png", LONG.save, 1024, "which max_size 1024 makes 1024 × 34"),
        ("long.png", LONG.save, 63, "max_size: expected at least 64 pixels, found 63"),
        ("black.exr", black, 1024, r"black\.exr: expected radiance above 0, found none"),
    ],
)
def test_photographs_that_cannot_be_used(
    tmp_path: Path, name: str, write: Callable[[Path], None], max_size: int, message: str
) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=message):
        read_photo(tmp_path / name, max_size=max_size)
