"""Exports (docs/export.md): every file as other readers see it, and what is refused."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import re
import struct
import zlib
from collections.abc import Callable
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from PIL import Image

import glb_reader
from command_runs import done, refused
from pbrfit import InputError, Result, Scene, decompose, relight
from pbrfit.export import export_result
from pbrfit.export.gltf import glb
from pbrfit.export.lights import file_names
from pbrfit.export.maps import Maps
from pbrfit.export.nonnegative import RIDGE, nonnegative_radiance
from pbrfit.export.view_mesh import Geometry, camera, facets
from pbrfit.io.color import decode_srgb
from pbrfit.kernel import sh_basis, view_directions
from pbrfit.model import panorama
from pbrfit.model.geometry import unit
from pbrfit.model.materials import Materials
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene
from relit import card
from result_files import layers_of as exr
from scene_files import known

HEIGHT, WIDTH = 10, 12
MAPS = ["base_color", "mask", "metallic", "normal_opengl", "roughness"]
ALL_MAPS = sorted(
    [
        *MAPS,
        "displacement",
        *(f"{name}_deviation" for name in ("base_color", "roughness", "metallic")),
    ]
)
GEOMETRIES: tuple[Geometry, ...] = ("card", "facets")
LIGHTS = ["lighting.json", "panoramas.csv"]


@pytest.fixture(scope="module")
def fitted() -> Result:
    """A fit of three steps, with a mask, uncertainty and a name that is no ASCII."""
    made = make_scene("room", size=WIDTH, lights=3, held_out=1)
    mask = np.ones((WIDTH, WIDTH), bool)
    mask[:, 0] = mask[4:7, 5:9] = False
    scene = Scene(
        images=made.images[:, :HEIGHT],
        normals=made.normals[:HEIGHT],
        mask=mask[:HEIGHT],
        names=("a", "b", "ç"),
        fov=made.fov,
    )
    return decompose(scene, iterations=3, priors=Priors.none())


@pytest.fixture(scope="module")
def result(fitted: Result) -> Result:
    """Random materials and normals in its place, so that no two channels are alike."""
    random = np.random.default_rng(4)
    outside = ~fitted.mask
    shapes = (HEIGHT, WIDTH, 3), (HEIGHT, WIDTH), (HEIGHT, WIDTH)
    materials = Materials(*(random.uniform(0, 1, shape) for shape in shapes))
    normals = random.normal(size=(HEIGHT, WIDTH, 3))
    normals[..., 2] = np.abs(normals[..., 2])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    for values in (materials.albedo, materials.roughness, materials.metallic, normals):
        values[outside] = np.nan
    return dataclasses.replace(fitted, materials=materials, normals=normals)


def whole(result: Result) -> Result:
    """The same without pixels that the mask leaves out."""
    maps = Maps.of(result)
    materials = Materials(maps.albedo, maps.roughness, maps.metallic)
    mask = np.ones((HEIGHT, WIDTH), bool)
    return dataclasses.replace(
        result, materials=materials, normals=maps.normals, mask=mask, uncertainty=None
    )


def small(shape: tuple[int, int], fov: float, result: Result) -> Result:
    """A flat grey card."""
    return card(result, np.tile([0.0, 0.0, 1.0], (*shape, 1)), fov)


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def chunks(content: bytes) -> dict[bytes, bytes]:
    """Chunks of a PNG by type, by the PNG specification; checksums are checked."""
    found, at = {}, 8
    while at < len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        data = content[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", content, at + 8 + length) == (zlib.crc32(kind + data),)
        found[kind] = data
        at += 12 + length
    return found


def png(path: Path | bytes) -> NDArray[Any]:
    """Samples of a PNG without interlacing, (H, W, C), by an independent reader for 16-bit RGB."""
    content = path if isinstance(path, bytes) else path.read_bytes()
    parts = chunks(content)
    width, height, depth, kind = struct.unpack_from(">IIBB", parts[b"IHDR"])
    channels = {0: 1, 2: 3, 4: 2, 6: 4}[kind]
    if depth == 8 or channels == 1:
        with Image.open(io.BytesIO(content)) as picture:
            samples: NDArray[Any] = np.asarray(picture)
        assert samples.dtype == (np.uint8 if depth == 8 else np.uint16)
        return samples.reshape(height, width, channels)
    # Pillow rounds 16-bit RGB to 8 bits.
    step, data = channels * 2, zlib.decompress(parts[b"IDAT"])
    rows, above = [], np.zeros(width * step, np.uint8)
    for line in np.frombuffer(data, np.uint8).reshape(height, -1):
        above = unfiltered(int(line[0]), line[1:], above, step)
        rows.append(above)
    return np.stack(rows).view(">u2").astype(np.uint16).reshape(height, width, channels)


def unfiltered(
    kind: int, line: NDArray[np.uint8], above: NDArray[np.uint8], step: int
) -> NDArray[np.uint8]:
    """PNG filters (specification, 9.2): none, sub, up, average, Paeth."""
    found = np.zeros(len(line), int)
    for i, value in enumerate(line):
        a = int(found[i - step]) if i >= step else 0
        b, c = int(above[i]), int(above[i - step]) if i >= step else 0
        p = a + b - c
        paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
        found[i] = (int(value) + (0, a, b, (a + b) // 2, paeth)[kind]) % 256
    return found.astype(np.uint8)


def codes(values: NDArray[Any], bits: int) -> NDArray[Any]:
    return np.asarray(np.floor(values * (2**bits - 1) + 0.5))


def test_everything_without_options(result: Result, tmp_path: Path) -> None:
    exported = export_result(result, tmp_path / "out")
    assert names(tmp_path / "out") == [
        "export.json",
        *sorted([*(f"exr/{name}.exr" for name in ALL_MAPS), "exr/materials.exr"]),
        *sorted([*(f"lights/{name}" for name in LIGHTS), *(f"lights/{x}.exr" for x in "abç")]),
        "material.glb",
        "material.mtlx",
        *(f"png/{name}.png" for name in ALL_MAPS),
    ]
    told = json.loads((tmp_path / "out" / "export.json").read_text("utf-8"))
    assert told["version"] == version("pbrfit")
    assert sorted(["export.json", *(file["path"] for file in told["files"])]) == names(
        tmp_path / "out"
    )
    assert all(file["color_space"] for file in told["files"])
    assert told["verdicts"] == known(result.uncertainty).summary()["verdicts"]
    assert [file.size for file in exported.files] == [
        (tmp_path / "out" / file.path).stat().st_size for file in exported.files
    ]


@pytest.mark.parametrize("bits", [8, 16])
def test_a_png_a_map_is_the_map_to_the_last_code(result: Result, tmp_path: Path, bits: Any) -> None:
    export_result(result, tmp_path / "out", format="png", bits=bits)
    folder, inside = tmp_path / "out" / "png", result.mask
    assert sorted(path.stem for path in folder.iterdir()) == ALL_MAPS
    color = png(folder / "base_color.png")
    assert color.dtype == np.dtype(f"uint{bits}")
    linear = decode_srgb(color / (2**bits - 1))
    np.testing.assert_allclose(linear[inside], result.albedo[inside], atol=1.2 / 2**bits)
    for name in ("roughness", "metallic"):
        found = png(folder / f"{name}.png")[..., 0]
        expected = getattr(result, name)
        np.testing.assert_array_equal(found[inside], codes(expected[inside], bits))
    deviation = known(result.uncertainty).deviation
    for name, values in (("base_color", deviation.albedo), ("metallic", deviation.metallic)):
        found = png(folder / f"{name}_deviation.png")[inside]
        np.testing.assert_array_equal(found.squeeze(), codes(values[inside], bits))
    normals = png(folder / "normal_opengl.png")[inside]
    np.testing.assert_array_equal(normals, codes(0.5 + 0.5 * result.normals[inside], bits))
    np.testing.assert_array_equal(png(folder / "mask.png")[..., 0], codes(inside, bits))
    for name in ALL_MAPS:
        parts = chunks((folder / f"{name}.png").read_bytes())
        if name == "base_color":
            assert b"sRGB" in parts
        else:
            assert b"sRGB" not in parts
            assert struct.unpack(">I", parts[b"gAMA"]) == (100000,)


def coded_normals(result: Result, green: int) -> NDArray[Any]:
    """(3, H, W), with +Y up (1) or down (−1)."""
    return np.moveaxis(0.5 + 0.5 * result.normals * (1, green, 1), -1, 0)


Preset = Literal["unreal", "unity"]
PACKED: dict[Preset, dict[str, Callable[[Result], Any]]] = {
    "unreal": {
        "T_ORM": lambda result: (1, result.roughness, result.metallic),
        "T_Normal": lambda result: coded_normals(result, -1),
    },
    "unity": {
        "MaskMap": lambda result: (result.metallic, 1, 0, 1 - result.roughness),
        "NormalMap": lambda result: coded_normals(result, 1),
    },
}
"""Channels of the textures of a preset; its colours are left out."""


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("preset", PACKED)
def test_presets_pack_channels(result: Result, tmp_path: Path, preset: Preset, bits: Any) -> None:
    export_result(result, tmp_path / "out", preset=preset, bits=bits)
    folder, inside = tmp_path / "out" / "png", result.mask
    colors = {"unreal": ["T_BaseColor", "T_OpacityMask"], "unity": ["BaseMap"]}[preset]
    height = {"unreal": "T_Displacement", "unity": "HeightMap"}[preset]
    assert names(folder) == sorted(f"{name}.png" for name in (*colors, height, *PACKED[preset]))
    for name, channels in PACKED[preset].items():
        packed = png(folder / f"{name}.png")
        assert b"sRGB" not in chunks((folder / f"{name}.png").read_bytes())
        assert packed.shape[-1] == len(channels(result))
        for found, expected in zip(np.moveaxis(packed, -1, 0), channels(result), strict=True):
            whole_map = np.broadcast_to(expected, inside.shape)
            np.testing.assert_array_equal(found[inside], codes(whole_map[inside], bits))
    base = folder / f"{colors[0]}.png"
    assert b"sRGB" in chunks(base.read_bytes())
    if preset == "unity":
        np.testing.assert_array_equal(png(base)[..., 3], codes(inside, bits))
        export_result(whole(result), tmp_path / "whole", preset=preset, bits=bits)
        assert png(tmp_path / "whole" / "png" / "BaseMap.png").shape[-1] == 3


def test_normals_flip_green_alone(result: Result, tmp_path: Path) -> None:
    for convention in ("opengl", "directx"):
        for preset in (None, "unreal", "unity", "blender"):
            out = tmp_path / f"{convention}-{preset}"
            export_result(result, out, preset=preset, normals=convention)
            [file] = [path for path in (out / "png").iterdir() if "ormal" in path.name]
            n = result.normals * (1, -1 if convention == "directx" else 1, 1)
            samples = png(file)
            largest = np.iinfo(samples.dtype).max
            np.testing.assert_allclose(
                samples[result.mask] / largest, (0.5 + 0.5 * n)[result.mask], atol=0.51 / largest
            )
    up, down = (tmp_path / f"{convention}-None" for convention in ("opengl", "directx"))
    assert (up / "material.glb").read_bytes() == (down / "material.glb").read_bytes()
    vectors, texture = exr(down / "exr" / "materials.exr"), exr(down / "exr" / "normal_directx.exr")
    np.testing.assert_allclose(texture["G"], 0.5 - 0.5 * vectors["normal.Y"], atol=1e-6)
    for folder, green in ((up, "0.5 + 0.5 normal Y"), (down, "0.5 − 0.5 normal Y")):
        files = json.loads((folder / "export.json").read_text("utf-8"))["files"]
        maps = [file for file in files if "/normal_" in file["path"]]
        assert [file["holds"].split("; ")[1] for file in maps] == [green, green]
        assert all(file["color_space"].startswith("data, linear") for file in maps)


def test_exr_layers_and_textures_as_openexr_reads_them(result: Result, tmp_path: Path) -> None:
    export_result(result, tmp_path / "out", format="exr")
    folder, inside = tmp_path / "out" / "exr", result.mask
    layers = exr(folder / "materials.exr")
    assert {"albedo.R", "roughness.Y", "metallic.Y", "normal.Z", "mask.Y"} <= set(layers)
    kinds = ("", "low.", "high.")
    assert {f"uncertainty.{kind}roughness.Y" for kind in kinds} <= set(layers)
    [part] = OpenEXR.File(str(folder / "base_color.exr")).parts
    assert part.header["chromaticities"] == pytest.approx(
        (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    )
    colors = exr(folder / "base_color.exr")
    assert set(colors) == set("RGB")
    for c, name in enumerate("RGB"):
        assert colors[name].dtype == np.float32
        expected = result.albedo[..., c].astype(np.float32)
        np.testing.assert_array_equal(colors[name][inside], expected[inside])
    assert set(exr(folder / "roughness.exr")) == {"Y"}
    np.testing.assert_array_equal(
        exr(folder / "metallic.exr")["Y"][inside], result.metallic.astype(np.float32)[inside]
    )
    assert Result.load(saved(result, tmp_path / "result")).mask.sum() == inside.sum()
    before = exr(tmp_path / "result" / "materials.exr")
    assert before.keys() == layers.keys()
    for name, values in before.items():
        np.testing.assert_array_equal(layers[name], values)


def saved(result: Result, path: Path) -> Path:
    result.save(path)
    return path


def test_nothing_is_nan_and_outside_holds_the_nearest(result: Result, tmp_path: Path) -> None:
    export_result(result, tmp_path / "out")
    for path in (tmp_path / "out").rglob("*.exr"):
        for name, values in exr(path).items():
            assert np.isfinite(values).all(), (path, name)
    # The nearest, as the layers of a saved result are (test_result.py).
    folder = tmp_path / "out" / "exr"
    roughness = exr(folder / "materials.exr")["roughness.Y"]
    np.testing.assert_array_equal(exr(folder / "roughness.exr")["Y"], roughness)


def test_the_glb_keeps_to_the_specification(result: Result, tmp_path: Path) -> None:
    one = small((1, 1), 0, result)
    for i, (of, geometry) in enumerate(product((result, whole(result), one), GEOMETRIES)):
        export_result(of, tmp_path / str(i), format="gltf", geometry=geometry)
        read = glb_reader.read((tmp_path / str(i) / "material.glb").read_bytes())
        assert read.document["asset"]["generator"] == f"pbrfit {version('pbrfit')}"
        assert "sRGB" in read.document["asset"]["extras"]["color_space"]


def test_glb_textures_are_the_maps_in_their_channels(result: Result) -> None:
    for of in (result, whole(result)):
        read = glb_reader.read(glb(Maps.of(of), of.fov))
        [material] = read.document["materials"]
        color, packed, normal = (png(read.images[name]) for name in read.images)
        inside = of.mask
        assert ("alphaMode" in material) == (not inside.all())
        assert color.shape[-1] == (3 if inside.all() else 4)
        if not inside.all():
            assert (material["alphaMode"], material["alphaCutoff"]) == ("MASK", 0.5)
            np.testing.assert_array_equal(color[..., 3], np.where(inside, 255, 0))
        linear = decode_srgb(color[..., :3] / 255)
        np.testing.assert_allclose(linear[inside], of.albedo[inside], atol=0.005)
        assert (packed[..., 0] == 0).all()
        np.testing.assert_array_equal(packed[inside][:, 1], codes(of.roughness[inside], 8))
        np.testing.assert_array_equal(packed[inside][:, 2], codes(of.metallic[inside], 8))
        assert normal.dtype == np.uint16
        np.testing.assert_array_equal(normal[inside], codes(0.5 + 0.5 * of.normals[inside], 16))
        for content in read.images.values():  # nothing that a client might act upon
            assert not {b"gAMA", b"sRGB", b"iCCP", b"cHRM"} & set(chunks(content))
        wide = glb_reader.read(glb(Maps.of(of), of.fov, bits=16))
        assert all(png(content).dtype == np.uint16 for content in wide.images.values())


@pytest.mark.parametrize(
    ("shape", "fov"), [((7, 7), 60.0), ((5, 8), 35.0), ((9, 4), 120.0), ((1, 1), 60.0)]
)
def test_the_camera_sees_every_texel_along_its_view_direction(
    shape: tuple[int, int], fov: float, result: Result
) -> None:
    """Texel centres on the plane, from the camera, and where they fall on its picture."""
    height, width = shape
    read = glb_reader.read(glb(Maps.of(small(shape, fov, result)), fov))
    [primitive] = read.document["meshes"][0]["primitives"]
    [camera] = read.document["cameras"]
    at = np.array(read.document["nodes"][1]["translation"])
    points = texel_centres(read, primitive, shape)
    towards = at - points
    views = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    np.testing.assert_allclose(views, view_directions(height, width, fov), atol=1e-6)
    # Projection matrix of the specification, 3.10.3.
    perspective = camera["perspective"]
    focal = 1 / np.tan(perspective["yfov"] / 2)
    x = -towards[..., 0] / towards[..., 2] * focal / perspective["aspectRatio"]
    y = -towards[..., 1] / towards[..., 2] * focal
    np.testing.assert_allclose(x[0], (2 * np.arange(width) + 1 - width) / width, atol=1e-6)
    np.testing.assert_allclose(y[:, 0], (height - 1 - 2 * np.arange(height)) / height, atol=1e-6)


def test_no_field_of_view_is_an_orthographic_camera(result: Result) -> None:
    read = glb_reader.read(glb(Maps.of(small((4, 6), 0, result)), 0))
    [camera] = read.document["cameras"]
    assert camera["type"] == "orthographic"
    assert camera["orthographic"]["xmag"] == 0.5
    assert camera["orthographic"]["ymag"] == pytest.approx(0.5 * 4 / 6)
    assert read.document["nodes"][1]["translation"][2] > camera["orthographic"]["znear"]


def texel_centres(
    read: glb_reader.Glb, primitive: dict[str, Any], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Where on the plane each texel's centre lies, from positions and texture coordinates."""
    position, uv = (
        read.arrays[primitive["attributes"][name]].astype(float)
        for name in ("POSITION", "TEXCOORD_0")
    )
    height, width = shape
    # The plane is a parallelogram: position is affine in (u, v), v downwards from the first row.
    affine, *_ = np.linalg.lstsq(np.c_[uv, np.ones(4)], position, rcond=None)
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return np.asarray(np.stack([u, v, np.ones(shape)], axis=-1) @ affine)


