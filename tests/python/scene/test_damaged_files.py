"""Damaged files and files made to deceive: each was found by tests/fuzz, and is one line since."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import tifffile
from PIL import Image, ImageCms

from fuzz.damage import png_of
from pbrfit import InputError, Result, Scene, decompose
from pbrfit.acquire.prompts import read_prompts
from pbrfit.io import images
from pbrfit.io.images import read_stored
from pbrfit.model.depth_normals import from_depth
from pbrfit.model.lighting import BASIS, Lighting
from pbrfit.model.materials import read_materials
from pbrfit.result.history import History
from pbrfit.scene import folder as scene_folder
from pbrfit.synthetic import make_scene
from pbrfit.values.quoting import listed, quoted, shown

REPOSITORY = Path(__file__).resolve().parents[3]
DEEP = "[" * 100_000


def refused(read: Callable[[Path], object], path: Path, message: str) -> None:
    """One printable line that names the file."""
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    told = str(caught.value)
    assert told.isprintable()
    assert len(told) < 1000
    assert path.name in told


def test_a_decoder_that_panics_prints_nothing(tmp_path: Path) -> None:
    # A palette of no whole colour. In a process of its own, whose output is seen whole.
    data = zlib.compress(b"\0\0\0\0\0\0\0\0\0\0")
    (tmp_path / "a.png").write_bytes(png_of((9, 1), (b"PLTE", b"a"), (b"IDAT", data), kind=3))
    code = f"""
from pbrfit.io import images
try:
    images.read_picture({str(tmp_path / "a.png")!r})
except images.InputError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "a.png: expected a" in done.stdout
    assert done.stderr == ""


