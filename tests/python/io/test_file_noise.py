"""What files do to samples, predicted by their codes and tables, against the true pictures."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageOps
from scipy.stats import spearmanr

from pbrfit import Scene
from pbrfit.io import color, images, jpeg_noise
from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.io.file_noise import FileNoise
from pbrfit.io.resampling import averaged_channels
from pbrfit.synthetic import make_scene
from scene_files import write_exr, write_folder, write_normals

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
    assert picture.stored is not None
    height, width = picture.pixels.shape[:2]
    return picture.stored.noise(size or (height, width))


def rms_of_blocks(values: Array) -> Array:
    """(blocks, 3)."""
    height, width = (length // 8 * 8 for length in values.shape[:2])
    blocks = values[:height, :width].reshape(height // 8, 8, width // 8, 8, 3).astype(np.float64)
    return np.asarray(np.sqrt(np.square(blocks).mean(axis=(1, 3))).reshape(-1, 3))


# Rounding


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


def test_slopes_of_curves_are_their_derivatives() -> None:
    codes = np.array([0, 1, 9, 10, 11, 12, 100, 254])
    between = decode_srgb((codes[:, None] + [0.0, 0.01]) / 255)
    slopes = np.diff(between, axis=1)[:, 0] / 0.01
    linear = np.repeat(between[:, :1], 3, axis=1).astype(np.float32)
    found = color.Conversion("srgb").slopes(linear, 256)
    np.testing.assert_allclose(found[:, 0], slopes, rtol=0.01)
    curve = decode_srgb(np.arange(256) / 255).astype(np.float32)[None]
    of_table = color.Conversion(curve).slopes(linear, 256)
    np.testing.assert_allclose(of_table[1:, 0], slopes[1:], rtol=0.03)


def test_the_mean_of_n_has_a_deviation_less_by_their_root(tmp_path: Path) -> None:
    grey = np.full((48, 36, 3), 90, dtype=np.uint8)
    images.write_png(tmp_path / "a.png", grey, tag="srgb")
    picture = images.read_picture(tmp_path / "a.png")
    whole = noise_of(picture).deviation(picture.pixels)[0, 0]
    small = noise_of(picture, (16, 12)).deviation(picture.pixels[:16, :12])
    np.testing.assert_allclose(small, np.broadcast_to(whole / 3, small.shape), rtol=1e-5)


# JPEG


@pytest.mark.parametrize("kind", ["textured", "room"])
@pytest.mark.parametrize("chroma", ["4:4:4", "4:2:2", "4:2:0"])
@pytest.mark.parametrize("quality", [60, 75, 90, 98])
def test_errors_of_jpeg_are_predicted(tmp_path: Path, kind: str, chroma: str, quality: int) -> None:
    true_squares, found_squares, ranks = 0.0, 0.0, []
    for true in rendered(kind):
        Image.fromarray(codes_of(true)).save(
            tmp_path / "a.jpg", quality=quality, subsampling=chroma
        )
        picture = images.read_picture(tmp_path / "a.jpg")
        deviation = noise_of(picture).deviation(picture.pixels)
        ordinary = 1.0 if picture.limits is None else picture.limits == 0
        error = ordinary * (picture.pixels - true)
        true_squares += float(np.square(error).sum())
        found_squares += float(np.square(ordinary * deviation).sum())
        of_true, of_found = rms_of_blocks(error), rms_of_blocks(ordinary * deviation)
        ranks += [spearmanr(of_true[:, c], of_found[:, c])[0] for c in range(3)]
    ratio = np.sqrt(found_squares / true_squares)
    print(f"{kind} {chroma} {quality}: {ratio:.2f} of the errors, ranks {np.mean(ranks):.2f}")
    # What was lost with chroma is extrapolated.
    assert ratio == pytest.approx(1, abs=0.2 if chroma == "4:4:4" else 0.3)
    assert np.mean(ranks) > 0.6


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
    print(f"{quality} {chroma}: {measured:.2f}, predicted {np.mean(predicted):.2f}")
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
    print(f"{size}: {ratio:.2f}")
    assert ratio == pytest.approx(1, abs=off)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_blocks_are_turned_with_the_picture(tmp_path: Path, orientation: int) -> None:
    rng = np.random.default_rng(2)
    codes = np.full((43, 61, 3), 100, dtype=np.uint8)
    codes[16:24, 40:48] = rng.integers(60, 180, (8, 8, 1))  # one block that is not flat
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=80, subsampling=0, exif=exif)
    picture = images.read_picture(tmp_path / "a.jpg")
    slope = color.Conversion("srgb").slopes(picture.pixels, 256)
    busy = noise_of(picture).deviation(picture.pixels)[..., 0] / slope[..., 0] > 2
    marks = Image.fromarray(np.zeros((43, 61), np.uint8))
    marks.paste(255, (40, 16, 48, 24))
    marks.getexif()[0x0112] = orientation
    np.testing.assert_array_equal(busy, np.asarray(ImageOps.exif_transpose(marks)) > 0)


def test_a_flat_picture_has_the_errors_of_its_first_coefficient(tmp_path: Path) -> None:
    Image.fromarray(np.full((32, 32), 77, np.uint8)).save(tmp_path / "a.jpg", quality=50)
    picture = images.read_picture(tmp_path / "a.jpg")
    found = noise_of(picture).blocks
    assert found is not None
    # q = 16: 16²/12 of one of 64 coefficients, and two roundings.
    assert found.shape == (4, 4, 3)
    np.testing.assert_allclose(found, np.sqrt(16**2 / 12 / 64 + 2 / 12), rtol=1e-3)


@pytest.mark.parametrize("mode", ["CMYK", "L"])
def test_other_components_than_three(tmp_path: Path, mode: str) -> None:
    Image.new(mode, (16, 16), 60 if mode == "L" else (60, 20, 10, 9)).save(tmp_path / "a.jpg")
    data = (tmp_path / "a.jpg").read_bytes()
    tables = jpeg_noise.read_tables(data, 3)
    assert tables is None
    assert (jpeg_noise.read_tables(data, 1) is not None) == (mode == "L")
    assert jpeg_noise.read_tables(data[:200], 1) is None
    assert jpeg_noise.read_tables(b"", 3) is None


@pytest.mark.parametrize("u", [1e-6, 0.9e-2, 1.1e-2, 0.05, 1.0, 9.0, 80.0, 300.0])
def test_moments_of_a_laplacian_inside_bins(u: float) -> None:
    """By quadrature, with q = 1, β = 1/u; on both sides of where densities count as flat."""
    x = (np.arange(1_000_000) + 0.5) / 1_000_000
    zero, other = x / 2, x  # |c| in the bin of 0, and above the lower border of another
    squares = []
    for values, deviation in ((zero, zero), (other, other - 0.5)):
        density = np.exp(-u * values)
        density /= density.sum()
        squares.append(density @ np.square(deviation))
        if values is zero:
            mean = density @ values
    one = np.ones((1, 1), dtype=np.float32)
    found = jpeg_noise._sizes(0 * one, one[0], one / np.float32(u))
    np.testing.assert_allclose(found, mean, rtol=2e-3)
    of_zero, inside = jpeg_noise._squares(np.float32(u) * one)
    np.testing.assert_allclose(of_zero[0, 0], squares[0], rtol=3e-3)
    np.testing.assert_allclose(inside[0, 0], squares[1], rtol=3e-3)


# In scenes


def test_the_noise_floor_of_scenes(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", "8-bit PNG")
    floats = Scene.load(write_folder(tmp_path / "floats"))
    assert floats.noise_floor(0) is None
    assert "encoding" not in floats.assumed
    scene = Scene.load(folder)
    floor = scene.noise_floor(1)
    assert floor is not None
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
        "2 files 8-bit JPEG, mean quantisation step 12; "
        "1 files 8-bit JPEG, mean quantisation step 46, chroma at 1/2 resolution"
    )
    assert scene.noise_floor(3) is None
    assert scene.noise_floor(2) is not None