def test_tangent_space_is_camera_space_and_the_front_faces_the_camera(result: Result) -> None:
    read = glb_reader.read(glb(Maps.of(result), result.fov))
    [primitive] = read.document["meshes"][0]["primitives"]
    position, normal, tangent, uv = (
        read.arrays[primitive["attributes"][name]].astype(float)
        for name in ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_0")
    )
    bitangent = np.cross(normal, tangent[:, :3]) * tangent[:, 3:]
    np.testing.assert_array_equal(tangent[:, :3], np.tile([1, 0, 0], (4, 1)))
    np.testing.assert_array_equal(bitangent, np.tile([0, 1, 0], (4, 1)))
    np.testing.assert_array_equal(normal, np.tile([0, 0, 1], (4, 1)))
    # u grows along the tangent, v against the bitangent.
    affine, *_ = np.linalg.lstsq(np.c_[uv, np.ones(4)], position, rcond=None)
    assert affine[0] @ tangent[0, :3] > 0
    assert affine[1] @ bitangent[0] < 0
    for a, b, c in position[read.arrays[primitive["indices"]].reshape(-1, 3)]:
        assert np.cross(b - a, c - a)[2] > 0  # counter-clockwise: specification, 3.7.2.1


@pytest.mark.parametrize(("fov", "shape"), [(60.0, (10, 12)), (0.0, (10, 12)), (100.0, (6, 3))])
def test_facets_cover_pixels_and_have_their_normals(fov: float, shape: tuple[int, int]) -> None:
    height, width = shape
    random = np.random.default_rng(3)
    normals = unit(view_directions(height, width, fov) + 0.5 * random.normal(size=(*shape, 3)))
    mask = random.uniform(size=shape) < 0.8
    mesh = facets(normals, mask, fov)
    assert len(mesh.triangles) == 2 * mask.sum()
    corners = mesh.attributes["POSITION"].astype(float).reshape(-1, 4, 3)
    eye = np.array([0, 0, camera(height, width, fov)[1]])
    scale = 1.0 if fov == 0 else eye[2] / (eye[2] - corners[..., 2])
    i, j = np.nonzero(mask)
    across = (corners[..., 0] * scale + 0.5) * width
    np.testing.assert_allclose(across, j[:, None] + [0, 1, 1, 0], atol=1e-4)
    down = height / 2 - corners[..., 1] * scale * width
    np.testing.assert_allclose(down, i[:, None] + [1, 1, 0, 0], atol=1e-4)
    texels = mesh.attributes["TEXCOORD_0"].reshape(-1, 4, 2)
    centres = np.stack([(j + 0.5) / width, (i + 0.5) / height], axis=-1)
    np.testing.assert_allclose(texels, np.repeat(centres[:, None], 4, axis=1), atol=1e-6)
    n = normals[mask]
    vectors = mesh.attributes["NORMAL"].reshape(-1, 4, 3)
    np.testing.assert_allclose(vectors, np.repeat(n[:, None], 4, axis=1), atol=1e-6)
    # The face itself, where it is not limited: seen nearly from the side it would be endless.
    free = np.abs(corners[..., 2]).max(axis=-1) < 0.45 * eye[2]
    free &= (n * view_directions(height, width, fov)[mask]).sum(axis=-1) > 0.1
    assert free.sum() > 0.5 * len(n)
    for a, b, c in ((0, 1, 2), (0, 2, 3)):
        face = unit(np.cross(corners[:, b] - corners[:, a], corners[:, c] - corners[:, a]))
        np.testing.assert_allclose(face[free], n[free], atol=2e-4)