@pytest.mark.skipif(sys.platform != "linux", reason="addresses are bounded there")
def test_a_decoder_without_memory_ends_nothing_but_itself(tmp_path: Path) -> None:
    # Libraries of formats abort where memory is refused. In forks of a process of its own.
    black = np.zeros((1024, 1024, 3), np.float32)
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 1024
    for name in ("RLE", "ZIP", "PIZ", "DWAA", "DWAB"):
        how = {"type": OpenEXR.tiledimage, "compression": getattr(OpenEXR, f"{name}_COMPRESSION")}
        OpenEXR.File({"tiles": tiles, **how}, {"RGB": black}).write(str(tmp_path / f"{name}.exr"))
    half = np.zeros((2048, 2048, 3), np.float16)
    tifffile.imwrite(tmp_path / "half.tif", half, photometric="rgb")
    code = f"""
import os, resource
from pathlib import Path
from pbrfit.io import images
for path in sorted(Path({str(tmp_path)!r}).iterdir()):
    for mib in (8, 24, 40, 56, 80, 400):
        if not (child := os.fork()):
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            limit = pages * resource.getpagesize() + (mib << 20)
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
            try:
                images.read_stored(path)
            except (MemoryError, images.InputError) as error:
                os._exit(1 if str(path) in str(error) else 2)
            os._exit(0)
        print(mib == 400, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.count("True 0") == len(list(tmp_path.iterdir()))
    assert set(done.stdout.splitlines()) == {"False 0", "False 1", "True 0"}, done.stdout


JPEG_TABLES = b"\xff\xdb\0\x43\0" + bytes([1] * 64)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.png", png_of((9000, 9000), (b"PLTE", b"abc"), kind=3), "9000 x 9000 pixels in"),
        ("a.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 9000 +X 9000\n", "9000 x 9000 pix"),
        (
            "a.jpg",
            b"\xff\xd8" + JPEG_TABLES + b"\xff\xc0\0\x0b\x08\x23\x28\x23\x28\1\1\x11\0"
            b"\xff\xda\0\x08\1\1\0\0\x3f\0\xff\xd9",
            "9000 x 9000 pixels in",
        ),
        ("a.jpg", b"\xff\xd8" + b"\xff\xda\0\x08\1\1\0\0\x3f\0" * 201, "more than 200 scans"),
        ("a.hdr", b"#?RADIANCE\nFORMAT=32\x1b[2J\x85\n\n-Y 1 +X 1\n", r"32\\u\{1b\}\[2J"),
    ],
)  # fmt: skip
def test_few_bytes_hold_few_pixels(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    refused(images.read_picture, tmp_path / name, message)


def test_channels_that_a_few_bytes_cannot_hold_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    plane = np.zeros((2, 2), np.float32)
    images.write_exr(path, {f"c{k:03}": plane for k in range(20)})
    data = path.read_bytes()
    for window in (b"displayWindow", b"dataWindow"):
        at = data.index(window + b"\0box2i\0") + len(window) + 7 + 4 + 8
        path.write_bytes(data[:at] + struct.pack("<2i", 4095, 4095) + data[at + 8 :])
        refused(images.read_channels, path, "samples in|chunk count")
    # An empty frame around a small crop is no deceit.
    images.write_exr(path, {"Y": plane})
    data = path.read_bytes()
    at = data.index(b"displayWindow\0box2i\0") + 20 + 4 + 8
    path.write_bytes(data[:at] + struct.pack("<2i", 4095, 2047) + data[at + 8 :])
    assert images.read_channels(path)["Y"].shape == (2048, 4096)


@pytest.mark.parametrize("big", [False, True])
def test_a_text_longer_than_its_file_is_refused(tmp_path: Path, big: bool) -> None:
    path = tmp_path / "a.tif"
    how: dict[str, Any] = {"bigtiff": big, "metadata": None}  # one description, not two
    tifffile.imwrite(path, np.zeros((4, 4), np.uint8), description="words " * 9, **how)
    assert images.read_data(path).shape == (4, 4, 1)
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<2H", 270, 2)) + 4
    data[at : at + 4] = struct.pack("<I", 2**32 - 1)
    path.write_bytes(data)
    refused(images.read_data, path, "a text longer than the file")


def test_a_curve_beyond_all_light_is_refused(tmp_path: Path) -> None:
    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    at = profile.index(b"para") + 12  # behind its kind: the exponent, then the slope
    profile[at + 4 : at + 8] = struct.pack(">i", 2**31 - 1)
    profile[at : at + 4] = struct.pack(">i", 20 << 16)
    Image.new("RGB", (2, 2)).save(tmp_path / "a.png", icc_profile=bytes(profile))
    refused(images.read_picture, tmp_path / "a.png", "without a usable tone curve")


def test_names_in_files_do_not_break_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    images.write_exr(path, {"one\ntwo\x1b[2J": np.zeros((2, 2), np.float32)})
    for read in (images.read_picture, read_materials):
        refused(read, path, r"one\\ntwo\\x1b")
    assert shown("a" * 500) == "a" * 200 + "…"
    assert len(quoted([["b" * 500] * 500] * 500)) <= 201
    assert listed(map(str, range(100))).endswith("88 more")


LIGHT: dict[str, Any] = {
    "basis": BASIS, "order": 3, "pictures": ["a"], "coefficients": np.zeros((1, 16, 3)).tolist(),
}  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"coefficients": 1}, "found shape"),
        ({"coefficients": [["1"] * 3] * 16}, "coefficients of type"),
        ({"coefficients": 10**400}, "coefficients of type object"),
        ({"pictures": ["a\n"] * 2, "coefficients": np.zeros((2, 16, 3)).tolist()}, r"a\\n twice"),
        ({"pictures": "a"}, "'a' in place of a list"),
        ({"pictures": ["\ud800"]}, "UnicodeEncodeError"),
        ({"basis": "x" * 10_000}, "expected basis"),
        ({"order": 2}, "expected basis .* of order 3, found .* of order 2"),
        ({"coefficients": [[[1]]]}, r"coefficients of shape \(1, 16, 3\).* found shape"),
        ({"coefficients": np.full((1, 16, 3), np.nan).tolist()}, "nan in place of a finite number"),
        ("{", "expected JSON with basis"),
        ("[]", "expected JSON with basis"),
        (DEEP, "RecursionError"),
    ],
)
def test_lights_that_are_none(tmp_path: Path, changed: Any, message: str) -> None:
    path = tmp_path / "lighting.json"
    path.write_text(changed if isinstance(changed, str) else json.dumps(LIGHT | changed))
    refused(Lighting.load, path, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"fov = {DEEP}", "expected TOML"),
        ("fov = ", "expected TOML, found"),
        ("fow = 60", "expected keys fov, color_space, .*, found fow"),
        ('fov = "wide"', r"fov: expected 0 or degrees in \[0.001, 180\), found 'wide'"),
        ("fov = 180", r"fov: expected 0 or degrees in \[0.001, 180\), found 180"),
        ('color_space = "log"', "color_space: expected one of srgb, linear, .*, found 'log'"),
        ('normals = "vulkan"', "normals: expected one of opengl, directx, found 'vulkan'"),
        ("world_to_camera = [[2, 0, 0], [0, 2, 0], [0, 0, 2]]", "3 × 3 rotation"),
        ("fov = " + "9" * 5000, "expected TOML"),
        (f"crop = [0, 0, 1, 0x{'f' * 4000}]", "a whole number of 16000 bits in place of 64"),
        ("fov = [{x = -9223372036854775809}]", "a whole number of 64 bits in place of 64"),
        ("max_size = -9223372036854775807", "max_size: expected at least 1 pixel, found -9223"),
        ("a." * 20_000 + "a = 1", "expected at most 64 dots a line, found 20000 in line 1"),
        ("fov = 1 #" + " ." * 65, "expected at most 64 dots a line, found 65 in line 1"),
        ("fow = 1 # ..." + " ." * 64, "expected keys fov"),
        ("fov = 9e-4", "found 0.0009"),
        ('"a\\nb" = 1', r"found a\\nb"),
        (f'normals = "{"x" * 10_000}"', "normals: expected one of"),
        ("world_to_camera = [[1e300, 0, 0], [0, 1, 0], [0, 0, 1]]", "3 × 3 rotation"),
    ],
)
def test_settings_that_are_none(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    refused(scene_folder.read_settings, path, message)
    if message.startswith("expected TOML") or "dots" in message:
        refused(read_prompts, path, "|".join([message, "TOML"]))


@pytest.mark.parametrize("entry", ["inf", "nan", "-inf", "1e301"])
def test_a_history_is_of_finite_numbers(tmp_path: Path, entry: str) -> None:
    path = tmp_path / "history.csv"
    path.write_text(f"elapsed_s,iteration,evaluations,loss,recon_rmse\n0,0,1,{entry},0\n")
    refused(History.load, path, f"{entry} under loss")
    path.write_text(f"elapsed_s,iteration,evaluations,loss,recon_rmse\n0,{'9' * 400},1,1,0\n")
    refused(History.load, path, "found: 9999")
    path.write_text('"a\nb"\n')
    refused(History.load, path, r"columns a\\nb")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result") / "result"
    decompose(make_scene("room", size=8, lights=3), iterations=2).save(folder)
    return folder


@pytest.fixture
def result(saved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(saved, tmp_path / "result"))


REFINED = {"asked": "on", "refined": True, "why": "", "figures": {}}
SOURCE = {"path": "x", "color_space": None, "max_size": None, "code_range": [1, 250]}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("fov", 200, "fov"),
        ("fov", float("nan"), "nan in place of a finite number"),
        ("seconds", "1", "'1' in place of a number"),
        ("evaluations", -1, "whole number from 0 on"),
        ("metrics", "x", "'x' in place of an object"),
        ("metrics", {"a": 10**400}, "OverflowError"),
        ("stop_reason", 3, "in place of a text"),
        ("left_out", "abc", "in place of a list"),
        ("stages", [[]], "in place of an object"),
        ("options", {"k" * 10_000: 1}, "FitOptions "),
        ("inputs", {"a": None}, "in place of a text"),
        ("normals", REFINED | {"refined": 1}, "true or false"),
        *(
            (key, written | {name: value}, "expected what pbrfit writes")
            for key, written, name, value in (
                ("normals", REFINED, "asked", "perhaps"),
                ("normals", REFINED, "why", None),
                ("normals", REFINED, "figures", None),
                ("normals", REFINED, "figures", {"noise": "low"}),
                ("scene", SOURCE, "path", 3),
                ("scene", SOURCE, "color_space", "film"),
                ("scene", SOURCE, "code_range", [1]),
                ("scene", SOURCE, "orientation", 3),
            )
        ),
    ],
)
def test_a_result_of_other_types_is_refused(
    result: Path, key: str, value: Any, message: str
) -> None:
    path = result / "result.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(content | {key: value}), encoding="utf-8")
    refused(lambda path: Result.load(path.parent), path, message)
    path.write_text(DEEP)
    refused(lambda path: Result.load(path.parent), path, "RecursionError")


def test_a_result_with_maps_that_are_not_finite_is_refused(result: Path) -> None:
    path = result / "materials.exr"
    sound = images.read_channels(path)
    for name, value in (
        *((name, np.inf) for name in ("albedo.G", "roughness.Y", "normal.Z")),
        *(("uncertainty.metallic.Y", value) for value in (np.nan, -0.1, 1.1)),
    ):
        images.write_exr(path, sound | {name: np.full_like(sound[name], value)})
        with pytest.raises(InputError, match="NaN or"):
            Result.load(result)
    images.write_exr(path, sound | {"mask.Y": np.zeros_like(sound["mask.Y"])})
    with pytest.raises(InputError, match=r"some pixel with mask\.Y"):
        Result.load(result)


@pytest.mark.parametrize("name", ["x" * 10_000, "../relight_00", "", "a\0"])
def test_held_out_pictures_lie_beside_their_lights(tmp_path: Path, name: str) -> None:
    make_scene("room", size=8, lights=3, held_out=1).save(tmp_path / "scene")
    path = tmp_path / "scene" / "truth" / "relight" / "lighting.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(content | {"pictures": [name]}), encoding="utf-8")
    refused(lambda _: Scene.load(tmp_path / "scene"), path, "names of pictures beside it")


def npy(kind: str, shape: str, body: bytes = bytes(64)) -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text + body


@pytest.mark.parametrize(
    "data",
    [
        b"", b"PK\5\6" + bytes(18), b"\x80\4N.", b"\x93NUMPY\1\0\x04\0(((\n",
        npy("<f4", "(1099511627776,)"), npy("<f4", "(3.5,)"), npy("|O", "(2,)"),
        npy("<U9", "(1,)"), npy("<f4", "(True, 3)"),
    ],
)  # fmt: skip
def test_arrays_that_are_none(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(data)
    refused(read_stored, path, "expected an array of real numbers in .npy, found")


@pytest.mark.parametrize("order", ["C", "F"])
def test_an_array_is_read_and_its_file_let_go(tmp_path: Path, order: Any) -> None:
    """It may shrink while it is read; in a process of its own, as of a map the system ends it."""
    stored = np.asarray(np.arange(6, dtype=np.float16).reshape(2, 3), order=order)
    np.save(tmp_path / "a.npy", stored)
    code = f"""
import contextlib, os, pathlib
from pbrfit.io import exif, images
path = pathlib.Path({str(tmp_path / "a.npy")!r})
@contextlib.contextmanager
def shrinking():
    yield
    os.truncate(path, 0)
exif.without_warnings = shrinking
print(images.read_stored(path).tolist())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "[[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]\n"


def test_depths_beyond_all_measure_are_not_hit() -> None:
    depth = np.ones((8, 8))
    depth[2, 2], depth[5, 5] = 1e-308, 5e-324
    normals, known = from_depth(depth, fov=50.0)
    assert np.isfinite(normals).all()
    assert not known[2, 2]
    assert known[0, 0]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="limits on processes are those of Unix")
def test_a_few_hundred_damaged_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # `make test-fuzz` does the same on 100,000.
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY / "tests"), prepend=":")
    command = [sys.executable, "-m", "fuzz", "--cases", "1000", "--jobs", "1", "--seed", "7"]
    command += ["--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " 0 failed" in done.stdout
