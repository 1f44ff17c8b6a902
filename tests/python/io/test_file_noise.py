"""What files do to samples, predicted by their codes and tables, against the true pictures."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pbrfit import Scene
from pbrfit.io import color, file_noise, images
from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.io.file_noise import FileNoise
from pbrfit.io.resampling import averaged_channels
from pbrfit.synthetic import make_scene
from scene_files import known, write_exr, write_folder, write_normals

Array = NDArray[np.floating[Any]]


@cache
def rendered(kind: str) -> Array:
    """Three pictures without noise, exposed so that little is clipped."""
    scene = make_scene(kind, size=128, lights=3, held_out=1, seed=3, noise=0.0)
    pictures = np.nan_to_num(scene.images).astype(np.float64)
    return np.asarray(np.clip(pictures / np.quantile(pictures, 0.995), 0, 1))


def codes_of(linear: Array) -> NDArray[np.uint8]:
    return np.asarray(np.round(255 * encode_srgb(linear)).astype(np.uint8))


def noise_of(picture: images.Picture, size: tuple[int, int] | None = None) -> FileNoise:
    height, width = picture.pixels.shape[:2]
    return known(picture.stored).noise(size or (height, width))


@pytest.mark.parametrize("space", ["srgb", "linear", "display-p3"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_rounding_is_off_by_its_standard_deviation(tmp_path: Path, space: Any, kind: Any) -> None:
    rng = np.random.default_rng(1)
    levels = int(np.iinfo(kind).max)
    exact = rng.uniform(0.02, 0.98, (64, 64, 3)) * levels
    images.write_png(tmp_path / "a.png", np.rint(exact).astype(kind), tag=None)
    picture = images.read_picture(tmp_path / "a.png", space)
    true = exact / levels if space == "linear" else decode_srgb(exact / levels)
    if space == "display-p3":
        true = true @ color.to_rec709(color.DISPLAY_P3).T
    error = (picture.pixels - true) / noise_of(picture).deviation(picture.pixels)
    if kind == np.uint8:  # of 16 bits float32 itself takes a part
        np.testing.assert_allclose(np.sqrt(np.square(error).mean(axis=(0, 1))), 1, atol=0.03)


@pytest.mark.parametrize("kind", ["textured", "room"])
@pytest.mark.parametrize("chroma", ["4:4:4", "4:2:2", "4:2:0"])
@pytest.mark.parametrize("quality", [60, 75, 90, 98])
def test_errors_of_jpeg_are_predicted(tmp_path: Path, kind: str, chroma: str, quality: int) -> None:
    true_squares = found_squares = 0.0
    for true in rendered(kind):
        Image.fromarray(codes_of(true)).save(
            tmp_path / "a.jpg", quality=quality, subsampling=chroma
        )
        picture = images.read_picture(tmp_path / "a.jpg")
        deviation = noise_of(picture).deviation(picture.pixels)
        ordinary = 1.0 if picture.limits is None else picture.limits == 0
        true_squares += float(np.square(ordinary * (picture.pixels - true)).sum())
        found_squares += float(np.square(ordinary * deviation).sum())
    ratio = np.sqrt(found_squares / true_squares)
    # What was lost with chroma is extrapolated.
    assert ratio == pytest.approx(1, abs=0.2 if chroma == "4:4:4" else 0.3)


@pytest.mark.parametrize(
    ("quality", "chroma"), [(98, "4:4:4"), (90, "4:4:4"), (75, "4:4:4"), (90, "4:2:0")]
)
def test_what_jpeg_loses_of_one_view_is_alike_in_all_pictures(
    tmp_path: Path, quality: int, chroma: str
) -> None:
    """The mean square of sums over pictures against that of samples, as of correlated errors."""
    scene = make_scene("room", size=64, lights=12, held_out=1, seed=410, noise=0.0)
    pictures = np.nan_to_num(scene.images).astype(np.float64)
    errors, predicted = [], []
    for true in np.clip(pictures / np.quantile(pictures, 0.995), 0, 1):
        Image.fromarray(codes_of(true)).save(
            tmp_path / "a.jpg", quality=quality, subsampling=chroma
        )
        picture = images.read_picture(tmp_path / "a.jpg")
        noise = noise_of(picture)
        errors.append((picture.pixels - true) / noise.deviation(picture.pixels))
        predicted.append(noise.correlation)
    of_mean = np.square(np.mean(errors, axis=0)).mean() / np.square(errors).mean()
    measured = (len(errors) * of_mean - 1) / (len(errors) - 1)
    assert np.mean(predicted) == pytest.approx(measured, abs=0.15)


@pytest.mark.parametrize(("size", "off"), [(64, 0.1), (50, 0.1), (16, 0.3), (9, 0.4)])
def test_errors_of_averaged_jpeg_are_predicted(tmp_path: Path, size: int, off: float) -> None:
    """In means of many samples the bias counts that the curve makes of large errors."""
    true = rendered("textured")[0]
    Image.fromarray(codes_of(true)).save(tmp_path / "a.jpg", quality=75, subsampling=0)
    picture = images.read_picture(tmp_path / "a.jpg")
    pixels, expected = (averaged_channels(one, (size, size)) for one in (picture.pixels, true))
    deviation = noise_of(picture, (size, size)).deviation(pixels)
    ratio = np.sqrt(np.square(deviation).mean() / np.square(pixels - expected).mean())
    assert ratio == pytest.approx(1, abs=off)


def test_turned_pictures_are_averaged_along_their_own_sides(tmp_path: Path) -> None:
    codes, exif, found = codes_of(rendered("textured")[0])[:88], Image.Exif(), []
    for orientation, size in ((1, (22, 128)), (3, (22, 128)), (6, (128, 22))):
        exif[0x0112] = orientation
        Image.fromarray(codes).save(tmp_path / "a.jpg", subsampling="4:2:2", exif=exif)
        found.append(noise_of(images.read_picture(tmp_path / "a.jpg"), size).variance)
    np.testing.assert_array_equal(found[1:], [found[0]] * 2)


def test_a_flat_picture_has_the_errors_of_its_first_coefficient(tmp_path: Path) -> None:
    Image.fromarray(np.full((32, 32), 77, np.uint8)).save(tmp_path / "a.jpg", quality=50)
    found = noise_of(images.read_picture(tmp_path / "a.jpg")).variance
    # q = 16: 16²/12 of one of 64 coefficients, and three roundings. Others may not be quite 0.
    ratio = np.sqrt(found / (16**2 / 12 / 64 + 3 / 12))
    assert ratio == pytest.approx(np.full(3, 1.06), abs=0.06)


@pytest.mark.parametrize("mode", ["CMYK", "L"])
def test_other_components_than_three(tmp_path: Path, mode: str) -> None:
    Image.new(mode, (16, 16), 60 if mode == "L" else (60, 20, 10, 9)).save(tmp_path / "a.jpg")
    data = (tmp_path / "a.jpg").read_bytes()
    tables = file_noise.read_tables(data, 3)
    assert tables is None
    assert (file_noise.read_tables(data, 1) is not None) == (mode == "L")
    assert file_noise.read_tables(data[:200], 1) is None
    assert file_noise.read_tables(b"", 3) is None


def test_the_noise_floor_of_scenes(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", "8-bit PNG")
    floats = Scene.load(write_folder(tmp_path / "floats"))
    assert floats.noise_floor(0) is None
    assert "encoding" not in floats.assumed
    scene = Scene.load(folder)
    floor = known(scene.noise_floor(1))
    assert floor.shape == scene.images.shape[1:]
    assert floor.dtype == np.float32
    assert scene.assumed["encoding"] == "8-bit PNG"
    picture = images.read_picture(folder / "images" / f"{scene.names[1]}.png")
    np.testing.assert_array_equal(floor, noise_of(picture).deviation(picture.pixels))


def test_encodings_are_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for i, (quality, chroma) in enumerate([(90, "4:4:4"), (90, "4:4:4"), (60, "4:2:0")]):
        codes = codes_of(rendered("room")[i])
        Image.fromarray(codes).save(
            tmp_path / "images" / f"{i}.jpg", quality=quality, subsampling=chroma
        )
    write_exr(tmp_path / "images" / "3.exr", rendered("room")[0])
    write_normals(tmp_path, np.broadcast_to([0, 0, 1], (128, 128, 3)))
    (tmp_path / "scene.toml").write_text("fov = 60\n", encoding="utf-8")
    scene = Scene.load(tmp_path)
    assert scene.assumed["encoding"] == (
        "8-bit JPEG, mean quantisation step 12: 0.jpg, 1.jpg; "
        "8-bit JPEG, mean quantisation step 46, chroma at 1/2 resolution: 2.jpg"
    )
    assert scene.noise_floor(3) is None
    assert scene.noise_floor(2) is not None
