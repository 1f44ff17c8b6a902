"""The scene folder (docs/formats.md): what is read, what is assumed, what is refused."""

from __future__ import annotations

import dataclasses
import hashlib
import logging
import os
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageCms

from pbrfit import InputError, Scene, Truth, threads
from pbrfit.acquire.photo import shown_to_network
from pbrfit.io import images, normal_files
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.model.lighting import Lighting
from pbrfit.scene.reading import read_pictures
from pbrfit.synthetic import make_scene
from scene_files import (
    FORMATS,
    LIGHTS,
    SIZE,
    held_out_of,
    known,
    lights_of,
    room,
    truth_of,
    write_exr,
    write_folder,
    write_jpeg,
    write_normals,
)
from scene_files import write_integers as write_png


def retag(folder: Path, tags: dict[str, dict[int, Any]]) -> list[Path]:
    """The folder's pictures in JPEG, some with EXIF tags; of PNG what is so named."""
    paths = []
    for name, image in zip(room().names, room().images, strict=True):
        exif = Image.Exif()
        for tag, value in tags.get(name, {}).items():
            exif[tag] = value
        paths.append(folder / "images" / f"{name}.jpg")
        write_jpeg(paths[-1], image, exif)
        (folder / "images" / f"{name}.exr").unlink()
    return paths


def write_mask(path: Path, white: Any) -> None:
    images.write_png(path, np.where(white, 255, 0).astype(np.uint8), tag=None)


@pytest.mark.parametrize("form", FORMATS)
def test_formats_colour_and_hashes(tmp_path: Path, form: str) -> None:
    suffix, _, error, color = FORMATS[form]
    folder = write_folder(tmp_path / "scene", form)
    scene = Scene.load(folder)
    assert scene.images.dtype == np.float32
    np.testing.assert_allclose(scene.images, room().images, rtol=0, atol=error)
    np.testing.assert_allclose(scene.normals, room().normals, rtol=0, atol=1e-7)
    assert scene.names == room().names
    assert scene.assumed["color"].startswith(color)
    assert scene.response == ("srgb" if color.startswith("sRGB") else None)
    assert scene.assumed["normals"] == "normals.exr, opengl axes, camera space"
    names = [*(f"images/{name}{suffix}" for name in scene.names), "normals.exr", "scene.toml"]
    assert scene.inputs == {
        name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names
    }


@pytest.mark.parametrize("toml", ["", 'color_space = "linear"'])
@pytest.mark.parametrize("flag", [None, "linear", "srgb"])
def test_colour_space_flag_before_scene_toml(tmp_path: Path, flag: Any, toml: str) -> None:
    folder = write_folder(tmp_path / "scene", "8-bit PNG", f"fov = 60\n{toml}")
    scene = Scene.load(folder, color_space=flag)
    used = flag or ("linear" if toml else "srgb")
    stored = images.read_data(folder / "images" / "light_00.png")
    expected = room().images[0] if used == "srgb" else stored
    np.testing.assert_allclose(scene.images[0], expected, atol=5e-3)
    told = f"{used} (as asked for)" if flag or toml else "sRGB (8-bit PNG without a profile)"
    assert scene.assumed["color"] == told
    assert scene.response == (None if flag or toml else "srgb")