def lamp() -> np.ndarray:
    """Light from right, above and behind the camera, which rings: negative in many directions."""
    basis = sh_basis(np.array([0.6, 0.64, 0.48]))
    return np.asarray(basis[:, None] * np.array([1.0, 0.5, 0.25]))


def test_panoramas_light_as_the_lights_do(result: Result, tmp_path: Path) -> None:
    lighting = np.stack([lamp(), 0 * lamp(), np.eye(16, 1) * np.full(3, 3.0)])
    lit = dataclasses.replace(result, lighting=lighting)
    exported = export_result(lit, tmp_path / "out", format="png")
    for light, of in zip(exported.panoramas, lighting, strict=True):
        found = panorama.read(tmp_path / "out" / "lights" / light.file)
        expected = relight(lit, of)
        difference = relight(lit, panorama.project(found)) - expected
        rms = np.sqrt(np.nanmean(expected**2)) or 1.0
        assert light.difference == pytest.approx(np.sqrt(np.nanmean(difference**2)) / rms, abs=1e-6)
    assert 0 < exported.panoramas[0].difference < 0.05
    assert [light.difference for light in exported.panoramas[1:]] == [0, 0]
    # What leaving out the negative part would do to the surfaces.
    clamped = panorama.project(np.maximum(panorama.radiance(lamp(), 64), 0))
    change = relight(lit, clamped) - relight(lit, lamp())
    assert np.sqrt(np.nanmean(change**2) / np.nanmean(relight(lit, lamp()) ** 2)) > 0.2
    # Brightest about where the lamp is.
    found = panorama.read(tmp_path / "out" / "lights" / "a.exr")
    peak = panorama.directions(*found.shape[:2])[
        np.unravel_index(found[..., 0].argmax(), found.shape[:2])
    ]
    assert np.degrees(np.arccos(peak @ [0.6, 0.64, 0.48])) < 25
    with (tmp_path / "out" / "lights" / "panoramas.csv").open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    assert [row["picture"] for row in rows] == list(result.pictures)
    assert [row["file"] for row in rows] == [light.file for light in exported.panoramas]
    assert [float(row["relit_difference"]) for row in rows] == pytest.approx(
        [light.difference for light in exported.panoramas], abs=1e-6
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_panorama_of_a_negative_light_is_the_best_there_is(seed: int) -> None:
    """The same problem with a number a pixel instead of 16, by non-negative least squares."""
    from scipy.optimize import nnls

    random = np.random.default_rng(seed)
    height, light = 10, random.normal(size=(16, 3))
    light[0] = random.normal(size=3)  # the mean light may be negative too
    weights = random.normal(size=(3, 40, 16)) * np.geomspace(1, 1e-3, 16)
    response = np.einsum("cpk,cpl->ckl", weights, weights) / 40
    found, _ = nonnegative_radiance(light, response, height, light)
    basis = sh_basis(panorama.directions(height, 2 * height)).reshape(-1, 16)
    angles = np.repeat(panorama.solid_angles(height, 2 * height), 2 * height)
    for c in range(3):
        ridge = RIDGE * np.trace(response[c]) / 16
        shown = weights[c] @ (basis * angles[:, None]).T / np.sqrt(40)
        system = np.vstack([shown, np.diag(np.sqrt(ridge * angles))])
        target = np.concatenate([weights[c] @ light[:, c] / np.sqrt(40), 0 * angles])
        expected, _ = nnls(system, target)
        np.testing.assert_allclose(found[..., c].ravel(), expected, atol=2e-4 * expected.max())


def test_black_surfaces_and_no_light_have_a_black_panorama() -> None:
    for light, response in (
        (lamp(), np.zeros((3, 16, 16))),
        (0 * lamp(), np.eye(16)[None] + [[[0]]] * 3),
    ):
        radiance, difference = nonnegative_radiance(light, response, 8, light)
        np.testing.assert_array_equal(radiance, 0)
        assert difference == 0


def test_lights_that_panoramas_cannot_hold_are_warned_of(
    result: Result,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    lights = np.zeros_like(result.lighting)
    lights[:, 0] = 1.0
    lights[0] *= -1  # from all directions negative: only black comes near
    dark = dataclasses.replace(result, lighting=lights)
    share = export_result(dark, tmp_path / "a").panoramas[0].difference
    assert "1 of 3 lights are so negative in places" in caplog.text
    assert "(a by 100 %)" in caplog.text
    for least, warned in ((share, 1), (np.nextafter(share, 2), 0)):
        caplog.clear()
        monkeypatch.setattr("pbrfit.export.DIFFERENCE_WARNED", least)
        export_result(dark, tmp_path / f"{warned}")
        assert len(caplog.messages) == warned


def test_no_name_in_a_table_is_a_formula(result: Result, tmp_path: Path) -> None:
    names = ("=1+2", "-x", "'=a")
    named = dataclasses.replace(result, pictures=names)
    export_result(named, tmp_path / "out", format="png")
    with (tmp_path / "out" / "lights" / "panoramas.csv").open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    for column, end in (("picture", ""), ("file", ".exr")):
        assert [row[column] for row in rows] == [f"'{name}{end}" for name in names]


def test_names_of_pictures_become_names_of_files() -> None:
    found = file_names(("a", "A", "dir/lamp: 1", "..", "", "ç", "a"))
    assert found == ("a", "A_2", "dir_lamp_ 1", "light", "light_2", "ç", "a_3")
    assert len({name.casefold() for name in found}) == len(found)
    assert file_names(("\u00e4", "a\u0308")) == ("\u00e4", "a\u0308_2")
    assert file_names(("CON", "lpt1.b", "console")) == ("_CON", "_lpt1.b", "console")
    long = file_names(("x" * 300, "X" * 300, "\u00e4" * 150))
    assert long == ("x" * 200, "X" * 200 + "_2", "\u00e4" * 100)


def test_one_pixel_without_field_of_view_and_uncertainty(result: Result, tmp_path: Path) -> None:
    export_result(small((1, 1), 0, result), tmp_path / "out")
    layers = exr(tmp_path / "out" / "exr" / "materials.exr")
    assert not any(name.startswith("uncertainty") for name in layers)
    assert png(tmp_path / "out" / "png" / "roughness.png").shape == (1, 1, 1)


def test_equal_results_give_equal_files(result: Result, tmp_path: Path) -> None:
    for name in ("a", "b"):
        export_result(result, tmp_path / name)
    for file in names(tmp_path / "a"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


def test_light_beyond_float32_is_its_largest_number(result: Result, tmp_path: Path) -> None:
    bright = dataclasses.replace(result, lighting=1e39 * result.lighting)
    exported = export_result(bright, tmp_path / "out", format="gltf")
    for light in exported.panoramas:
        found = exr(tmp_path / "out" / "lights" / light.file)
        assert max(channel.max() for channel in found.values()) == np.finfo(np.float32).max


def test_unusable_results_are_refused_and_leave_nothing(result: Result, tmp_path: Path) -> None:
    broken = result.roughness.copy()
    broken[np.argwhere(result.mask)[0][0], np.argwhere(result.mask)[0][1]] = np.nan
    materials = dataclasses.replace(result.materials, roughness=broken)
    with pytest.raises(InputError, match="roughness: expected finite values inside the mask"):
        export_result(dataclasses.replace(result, materials=materials), tmp_path / "out")
    empty = dataclasses.replace(result, mask=np.zeros((HEIGHT, WIDTH), bool))
    with pytest.raises(InputError, match="mask: expected at least one pixel"):
        export_result(empty, tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def folder(result: Result, tmp_path: Path) -> Path:
    return saved(result, tmp_path / "résultat 1")


def test_export_prints_what_it_wrote(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "出力"
    lines = done("export", folder, "--out", out).splitlines()
    found = [name for name in names(out) if name != "export.json"]
    total = sum((out / name).stat().st_size for name in found)
    assert lines[0] == f"{out}: {len(found) + 1} files, {total / 1e6:.2f} MB"
    # Panoramas, a file a picture, share the last line.
    panoramas = [name for name in found if re.fullmatch(r"lights/.*\.exr", name)]
    others = [name for name in found if name not in panoramas]
    assert len(panoramas) > 1
    assert sorted(line.split(" ")[0] for line in lines[1:-1]) == others
    for line in lines[1:-1]:
        name = line.split(" ")[0]
        assert f" {(out / name).stat().st_size / 1e3:.1f} kB  " in line
    size = sum((out / name).stat().st_size for name in panoramas)
    start = rf"lights/\*\.exr \({len(panoramas)}\) +{size / 1e3:.1f} kB  a panorama a light"
    assert re.fullmatch(
        rf"{start}; without negative light, at most \d+\.\d% different \(.*\)", lines[-1]
    )
    assert done("export", folder, "--out", out, "--quiet", "--overwrite") == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["résultat 1", "出力"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"format": "gltf", "preset": "unreal"}, "preset: expected none with format gltf"),
        ({"format": "mtlx", "preset": "blender"}, "preset: expected none with format mtlx"),
        ({"format": "gltf", "normals": "directx"}, "normals: expected opengl, the convention"),
        ({"format": "exr", "bits": 8}, "bits: expected none with format exr"),
        ({"format": "ptm", "bits": 8}, "bits: expected none with format ptm, found 8"),
        ({"format": "rti", "normals": "directx"}, "normals: expected none with format rti"),
        ({"preset": "unity", "geometry": "facets"}, "geometry: expected none where no glTF"),
        *(
            ({name: "tiff"}, f"{name}: expected one of .*, found 'tiff'")
            for name in ("format", "preset", "normals", "bits", "geometry")
        ),
    ],
)
def test_options_that_are_none_or_without_effect_are_refused(
    result: Result, tmp_path: Path, options: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        export_result(result, tmp_path / "out", **options)
    assert not list(tmp_path.iterdir())


def test_what_is_there_stays(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done("export", folder, "--out", out, "--format", "png")
    before = {name: (out / name).read_bytes() for name in names(out)}
    said = refused("export", folder, "--out", out)
    assert "out: expected a folder that does not exist yet" in said
    assert {name: (out / name).read_bytes() for name in names(out)} == before
    done("export", folder, "--out", out, "--overwrite")
    assert (out / "material.glb").exists()
    inside = saved(Result.load(folder), out / "result")
    for of, place, message in (
        (inside, out, "found result besides; move it away first"),
        (inside, inside, "expected an earlier output to replace"),
        (inside, folder, "expected an earlier output to replace"),
        (folder, out / "export.json", "expected a folder or nothing, found a file"),
    ):
        assert message in refused("export", of, "--out", place, "--overwrite")
    assert Result.load(inside).pictures == Result.load(folder).pictures
