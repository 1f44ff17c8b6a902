"""Normals, masks, depth and pictures as other programs write them: what their makers meant."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from command_runs import done, refused
from pbrfit import InputError, Scene
from pbrfit.io import images
from pbrfit.io.color import decode_srgb
from pbrfit.io.depth_files import read_depth
from pbrfit.io.normal_files import read_normals
from pbrfit.model.geometry import angles_between
from pbrfit.scene.folder import digests
from pbrfit.scene.reading import read_pictures
from scene_files import LIGHTS, SIZE, known, room, write_exr
from scene_files import run as run_command

Y, X = np.mgrid[0.95:-0.95:48j, -0.95:0.95:48j]
BALL = np.hypot(X, Y) < 0.92
NORMALS = np.dstack([X, Y, np.sqrt(np.clip(1 - X**2 - Y**2, 0, 1))])
NORMALS[~BALL] = [0, 0, 1]
CODED = 0.5 + 0.5 * NORMALS
BYTES = np.rint(255 * CODED).astype(np.uint8)
COLORS = np.random.default_rng(0).uniform(0.05, 0.4, NORMALS.shape)


def before(background: Any, values: NDArray[Any]) -> NDArray[Any]:
    return np.where(BALL[..., None], values, background).astype(values.dtype)


def store(path: Path, values: Any) -> Path:
    """Write an EXR file of channels, else a file of an array by its suffix."""
    if isinstance(values, dict):
        images.write_exr(path, values)
    elif path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".tif":
        Image.fromarray(values).save(path)
    elif values.dtype == np.uint16:
        images.write_png(path, values, None)
    else:
        Image.fromarray(values.squeeze()).save(path, "PNG")
    return path


def layer(values: NDArray[Any], *names: str) -> dict[str, NDArray[Any]]:
    return {name: values[..., i] for i, name in enumerate(names)}


BEAUTY = layer(COLORS, "R", "G", "B")
POSITION = layer(9 * COLORS, "View.Position.X", "View.Position.Y", "View.Position.Z")

AS_MEANT: dict[str, tuple[Any, str, bool]] = {
    # what is stored, what is said, whether the background has no normal
    "components.exr": (layer(NORMALS, *"XYZ"), "", False),
    "zeros.exr": (layer(before(0, NORMALS), *"XYZ"), "", True),
    "coded.exr": (layer(CODED, *"RGB"), "0 to 1 read", False),
    "coded_on_black.exr": (layer(before(0, CODED), *"RGB"), "0 to 1 read", True),
    "houdini.exr": (layer(NORMALS, "N.x", "N.y", "N.z") | BEAUTY, "channels N.x, N.y, N.z", False),
    "blender.exr": (
        layer(NORMALS, *(f"View.Normal.{c}" for c in "XYZ")) | POSITION,
        "channels View.Normal.X",
        False,
    ),
    "denoiser.exr": (
        layer(NORMALS, *(f"Normal.{c}" for c in "RGB"))
        | layer(COLORS, *(f"Denoising Normal.{c}" for c in "XYZ")),
        "channels Normal.R",
        False,
    ),
    "flat_names.exr": (layer(NORMALS, "Nx", "Ny", "Nz") | BEAUTY, "channels Nx, Ny, Nz", False),
    "nuke.exr": (layer(NORMALS, "N.red", "N.green", "N.blue") | BEAUTY, "N.red", False),
    "underscores.exr": (layer(NORMALS, *(f"normal_{c}" for c in "xyz")), "normal_x", False),
    "any_layer.exr": (layer(NORMALS, "aov.X", "aov.Y", "aov.Z") | BEAUTY, "aov.X", False),
    "and_position.exr": (layer(NORMALS, *"RGB") | POSITION, "", False),
    "two.exr": (layer(NORMALS, *"XY"), "z = √", False),
    "png_in_fact.exr": (BYTES, "", False),
    "black.png": (before(0, BYTES), "", True),
    "white.png": (before(255, BYTES), "", True),
    "transparent.png": (np.dstack([BYTES, np.uint8(255) * BALL]), "", True),
    "transparent_everywhere.png": (np.dstack([BYTES, np.uint8(0) * BALL]), "", False),
    "grey.png": (before(127, BYTES), "", True),
    "diligent.png": (before(0, np.clip(128 * (NORMALS + 1), 0, 255).astype(np.uint8)), "", True),
    "bytes_in_16_bits.png": (BYTES.astype(np.uint16), "codes up to 255", False),
    "no_blue.png": ((BYTES * [1, 1, 0]).astype(np.uint8), "third channel is the same", False),
    "grey_and_alpha.png": (BYTES[..., :2], "z = √", False),
    "grey_coded.png": (np.rint(65535 * CODED).astype(np.uint16), "", False),
    "decoded.exr": (layer(decode_srgb(CODED), *"RGB"), "decoded as if colours of sRGB", False),
    "floats.npy": (NORMALS.astype(np.float16), "", False),
    "bytes.npy": (BYTES, "codes up to 255", False),
    "bytes_as_floats.npy": (BYTES.astype(float), "codes up to 255", False),
    "signed.npy": (np.rint(127 * NORMALS).astype(np.int8), "codes up to 127", False),
    "two.npy": (CODED[..., :2], "0 to 1 read", False),
    "first.npy": (np.moveaxis(CODED, -1, 0), "0 to 1 read", False),
}


@pytest.mark.parametrize("name", AS_MEANT)
def test_normals_are_read_as_they_were_meant(tmp_path: Path, name: str) -> None:
    stored, said, background = AS_MEANT[name]
    read = read_normals(store(tmp_path / name, stored))
    known = np.isfinite(read.vectors[..., 0])
    np.testing.assert_array_equal(known, BALL if background else np.ones_like(BALL))
    assert angles_between(read.vectors, NORMALS)[known & BALL].max() < 1.0
    assert (said in ", ".join(read.said)) if said else not read.said


@pytest.mark.parametrize(
    ("name", "stored", "message"),
    [
        ("colours.exr", BEAUTY, "lengths of 0.2"),
        ("long.npy", 1.11 * NORMALS, "lengths of 1.1 to 1.1"),
        ("grey.png", BYTES[..., :1], "normals .H, W, 3., found shape"),
        (
            "two_layers.exr",
            layer(NORMALS, "N.X", "N.Y", "N.Z") | layer(NORMALS, *(f"Normal.{c}" for c in "XYZ")),
            "one layer of normals .*, found N.X N.Y N.Z, Normal.X Normal.Y Normal.Z",
        ),
    ],
)
def test_no_normals_are_refused(tmp_path: Path, name: str, stored: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"{name}: expected .*{message}"):
        read_normals(store(tmp_path / name, stored))


def test_lengths_at_the_tolerances(tmp_path: Path) -> None:
    assert not read_normals(store(tmp_path / "n.npy", 1.09 * NORMALS)).said
    for length, there in ((1.24, True), (1.26, False), (0.11, True), (0.09, False)):
        normals = NORMALS.copy()
        normals[3, 4] *= length
        read = read_normals(store(tmp_path / "n.npy", normals))
        assert np.isfinite(read.vectors[3, 4, 0]) == there


CODES = np.rint(255 * (0.5 + 0.5 * room().normals)).astype(np.uint8)


def test_a_scene_leaves_out_pixels_without_normals(folder: Path, tmp_path: Path) -> None:
    (folder / "normals.exr").unlink()
    black = CODES.copy()
    black[:3] = 0
    store(folder / "normals.png", black)
    scene = Scene.load(folder)
    assert (scene.valid == (np.arange(SIZE) >= 3)[:, None]).all()
    assert f"{3 * SIZE} pixels left out" in scene.assumed["normals"]
    store(folder / "normals.png", 0 * black)
    assert "normals.png: expected normals of some pixel" in refused("inspect", folder)
    for name, sign in (("normal_opengl.exr", 1), ("normal_directx.exr", -1)):  # as of an export
        write_exr(tmp_path / name, 0.5 + 0.5 * room().normals * [1, sign, 1])
        said = done("normals", folder, "--from", tmp_path / name, "--overwrite")
        assert "0 to 1 read as 2v − 1" in said
        assert angles_between(Scene.load(folder).normals, room().normals).max() < 1e-3
    assert "95 %" in done("normals", folder, "--from", store(tmp_path / "b", black), "--overwrite")
    assert np.count_nonzero(~Scene.load(folder).valid) == 3 * SIZE


HALF = np.arange(SIZE)[:, None] < np.full(SIZE, SIZE // 2)
WHITE = np.full((SIZE, SIZE, 3), 255, np.uint8)


@pytest.mark.parametrize(
    ("mask", "said"),
    [
        (HALF.astype(np.uint8), "0 and 0.0039 of white"),
        (HALF.astype(np.uint16) * 255, "0 and 0.0039 of white"),
        (HALF, None),
        (np.dstack([WHITE, 255 * HALF.astype(np.uint8)]), "its alpha"),
        (np.dstack([0 * WHITE, 255 * HALF.astype(np.uint8)]), "its alpha"),
        (np.dstack([WHITE // [9, 2, 1], 255 * HALF]).astype(np.uint8), "its alpha"),
        (np.dstack([255 * HALF] * 3 + [255 - 9 * HALF]).astype(np.uint8), None),
        (np.dstack([c * HALF for c in (255, 0, 0)]).astype(np.uint8), "1 of white in one colour"),
        (np.dstack([c * HALF for c in (128, 0, 64)]).astype(np.uint8), "0.5 of white in one"),
    ],
)
def test_masks(folder: Path, mask: NDArray[Any], said: str | None) -> None:
    store(folder / "mask.png", mask)
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.valid, HALF)
    assert re.search(said, scene.assumed["mask"]) if said else "mask" not in scene.assumed


@pytest.mark.parametrize(
    ("mask", "most"),
    [
        (0 * HALF, "0"),
        (np.linspace(0, 100, SIZE * SIZE).reshape(SIZE, -1), "0.39"),
        (np.dstack([255 * HALF, 255 * ~HALF, 0 * HALF]), "1"),
    ],
)
def test_a_mask_without_white_is_refused(folder: Path, mask: NDArray[Any], most: str) -> None:
    store(folder / "mask.png", mask.astype(np.uint8))
    said = f"mask.png: expected at least one white pixel, found none, and {most} of white at most"
    assert said in refused("inspect", folder)


def test_a_stack_is_its_pages(folder: Path) -> None:
    apart = Scene.load(folder)
    for path in (folder / "images").iterdir():
        path.unlink()
    tifffile.imwrite(folder / "images" / "s.tif", apart.images, photometric="rgb")
    lamps = "".join(f"s_{i + 1},0,0,1\n" for i in reversed(range(len(apart.images))))
    (folder / "lights.csv").write_text(lamps)
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.images, apart.images)
    assert scene.names == tuple(f"s_{i + 1}" for i in range(len(apart.images)))
    assert scene.assumed["pictures"].startswith("pages of s.tif: s_1.tif, s_2.tif")
    assert scene.lamps is not None
    assert "matched" not in scene.assumed["lamps"]  # but by name
    assert scene.inputs == digests(folder)
    assert "images/s.tif" in scene.inputs


def test_depth_keeps_the_unit_of_its_file(folder: Path, tmp_path: Path) -> None:
    (folder / "normals.exr").unlink()
    depth = 2500 + np.arange(SIZE * SIZE, dtype=np.uint16).reshape(SIZE, SIZE)
    depth[0] = 0
    path = store(tmp_path / "mm.png", depth)
    for unit, flags in ((1, ()), (0.001, ("--unit", 0.001)), (0.001, ("--unit", "mm"))):
        said = done("depth", folder, "--from", path, "--overwrite", *flags)
        assert ("whole numbers, in the unit of the file" in said) == (unit == 1)
        assert f"{SIZE} pixels of 0" in said
        assert f"depth.exr: {2520 * unit:g} to" in said
        found = known(Scene.load(folder).depth)
        np.testing.assert_allclose(found, np.where(depth > 0, unit * depth, np.nan), rtol=1e-6)
    assert "unit: expected m, cm, mm or a number above 0, found 0" in refused(
        "depth", folder, "--from", path, "--overwrite", "--unit", 0
    )
    # The scene folder's own file, and what scene.toml says of it.
    (folder / "depth.exr").unlink()
    settings = (folder / "scene.toml").read_text()
    for toml, unit in (("", 1), ('depth_unit = "mm"\n', 0.001), ('depth_unit = "m"\n', 1)):
        (folder / "scene.toml").write_text(settings + toml)
        store(folder / "depth.png", depth)
        scene = Scene.load(folder, fov=60)
        np.testing.assert_allclose(
            known(scene.depth), np.where(depth > 0, unit * depth, np.nan), 1e-6
        )
        assert ("times 0.001" in scene.assumed["depth"]) == (unit < 1)
    (folder / "depth.png").unlink()
    (folder / "scene.toml").write_text(settings + 'depth_unit = "mm"\n')
    store(folder / "depth.exr", {"Z": depth + 0.5})
    assert "whole numbers beside a unit, found fractions" in refused("inspect", folder)
    (folder / "depth.exr").unlink()
    store(folder / "depth.png", BYTES[..., :1])
    assert "depth.png: expected depth of 16 bits, found 8" in refused("inspect", folder)
    (folder / "scene.toml").write_text('depth_unit = "inch"\n')
    assert "depth_unit: expected one of m, cm, mm, found 'inch'" in refused("inspect", folder)


@pytest.mark.parametrize(("names", "found"), [
    (("R", "G", "B", "A", "V.Depth.V", "V.Normal.Z"), "V.Depth.V"),
    (("Z", "V.Depth.Z", "Y"), "Z"),
    (("z", "R"), "z"),
    (("depth.V", "R", "N.Z"), "depth.V"),
    (("Y", "R", "N.Z"), "Y"),
    (("rgba.R", "rgba.Z", "P.Z", "V.Mist.Z"), "rgba.Z"),
    (("R", "B", "left.depth"), "left.depth"),
    (("VRayZDepth.R", "R", "N.Z"), "VRayZDepth.R"),
    (("depth_Z", "R", "N_Z"), "depth_Z"),
    (("V.Denoising Depth.Z", "V.Depth.Z", "R"), "V.Depth.Z"),
    (("R", "G", "B", "dd.T"), "depth in one channel, found colours or vectors"),
    (("nn.X", "nn.Y", "nn.Z"), "depth in one channel, found colours or vectors"),
    (("a.Depth.Z", "b.Depth.Z", "Y"), "one layer of depth .*, found a.Depth.Z, b.Depth.Z"),
    (("A", "N.Z"), "depth in a channel Z, depth.Z, Y or R, found A, N.Z in layers N"),
])  # fmt: skip
def test_layers_of_depth(tmp_path: Path, names: tuple[str, ...], found: str) -> None:
    path = store(tmp_path / "d.exr", {name: np.full((2, 3), i) for i, name in enumerate(names)})
    if "found" in found:
        with pytest.raises(InputError, match=f"d.exr: expected {found}"):
            read_depth(path)
        return
    depth, said = read_depth(path)
    assert (depth == names.index(found)).all()
    assert said == [f"channel {found}"] * (found != "Z")


@pytest.mark.parametrize(
    ("far", "unknown"), [(29.9, False), (30.1, True), (65504, True), (1e10, True), (np.inf, True)]
)
@pytest.mark.parametrize("fov", [0, 60])
def test_a_far_plane_is_unknown(far: float, unknown: bool, fov: float) -> None:
    depth = np.where(BALL, 3.0 - 0.4 * NORMALS[..., 2], far)
    depth[24, 24] = 3.0
    scene = Scene(np.ones((2, 48, 48, 3), np.float32), NORMALS, fov, depth=depth)
    np.testing.assert_array_equal(np.isnan(known(scene.depth)), ~BALL & unknown)
    assert ("left out" in scene.assumed.get("depth", "")) == unknown
    single = Scene(
        np.ones((2, 48, 48, 3), np.float32), NORMALS, fov, depth=np.where(depth == far, 3, depth)
    )
    assert np.isfinite(known(single.depth)).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_single_samples_that_are_no_numbers_are_left_out(
    folder: Path, value: float, caplog: pytest.LogCaptureFixture
) -> None:
    pictures = room().images.copy()
    pictures[1, 2, 3, 1] = value
    pictures[:, 4, 5] = value
    paths = sorted((folder / "images").iterdir())
    for path, picture in zip(paths, pictures, strict=True):
        write_exr(path, picture)
    scene = Scene.load(folder)
    assert np.argwhere(~scene.valid).tolist() == [[4, 5]]
    assert np.argwhere(known(scene.weights)[1] == 0).tolist() == [
        [2, 3, 1],
        *([4, 5, c] for c in range(3)),
    ]
    said = f"{LIGHTS + 1} pixels that are NaN, infinite or outside of a data window left out"
    assert said in scene.assumed["gaps"]
    assert f"images: {said}" in caplog.text
    caplog.clear()
    assert not read_pictures(folder)[0].pixels[:, 4, 5].any()
    assert said in caplog.text
    assert np.isfinite(Scene.load(folder, max_size=SIZE // 2).images).all()
    for count, usable in ((SIZE * SIZE // 2, True), (SIZE * SIZE // 2 + 1, False)):
        picture = room().images[0].reshape(-1, 3).copy()
        picture[:count] = value
        write_exr(paths[0], picture.reshape(SIZE, SIZE, 3))
        if usable:
            Scene.load(folder)
        else:
            with pytest.raises(InputError, match=r"light_00.exr: expected finite .* 129 of 256"):
                Scene.load(folder)


def window_rows(folder: Path, rows: int, pictures: int) -> None:
    """Leave some rows from above of the first pictures, in a display window of all."""
    last = (np.array([SIZE - 1, bottom - 1], np.int32) for bottom in (SIZE, rows))
    display, data = ((np.zeros(2, np.int32), corner) for corner in last)
    for name, picture in zip(room().names[:pictures], room().images, strict=False):
        windows = {"displayWindow": display, "dataWindow": data}
        path = folder / "images" / f"{name}.exr"
        OpenEXR.File(windows, {"RGB": picture[:rows].copy()}).write(str(path))


def test_pixels_outside_of_data_windows_are_no_samples(folder: Path) -> None:
    window_rows(folder, SIZE - 1, 1)
    scene = Scene.load(folder)
    assert scene.valid.all()
    np.testing.assert_array_equal(known(scene.weights)[0, -1], 0)
    assert f"{SIZE} pixels that are NaN, infinite or outside" in scene.assumed["gaps"]
    window_rows(folder, 3, 1)
    said = "light_00.exr: expected finite pixels, found 208 of 256 that are"
    assert said in refused("inspect", folder)
    window_rows(folder, 3, LIGHTS)  # what no picture tells is as masked
    assert (Scene.load(folder).valid == (np.arange(SIZE) < 3)[:, None]).all()


def test_arithmetic_that_fails_is_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def divides(_: Any) -> int:
        return int(1 / 0.0)

    monkeypatch.setattr("pbrfit.commands.inspect.run", divides)
    assert run_command("inspect", folder) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "ZeroDivisionError: float division by zero in divides, test_maps_as_made.py:" in said