def test_the_profile_of_one_picture_tells_the_curve_of_all(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scene", "JPEG")
    picture = folder / "images" / "light_01.jpg"
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.open(picture).save(picture, quality=100, icc_profile=profile)
    assert Scene.load(folder).response is None


def test_fov_of_flag_then_scene_toml_then_exif_then_60(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_folder(tmp_path / "scene", "JPEG", fov="fov = 40.5")
    exif = Image.Exif()
    exif[0x8769] = {0xA405: 18}  # mm
    for name, image in zip(room().names, room().images, strict=True):
        write_jpeg(folder / "images" / f"{name}.jpg", image, exif)
    with caplog.at_level(logging.WARNING, "pbrfit"):
        asked, stated = Scene.load(folder, fov=55.0), Scene.load(folder)
        (folder / "scene.toml").unlink()
        with caplog.at_level(logging.ERROR, "pbrfit"):  # at 81 degrees some normals face away
            focal = Scene.load(folder)
        assert not caplog.records
        default = Scene.load(write_folder(tmp_path / "other", fov=None))
    assert (asked.fov, asked.assumed["fov"]) == (55.0, "55 degrees, asked for")
    assert (stated.fov, stated.assumed["fov"]) == (40.5, "40.5 degrees, from scene.toml")
    # A square has the diagonal of 36 × 24 mm at a side of 30.59 mm: 2 atan(15.297 / 18)
    assert focal.fov == pytest.approx(80.718201)
    assert focal.assumed["fov"] == "80.72 degrees, from EXIF (18 mm equivalent)"
    assert default.fov == 60.0
    assert [one.fov_known for one in (asked, stated, focal, default)] == [True, True, True, False]
    assert "neither scene.toml nor EXIF" in default.assumed["fov"]
    [record] = caplog.records
    assert f"{tmp_path / 'other'}: field of view unknown, so it is fitted" in record.message


# 2 atan(19.349 / 18) along the longer and 2 atan(9.6747 / 18) along the shorter side
@pytest.mark.parametrize(("orientation", "fov"), [(1, 94.138344), (6, 56.514623)])
def test_a_focal_length_holds_along_the_diagonal_of_a_turned_picture(
    tmp_path: Path, orientation: int, fov: float
) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    exif[0x8769] = {0xA405: 18}
    (tmp_path / "images").mkdir()
    landscape = room().images[:, : SIZE // 2]
    for i in range(2):
        write_jpeg(tmp_path / "images" / f"{i}.jpg", landscape[i], exif)
    seen = landscape if orientation == 1 else np.rot90(landscape, -1, axes=(1, 2))
    facing = np.broadcast_to([0, 0, 1], seen.shape[1:])
    write_normals(tmp_path, facing)
    scene = Scene.load(tmp_path)
    np.testing.assert_allclose(scene.images, seen[:2], atol=0.1)
    assert scene.fov == pytest.approx(fov)


ORIENTATION = "expected one orientation of all pictures, found 3 (light_01.jpg), else 1: each"


@pytest.mark.parametrize(
    ("tags", "said", "warned"),
    [
        ({0x112: 3}, "orientation 3 (light_01.jpg), else 1", ORIENTATION),
        ({0x112: 1}, None, None),
        ({0x8769: {0x920A: 85.0}}, "focal length 85 mm (light_01.jpg), else 50 mm", "focal length"),
        ({0x8769: {0x920A: 50.0}}, None, None),
        (
            {0x8769: {0x829A: 0.25, 0x829D: 8.0, 0x8827: 100}},
            "exposure 0.25 s f/8 ISO 100 (light_01.jpg), else 0.01 s",
            None,
        ),
        ({0x110: "beta"}, "camera beta (light_01.jpg), else alpha", None),
        (
            {0x8769: {0xA001: 2}},
            "colour profile adobe-rgb (light_01.jpg), else srgb",
            "option color_space decodes all alike",
        ),
    ],
)
def test_a_picture_taken_otherwise_than_the_others_is_named(
    folder: Path,
    caplog: pytest.LogCaptureFixture,
    tags: dict[int, Any],
    said: str | None,
    warned: str | None,
) -> None:
    alike = {0x110: "alpha", 0x8769: {0x920A: 50.0, 0x829A: 0.01}}
    odd = alike | tags
    odd[0x8769] = {**alike[0x8769], **tags.get(0x8769, {})}  # type: ignore[dict-item]
    retag(folder, {"light_00": alike, "light_01": odd, "light_02": alike})
    with caplog.at_level(logging.WARNING, "pbrfit"):
        assert Scene.load(folder).assumed.get("set") == said
    assert len(caplog.records) == (warned is not None)
    assert warned is None or warned in caplog.text


def test_pictures_read_at_once_are_as_read_one_by_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Bits, warnings and errors, although the last picture is ready first."""
    paths = [folder / "images" / f"{name}.tif" for name in room().names]
    for path, image in zip(paths, room().images, strict=True):
        profile = [(34675, "B", 4, b"none", True)]
        tifffile.imwrite(path, image, photometric="rgb", extratags=profile)
        path.with_suffix(".exr").unlink()
    read = images.read_picture

    def later(path: Path, *options: Any, **placed: Any) -> images.Picture:
        time.sleep(0.05 * (len(paths) - paths.index(path)))
        return read(path, *options, **placed)

    monkeypatch.setattr(images, "read_picture", later)
    found = []
    for count in (1, 4):
        monkeypatch.setattr(threads, "processors", lambda count=count: count)
        caplog.clear()
        found.append((Scene.load(folder, max_size=12), caplog.messages))
    (one, said), (four, also_said) = found
    np.testing.assert_array_equal(one.images, four.images)
    assert said == also_said
    assert [path.name in line for path, line in zip(paths, said, strict=True)] == [True] * 3
    for path in paths[1:]:
        path.write_bytes(b"damaged")
    for count in (1, 4):
        monkeypatch.setattr(threads, "processors", lambda count=count: count)
        with pytest.raises(InputError, match=r"light_01\.tif"):
            Scene.load(folder)


def test_pictures_as_stored(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """By the option, else by scene.toml; the dark frame too, and what a network is shown."""
    paths = retag(folder, {"light_01": {0x112: 3}, "light_02": {0x112: 6}})
    turned, kept = Scene.load(folder), Scene.load(folder, orientation="as-stored")
    assert known(kept.source).options.orientation == "as-stored"
    stored = [images.read_picture(path, orientation="as-stored").pixels for path in paths]
    np.testing.assert_array_equal(kept.images, stored)
    np.testing.assert_array_equal(turned.images[1], kept.images[1, ::-1, ::-1])
    noise, as_kept = (known(one.noise_floor(1)) for one in (turned, kept))
    np.testing.assert_array_equal(noise, as_kept[::-1, ::-1])
    np.testing.assert_allclose(kept.images, room().images, atol=0.1)
    caplog.clear()
    (folder / "scene.toml").write_text('fov = 60\norientation = "as-stored"\n')
    by_file = Scene.load(folder)
    np.testing.assert_array_equal(by_file.images, stored)
    np.testing.assert_array_equal(read_pictures(folder)[0].pixels, stored)
    np.testing.assert_array_equal(Scene.load(folder, orientation="exif").images, turned.images)
    assert by_file.assumed["orientation"] == "as stored, whatever EXIF says"
    write_jpeg(folder / "dark.jpg", np.zeros((SIZE, SIZE, 3)), None)
    assert "dark frame" in Scene.load(folder).assumed
    seen, _ = shown_to_network(folder, "light_01")
    as_exif, _ = shown_to_network(folder, "light_00")
    assert (
        np.abs(seen.astype(int) - as_exif).mean() < np.abs(seen.astype(int) - as_exif[::-1]).mean()
    )


def test_alpha_of_nothing_is_no_mask(folder: Path) -> None:
    alpha = np.zeros((SIZE, SIZE))
    image = images.read_data(folder / "images" / "light_00.exr")
    channels = {"R": image[..., 0], "G": image[..., 1], "B": image[..., 2], "A": alpha}
    images.write_exr(folder / "images" / "light_00.exr", channels)
    scene = Scene.load(folder)
    assert scene.valid.all()
    assert scene.assumed["pictures"] == "alpha is 0 in all pixels and ignored: light_00.exr"
    alpha[3, 4] = 1.0  # then it is one
    images.write_exr(folder / "images" / "light_00.exr", channels)
    np.testing.assert_array_equal(Scene.load(folder).valid, alpha == 1)


def test_alpha_and_mask_leave_pixels_out(folder: Path) -> None:
    image = images.read_data(folder / "images" / "light_00.exr")
    alpha = np.ones((SIZE, SIZE))
    alpha[0], alpha[1] = 0.49, 0.5
    channels = {"R": image[..., 0], "G": image[..., 1], "B": image[..., 2], "A": alpha}
    images.write_exr(folder / "images" / "light_00.exr", channels)
    expected = np.ones((SIZE, SIZE), bool)
    expected[0] = False
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.valid, expected)
    assert scene.assumed["alpha"] == f"{SIZE} transparent pixels left out"
    np.testing.assert_allclose(scene.images[0, 1:3], image[1:3] / alpha[1:3, :, None], rtol=1e-6)
    np.testing.assert_allclose(Scene.load(folder, alpha="ignore").images[0], image, rtol=1e-6)

    expected[:, 3:] = False
    white = np.zeros((SIZE, SIZE), bool)
    white[:, :3] = True
    write_mask(folder / "mask.png", white)
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.valid, expected)
    assert "mask.png" in scene.inputs


def write_codes(folder: Path, codes: NDArray[np.uint8]) -> None:
    """Pictures of these 8-bit codes (N, H, W, 3) in place of the folder's."""
    for path in (folder / "images").iterdir():
        path.unlink()
    for name, of_picture in zip(room().names, codes, strict=True):
        images.write_png(folder / "images" / f"{name}.png", of_picture, tag="srgb")


def grey_codes() -> NDArray[np.uint8]:
    """Codes of which none is at an end of the range, others in each picture."""
    pictures = np.arange(128, 128 + LIGHTS, dtype=np.uint8)
    return np.tile(pictures[:, None, None, None], (1, SIZE, SIZE, 3))


def test_codes_outside_the_range_are_limits_by_channel(folder: Path) -> None:
    codes = grey_codes()
    codes[0, 2, 3] = (255, 9, 9)
    codes[0, 2, 4] = (254, 254, 254)
    codes[1, 5, 5:7] = 0
    codes[1, 5, 8] = (0, 0, 1)
    codes[:, 7, 7] = 255
    write_codes(folder, codes)
    expected = np.zeros((LIGHTS, SIZE, SIZE, 3), dtype=np.uint8)
    expected[0, 2, 3, 0] = AT_LEAST
    expected[:, 7, 7] = AT_LEAST
    expected[1, 5, 5:7] = expected[1, 5, 8, :2] = AT_MOST
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.limits, expected)
    assert scene.weights is None
    assert not scene.valid[7, 7]
    assert np.count_nonzero(~scene.valid) == 1
    share = 100 / (LIGHTS * SIZE * SIZE * 3)
    assert scene.assumed["exposure"] == (
        f"of the values {(1 + 3 * LIGHTS) * share:.2g} % overexposed, "
        f"{8 * share:.2g} % underexposed: they only bound the radiance; "
        "pixels left with none: 1"
    )

    scene = Scene.load(folder, code_range=(0, 253))
    assert scene.limits is not None
    assert scene.limits[0, 2, 4].tolist() == [AT_LEAST] * 3
    assert not (scene.limits == AT_MOST).any()
    scene = Scene.load(folder, code_range=(0, 255))
    assert scene.limits is None
    assert "exposure" not in scene.assumed
    assert dataclasses.replace(scene, fov=50.0).limits is None


def test_a_picture_of_which_nothing_is_left_is_named(folder: Path) -> None:
    codes = grey_codes()
    codes[1, : SIZE // 2] = 0
    codes[1, SIZE // 2 :] = 255
    write_codes(folder, codes)
    message = (
        f"{room().names[1]}.png: expected some pixel of the mask within the range of codes, "
        "found all clipped or dark; code_range=\\(0, 255\\) keeps them"
    )
    with pytest.raises(InputError, match=message):
        Scene.load(folder)
    assert Scene.load(folder, code_range=(0, 255)).limits is None


def test_one_clipped_value_bounds_what_it_is_averaged_into(folder: Path) -> None:
    codes = grey_codes()
    codes[0, 5, 9, 1] = 255
    codes[2, 15, 0] = 0
    codes[2, 14, 1, 2] = 255  # beside it: "at least" holds for a mean of both
    write_codes(folder, codes)
    for size in (8, 5, 3):
        scene = Scene.load(folder, max_size=size)
        expected = np.zeros_like(known(scene.limits))
        for picture, row, column, channels, limit in (
            (2, 15, 0, slice(None), AT_MOST),
            (2, 14, 1, 2, AT_LEAST),
            (0, 5, 9, 1, AT_LEAST),
        ):
            # Pixel i of the file covers [i, i + 1] · size / SIZE of the reduced picture.
            rows, columns = (
                slice(at * size // SIZE, -(-(at + 1) * size // SIZE)) for at in (row, column)
            )
            expected[picture, rows, columns, channels] = limit
        np.testing.assert_array_equal(known(scene.limits), expected)


@pytest.mark.parametrize("limit", [0, AT_LEAST, AT_MOST])
def test_limits_are_saved_with_the_pictures(tmp_path: Path, limit: int) -> None:
    limits = np.zeros(room().images.shape, np.uint8)
    limits[1, 2, 3, 1] = limit
    dataclasses.replace(room(), limits=limits).save(tmp_path / "saved")
    loaded = Scene.load(tmp_path / "saved")
    np.testing.assert_array_equal(loaded.limits, limits)
    room().save(tmp_path / "none")
    assert Scene.load(tmp_path / "none").limits is None


def some_weights() -> NDArray[np.float32]:
    """(H, W), different everywhere, 0 in one pixel."""
    weights = np.linspace(0.1, 2.0, SIZE * SIZE, dtype=np.float32).reshape(SIZE, SIZE)
    weights[3, 4] = 0
    return weights


def in_all_channels(weights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    return np.broadcast_to(np.stack(weights)[..., None], (LIGHTS, SIZE, SIZE, 3))


def test_weights_for_each_picture_by_name(folder: Path) -> None:
    names = room().names
    own = {name: some_weights() * (i + 1) for i, name in enumerate(names)}
    channels = {f"{name}.Y": weights for name, weights in own.items()}
    images.write_exr(folder / "weights.exr", {**channels, "gone.Y": some_weights()})
    scene = Scene.load(folder)
    expected = in_all_channels([own[name] for name in names]).copy()
    np.testing.assert_array_equal(known(scene.weights), expected)
    assert scene.assumed["weights"].startswith("weights.exr, for each picture: ")

    weights = channels.pop(f"{names[1]}.Y")
    images.write_exr(folder / "weights.exr", channels)
    with pytest.raises(InputError, match=rf"weights.exr: .*Y, or {names[1]}.Y.* none"):
        Scene.load(folder)
    images.write_exr(folder / "weights.exr", {**channels, "Y": some_weights()})
    with pytest.raises(InputError, match=rf"expected channel Y, or .* found Y, {names[0]}.Y"):
        Scene.load(folder)

    colors = {f"{names[1]}.{color}": i * weights for i, color in enumerate("BGR", start=1)}
    images.write_exr(folder / "weights.exr", {**channels, **colors})
    scene = Scene.load(folder)
    expected[1] *= [3, 2, 1]
    np.testing.assert_array_equal(known(scene.weights), expected)
    assert scene.assumed["weights"].startswith("weights.exr, for each channel of each picture: ")
    for wrong in ({f"{names[1]}.R": weights}, {**colors, f"{names[1]}.Y": weights}):
        images.write_exr(folder / "weights.exr", {**channels, **wrong})
        message = rf"expected channel Y, or {names[1]}.Y, or .*, found {names[1]}"
        with pytest.raises(InputError, match=message):
            Scene.load(folder)


def test_averaged_samples_have_the_weight_of_their_variance(folder: Path) -> None:
    weights = np.ones((SIZE, SIZE))
    weights[0, 0], weights[0, 1], weights[2, 2], weights[2, 3] = 0.5, 0.25, 0, 7
    white = np.ones((SIZE, SIZE), bool)
    weights[4, 4] = np.nan  # where the mask is not
    white[4, 4] = False
    images.write_exr(folder / "weights.exr", {"Y": weights})
    write_mask(folder / "mask.png", white)
    scene = Scene.load(folder, max_size=SIZE // 2)
    expected = np.ones((SIZE // 2, SIZE // 2))
    expected[0, 0] = 4 / (1 / 0.5 + 1 / 0.25 + 1 + 1)
    expected[1, 1] = expected[2, 2] = 0
    np.testing.assert_allclose(known(scene.weights)[0, ..., 1], expected, rtol=1e-6)
    assert not scene.valid[2, 2]


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (-np.ones((SIZE, SIZE)), "expected finite weights, 0 or more, found -1"),
        (np.full((SIZE, SIZE), np.nan), "expected finite weights, 0 or more, found nan"),
        (np.zeros((SIZE, SIZE)), "expected some weight above 0 in the mask, found none"),
        (np.ones((SIZE, SIZE + 1)), "expected the pictures' size, 16 × 16 pixels, found 17 × 16"),
    ],
)
@pytest.mark.parametrize("max_size", [None, SIZE // 2])
def test_weights_that_cannot_be_used(
    folder: Path, weights: NDArray[np.float64], message: str, max_size: int | None
) -> None:
    images.write_exr(folder / "weights.exr", {"Y": weights})
    with pytest.raises(InputError, match=f"weights.exr: {message}"):
        Scene.load(folder, max_size=max_size)


@pytest.mark.parametrize("of", ["all pictures", "a picture", "a channel"])
def test_saved_weights_are_read_back(tmp_path: Path, of: str) -> None:
    own = in_all_channels([some_weights()] * LIGHTS).copy()
    pixels = room().images.copy()
    if of != "all pictures":
        where = (1, 2, 2) if of == "a picture" else (1, 2, 2, 1)
        own[where], pixels[where] = 0, np.nan  # no data where the weight is 0
    made = dataclasses.replace(room(), images=pixels, weights=own)
    made.save(tmp_path / "saved")
    read = Scene.load(tmp_path / "saved")
    np.testing.assert_array_equal(read.weights, made.weights)
    np.testing.assert_array_equal(read.valid, made.valid)
    np.testing.assert_array_equal(read.images, np.nan_to_num(pixels))
    channels = images.read_channels(tmp_path / "saved" / "weights.exr")
    own_names = {f"{name}.Y" for name in room().names}
    if of == "a channel":
        name = room().names[1]
        own_names = own_names - {f"{name}.Y"} | {f"{name}.{color}" for color in "RGB"}
    assert set(channels) == ({"Y"} if of == "all pictures" else own_names)


def test_known_lights_are_found_by_name_and_one_picture_is_enough(folder: Path) -> None:
    lights = np.random.default_rng(0).normal(size=(LIGHTS, 16, 3))
    Lighting(room().names[::-1], lights[::-1]).save(folder / "lighting.json")
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.lighting, lights)
    assert scene.assumed["lighting"] == "known, from lighting.json"
    assert "lighting.json" in scene.inputs
    for path in sorted((folder / "images").iterdir())[1:]:
        path.unlink()
    np.testing.assert_array_equal(Scene.load(folder).lighting, lights[:1])


@pytest.mark.parametrize(("kind", "error"), [(np.uint8, 1e-2), (np.uint16, 4e-5)])
@pytest.mark.parametrize("axes", ["opengl", "directx"])
def test_normals_png_and_axes(folder: Path, axes: str, kind: Any, error: float) -> None:
    stored = room().normals * ((1, -1, 1) if axes == "directx" else 1)
    levels = np.iinfo(kind).max
    encoded = np.rint((stored + 1) / 2 * levels).astype(kind)
    images.write_png(folder / "normals.png", encoded, tag=None)
    (folder / "normals.exr").unlink()
    (folder / "scene.toml").write_text(f'fov = 60\nnormals = "{axes}"\n')
    scene = Scene.load(folder)
    np.testing.assert_allclose(scene.normals, room().normals, atol=error)
    assert scene.assumed["normals"] == f"normals.png, {axes} axes, camera space"


def test_normals_in_world_space(folder: Path) -> None:
    # A camera that looks along world +Y with world +Z up.
    rotation = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    write_normals(folder, room().normals @ rotation)
    toml = f'fov = 60\nnormals_frame = "world"\nworld_to_camera = {rotation.tolist()}\n'
    (folder / "scene.toml").write_text(toml)
    np.testing.assert_allclose(Scene.load(folder).normals, room().normals, atol=1e-6)


def test_multi_illumination_layout_takes_the_largest_exr_in_the_order_of_numbers(
    tmp_path: Path,
) -> None:
    for i in (0, 2, 10):
        write_exr(tmp_path / f"dir_{i}_mip3.exr", np.full((2, 2, 3), i + 1.0))
        write_exr(tmp_path / f"dir_{i}_mip5.exr", np.ones((1, 1, 3)))
        write_jpeg(tmp_path / f"dir_{i}_mip2.jpg", np.ones((4, 4, 3)))
    write_normals(tmp_path, np.broadcast_to([0, 0, 1], (2, 2, 3)))
    scene = Scene.load(tmp_path, fov=50)
    assert scene.names == ("dir_0_mip3", "dir_2_mip3", "dir_10_mip3")
    np.testing.assert_array_equal(scene.images[:, 0, 0, 0], [1, 3, 11])


def test_near_misses_are_named(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("Mask.tif", "images/light_intensities.txt"):
        (folder / name).write_bytes(b"")
    Scene.load(folder)
    mask, strengths = caplog.records
    assert f"{folder / 'Mask.tif'}: not read; expected" in mask.message
    assert "light_intensities.txt: not read; strengths of lamps are fitted" in strengths.message
    caplog.clear()
    others = {"scene.toml.txt", "Normal0001.exr", "dome.lp.txt", "lights (1).csv", "a_mask.png"}
    others.add("light_positions.txt")
    for name in (*others, "notes.txt", "._mask.tif"):
        (folder / name).write_bytes(b"")
    (folder / "masks").mkdir()
    Scene.load(folder)
    warned = {Path(record.message.partition(": not read")[0]).name for record in caplog.records}
    assert warned - {"Mask.tif", "light_intensities.txt"} == {*others, "masks"}


def test_max_size_averages_pictures_normals_and_takes_whole_pixels_only(folder: Path) -> None:
    white = np.ones((SIZE, SIZE), bool)
    white[0, 0] = white[5, :3] = False
    write_mask(folder / "mask.png", white)
    hole = room().images[1].copy()
    hole[0, 0] = np.nan  # outside the mask, so it must not spread
    write_exr(folder / "images" / "light_01.exr", hole)
    ids = np.arange(SIZE * SIZE, dtype=np.uint16).reshape(SIZE, SIZE) * 255
    images.write_png(folder / "segments.png", ids, tag=None)
    scene = Scene.load(folder, max_size=SIZE // 2)

    def blocks(array: Any) -> Any:
        return array.reshape(SIZE // 2, 2, SIZE // 2, 2, -1)

    valid = blocks(white).all(axis=(1, 3))[..., 0]
    np.testing.assert_array_equal(scene.valid, valid)
    expected = blocks(room().images[1]).mean(axis=(1, 3))
    np.testing.assert_allclose(scene.images[1][valid], expected[valid], rtol=1e-6)
    mean = blocks(room().normals).mean(axis=(1, 3))
    mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
    np.testing.assert_allclose(scene.normals[valid], mean[valid], atol=1e-6)
    np.testing.assert_array_equal(scene.segments, ids[1::2, 1::2])
    assert scene.assumed["size"] == "averaged down from 16 × 16 to 8 × 8 pixels"


def test_save_and_load_give_the_same_scene(tmp_path: Path) -> None:
    made = make_scene("spheres", size=SIZE, lights=2, held_out=2, seed=4)
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, 0] = False
    scene = Scene(
        images=made.images.astype(np.float32),
        normals=made.normals,
        fov=33.3,
        mask=mask,
        segments=made.segments,
        lighting=lights_of(made),
        names=("b.1", "a"),
        truth=made.truth,
    )
    scene.save(tmp_path / "scene")
    loaded = Scene.load(tmp_path / "scene")
    assert loaded.names == ("a", "b.1")  # name order
    np.testing.assert_array_equal(loaded.images, scene.images[::-1])
    np.testing.assert_array_equal(loaded.lighting, lights_of(made)[::-1])
    np.testing.assert_array_equal(lights_of(loaded), lights_of(made)[::-1])
    np.testing.assert_array_equal(loaded.valid, mask)
    np.testing.assert_array_equal(loaded.segments, scene.segments)
    np.testing.assert_allclose(loaded.normals, scene.normals, atol=1e-7)
    assert loaded.fov == 33.3
    for name in ("albedo", "roughness", "metallic"):
        found, true = (getattr(truth_of(one).materials, name) for one in (loaded, made))
        np.testing.assert_allclose(found[mask], true[mask], rtol=1e-7)
        assert np.isnan(found[~mask]).all()
    np.testing.assert_allclose(held_out_of(loaded)[0], held_out_of(made)[0], rtol=1e-7)
    np.testing.assert_array_equal(held_out_of(loaded)[1], held_out_of(made)[1])


def test_truth_is_kept_without_known_lights_and_left_out_at_a_smaller_size(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = make_scene("room", size=8, lights=2, held_out=2)
    dataclasses.replace(made, truth=Truth(truth_of(made).materials)).save(tmp_path / "scene")
    loaded = truth_of(Scene.load(tmp_path / "scene"))
    assert (loaded.lighting, loaded.relight_images) == (None, None)
    np.testing.assert_allclose(loaded.materials.albedo, truth_of(made).materials.albedo, atol=1e-6)
    with caplog.at_level(logging.WARNING, "pbrfit"):
        assert Scene.load(tmp_path / "scene", max_size=4).truth is None
    assert "materials.exr: another size than the pictures in use, left out" in caplog.text


@pytest.mark.parametrize("bad", [-1, 65536])
def test_ids_that_do_not_fit_are_numbered_anew(tmp_path: Path, bad: int) -> None:
    segments = np.zeros((SIZE, SIZE), int)
    segments[3, 4] = bad
    segments[0] = 7
    scene = Scene(images=room().images, normals=room().normals, segments=segments)
    scene.save(tmp_path / "scene")
    found = known(Scene.load(tmp_path / "scene").segments)
    first, second = (1, 2) if bad < 7 else (2, 1)
    np.testing.assert_array_equal(found, first * (segments == bad) + second * (segments == 7))


def test_more_segments_than_a_file_holds_are_refused(tmp_path: Path) -> None:
    size = 257
    images = np.full((2, size, size, 3), 0.5, np.float32)
    normals = np.broadcast_to([0.0, 0.0, 1.0], (size, size, 3))
    segments = np.arange(size * size).reshape(size, size) + 1
    scene = Scene(images=images, normals=normals, segments=segments)
    with pytest.raises(InputError, match=r"^segments: expected at most 65535 to save, found 66049"):
        scene.save(tmp_path / "scene")
    assert not list(tmp_path.iterdir())


BAD_FOLDERS: dict[str, tuple[Any, str]] = {
    "no such folder": (shutil.rmtree, "scene: expected a scene folder, found nothing"),
    "no pictures": (
        lambda f: [p.unlink() for p in (f / "images").iterdir()],
        r"images: expected pictures \(.exr .hdr .*\), found none",
    ),
    "neither layout": (
        lambda f: shutil.rmtree(f / "images"),
        "scene: expected pictures under images/ or beside each other, found neither",
    ),
    "one picture": (
        lambda f: [path.unlink() for path in sorted((f / "images").iterdir())[1:]],
        "scene: images: expected at least two pictures .*lighting.json",
    ),
    "equal names": (
        lambda f: write_jpeg(f / "images" / "light_00.jpg", room().images[0]),
        "expected one picture a name, found light_00.exr, light_00.jpg: take others away",
    ),
    "equal names but for case": (
        lambda f: write_jpeg(f / "images" / "Light_00.JPG", room().images[0]),
        "expected one picture a name, found Light_00.JPG, light_00.exr: take others away",
    ),
    "raw files beside pictures of the camera": (
        lambda f: [
            (f / "images" / f"light_0{k}.{kind}").write_bytes(b"")
            for k in (1, 2)
            for kind in ("NEF", "nef.xmp")
        ],
        "found light_01.NEF, light_01.exr, light_02.NEF, light_02.exr: take others away",
    ),
    "maps among pictures": (
        lambda f: [(f / "images" / name).write_bytes(b"") for name in ("Depth0001.png", "a_mask")],
        "images: expected only pictures, found Depth0001.png, a_mask: a map belongs beside images/",
    ),
    "sizes that differ": (
        lambda f: write_exr(f / "images" / "light_02.exr", room().images[0][:, 1:]),
        "light_02.exr: expected the size of light_00.exr, 16 × 16 pixels, found 15 × 16",
    ),
    "two pictures and no normals": (
        lambda f: [(f / "normals.exr").unlink(), (f / "images" / "light_02.exr").unlink()],
        "scene: expected normals.exr or normals.png .*Marigold.*--from flat.*found no normals",
    ),
    "normals twice": (
        lambda f: write_png(f / "normals.png", room().images[0]),
        "expected normals.exr or normals.png, found both",
    ),
    "normals of another size": (
        lambda f: write_normals(f, room().normals[1:]),
        "normals.exr: expected the pictures' size, 16 × 16 pixels, found 16 × 15",
    ),
    "grey normals": (
        lambda f: images.write_exr(f / "normals.exr", {"Y": np.ones((SIZE, SIZE))}),
        "normals.exr: expected normals in channels X, Y, Z .*, found Y",
    ),
    "a mask of another size": (
        lambda f: write_mask(f / "mask.png", np.ones((3, 4))),
        "mask.png: expected the pictures' size, 16 × 16 pixels, found 4 × 3",
    ),
    "segments of another size": (
        lambda f: write_png(f / "segments.png", np.ones((3, 4))),
        "segments.png: expected the pictures' size",
    ),
    "world space without a rotation": (
        lambda f: (f / "scene.toml").write_text('normals_frame = "world"'),
        "scene.toml: expected world_to_camera, a 3 × 3 rotation",
    ),
    "lights of other pictures": (
        lambda f: Lighting(tuple("abc"), np.ones((LIGHTS, 16, 3))).save(f / "lighting.json"),
        "lighting.json: expected a light for every picture, found none for light_00 and 2 more",
    ),
    "a truth without maps": (lambda f: (f / "truth").mkdir(), "truth/materials.exr"),
}


@pytest.mark.parametrize("name", BAD_FOLDERS)
def test_bad_folders_are_refused_in_one_line(folder: Path, name: str) -> None:
    spoil, message = BAD_FOLDERS[name]
    spoil(folder)
    with pytest.raises((InputError, OSError), match=message) as caught:
        Scene.load(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"fov": 180.0}, "fov: expected 0 or degrees"),
        ({"max_size": 0}, "max_size: expected at least 1 pixel, found 0"),
        ({"max_size": 2.5}, r"max_size: expected at least 1 pixel, found \[2.5\]"),
        ({"color_space": "log"}, "color_space: expected one of srgb"),
    ],
)
def test_bad_options_are_refused(folder: Path, option: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Scene.load(folder, **option)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere all file names are Unicode")
def test_a_file_name_that_no_text_file_can_hold_is_refused(folder: Path) -> None:
    picture = next((folder / "images").iterdir())
    picture.rename(picture.with_name(os.fsdecode(b"caf\xe9.exr")))
    with pytest.raises(InputError, match=r"scene: names: expected names in UTF-8, found 'caf"):
        Scene.load(folder)


def test_uncertainty_of_normals_is_read_averaged_and_saved(folder: Path, tmp_path: Path) -> None:
    assert Scene.load(folder).normal_sigma is None
    uncertainty = np.linspace(0, 20, SIZE * SIZE).reshape(SIZE, SIZE)
    normal_files.write_normals(folder / "normals.exr", room().normals, uncertainty)
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.normal_sigma, uncertainty.astype(np.float32))
    assert scene.assumed["normals"] == (
        "normals.exr, opengl axes, camera space, uncertain by 0 to 20 degrees, median 10"
    )
    small = known(Scene.load(folder, max_size=SIZE // 2).normal_sigma)
    expected = uncertainty.reshape(SIZE // 2, 2, SIZE // 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(small, expected, rtol=1e-6)

    mask = np.ones((SIZE, SIZE), bool)
    mask[:3] = False
    masked = dataclasses.replace(scene, mask=mask)
    for name, saved, stored in (
        ("whole", scene, uncertainty),
        ("masked", masked, np.where(mask, uncertainty, 0)),  # outside the mask a number too
    ):
        saved.save(tmp_path / name)
        found = images.read_channels(tmp_path / name / "normals.exr")["uncertainty.Y"]
        np.testing.assert_array_equal(found, stored.astype(np.float32))
        again = Scene.load(tmp_path / name).normal_sigma
        np.testing.assert_array_equal(again, saved.normal_sigma)


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_uncertainty_of_normals_that_means_nothing_is_refused(folder: Path, bad: float) -> None:
    uncertainty = np.ones((SIZE, SIZE))
    uncertainty[2, 3] = bad
    normal_files.write_normals(folder / "normals.exr", room().normals, uncertainty)
    with pytest.raises(
        InputError,
        match=rf"normals\.exr: expected uncertainty\.Y of finite degrees, 0 or more, found {bad:g}",
    ):
        Scene.load(folder)
    white = np.isfinite(uncertainty) & (uncertainty > 0)
    write_mask(folder / "mask.png", white)
    sigma = known(Scene.load(folder, max_size=SIZE // 2).normal_sigma)
    assert np.isnan(sigma[1, 1])
    assert np.isfinite(sigma).sum() == sigma.size - 1
