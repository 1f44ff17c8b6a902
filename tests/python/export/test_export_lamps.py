"""Exports of lamps and height: .lp, polynomial texture maps, displacement, panoramas."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from command_runs import done
from pbrfit import InputError, Result, relight
from pbrfit.export import export_result
from pbrfit.export.rti import basis, directions, lp, openlime, ptm, rti
from pbrfit.io import images
from pbrfit.io.color import encode_srgb
from pbrfit.io.lamp_files import read_lamps
from pbrfit.model import panorama
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import Lighting
from pbrfit.result.metrics import rmse, white_of
from pbrfit.values.arrays import Array
from relit import ball
from under_lamps import ball_under_lamps


@pytest.fixture(scope="module")
def result() -> Result:
    return ball_under_lamps()


@pytest.fixture(scope="module")
def each(result: Result) -> Result:
    """One lamp in each picture, the second of them near."""
    places = np.array([(-0.48, 0.6, 0.64), (3.0, 0.0, -1.0), (0.8, 0.0, 0.6)])
    near = np.array([False, True, False])
    return dataclasses.replace(
        result,
        pictures=("a", "b c", "d"),
        lamps=Lamps(np.arange(3), places, near, np.ones((3, 3))),
        depth=np.where(result.mask, 5.0, np.nan).astype(np.float32),
        inputs={"images/a.exr": "0", "images/b c.png": "0", "images/b c.jpg": "0", "depth.exr": ""},
    )


def test_directions_as_a_reader_of_lp_sees_them(each: Result, tmp_path: Path) -> None:
    path = tmp_path / "lamps.lp"
    path.write_text(lp(each), encoding="utf-8")
    rows, said = read_lamps(path)
    assert said == ""
    # What two files could be is told by the picture's name.
    assert [row.picture for row in rows] == ["a.exr", "b c", "d"]
    expected = [(-0.48, 0.6, 0.64), (0.6, 0, 0.8), (0.8, 0, 0.6)]
    np.testing.assert_allclose([row.place for row in rows], expected, atol=1e-8)


def test_lp_is_refused_without_one_lamp_a_picture(result: Result, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected .* with a lamp in each of 3 .* 2 far lam"):
        export_result(result, tmp_path / "out", format="lp")
    plain = dataclasses.replace(result, lamps=None)
    with pytest.raises(InputError, match="for lp, found none"):
        export_result(plain, tmp_path / "out", format="lp")
    assert list(tmp_path.iterdir()) == []


def test_lp_and_displacement_are_part_of_an_export(each: Result, tmp_path: Path) -> None:
    each.save(tmp_path / "result")
    done("export", tmp_path / "result", "--out", tmp_path / "out")
    assert (tmp_path / "out" / "lights" / "lamps.lp").read_text("utf-8") == lp(each)
    known = np.isfinite(each.height) if each.height is not None else np.zeros(1, bool)
    height = np.asarray(each.height, np.float64) / 32
    floats = images.read_channels(tmp_path / "out" / "exr" / "displacement.exr")["Y"]
    np.testing.assert_array_equal(floats[known], height[known].astype(np.float32))
    assert np.isfinite(floats).all()
    content = json.loads((tmp_path / "out" / "export.json").read_text("utf-8"))
    told = content["displacement"]
    assert (told["unit"], told["source"]) == ("picture widths", "fit")
    codes = images.read_picture(tmp_path / "out" / "png" / "displacement.png", "linear").pixels
    found = told["low"] + (told["high"] - told["low"]) * codes[..., 0]
    step = (told["high"] - told["low"]) / 65535
    np.testing.assert_allclose(found[known], height[known], atol=0.51 * step + 1e-6)
    paths = {file["path"] for file in content["files"]}
    assert {"lights/lamps.lp", "exr/displacement.exr", "png/displacement.png"} <= paths
    done("export", tmp_path / "result", "--out", tmp_path / "unreal", "--preset", "unreal")
    assert (tmp_path / "unreal" / "png" / "T_Displacement.png").exists()
    done("export", tmp_path / "result", "--out", tmp_path / "lp", "--format", "lp")
    written = sorted(path.name for path in (tmp_path / "lp").iterdir())
    assert written == ["export.json", "lights"]


def test_results_without_lamps_and_height_are_as_ever(result: Result, tmp_path: Path) -> None:
    plain = dataclasses.replace(result, lamps=None, height=None)
    export_result(plain, tmp_path / "out")
    assert not list((tmp_path / "out").rglob("*.lp"))
    # The normals have a height all the same; a ball's is about that which the fit found.
    found = images.read_channels(tmp_path / "out" / "exr" / "displacement.exr")["Y"]
    known = np.isfinite(np.asarray(result.height))
    off = found[known] - np.asarray(result.height)[known] / 32
    assert np.std(off) < 0.02 * np.ptp(found[known])


def test_a_negative_ambient_part_is_judged_beside_the_lamps(each: Result, tmp_path: Path) -> None:
    lights = np.random.default_rng(3).normal(size=each.lighting.shape) * 1e-3
    weak = dataclasses.replace(each, lighting=lights)
    for of, least, most in ((weak, 0, 0.05), (dataclasses.replace(weak, lamps=None), 0.1, 2)):
        name = tmp_path / f"{most}"
        found = [one.difference for one in export_result(of, name, format="png").panoramas]
        assert least < max(found) < most


def decoded(content: bytes) -> tuple[Array, Array]:
    """Coefficients (H, W, 6) and colours (H, W, 3) of a PTM file, by its specification."""
    *lines, data = content.split(b"\n", 6)
    assert lines[:2] == [b"PTM_1.2", b"PTM_FORMAT_LRGB"]
    width, height = (int(line) for line in lines[2:4])
    scales, biases = ([float(one) for one in line.split()] for line in lines[4:6])
    assert all(bias == int(bias) and 0 <= bias <= 255 for bias in biases)
    assert len(data) == 9 * width * height
    values = np.frombuffer(data, np.uint8).astype(float)
    raw = values[: 6 * width * height].reshape(height, width, 6)[::-1]
    colors = values[6 * width * height :].reshape(height, width, 3)[::-1]
    return (raw - biases) * scales, colors


def shown(content: bytes, light: Array) -> Array:
    """What a viewer shows, from 0 to 1."""
    coefficients, colors = decoded(content)
    u, v = light[:2]
    brightness = coefficients @ np.array([u * u, v * v, u * v, u, v, 1])
    return np.asarray(np.clip(brightness[..., None] / 255 * colors / 255, 0, 1))


def relit(result: Result, light: Array) -> Any:
    lamp = Lamps(np.array([0]), light[None], colors=np.ones((1, 3)))
    return relight(result, lamp)


def matt(result: Result) -> Result:
    """A matt ball of three colours, which rings of differing brightness have."""
    made = ball(result, albedo=0.5, roughness=1.0)
    made.materials.albedo[:, :, 0] *= np.linspace(0.2, 1.5, 32)
    made.materials.albedo[:, :, 2] *= np.linspace(1.5, 0.1, 32)[:, None]
    return dataclasses.replace(made, lamps=None, height=None)


def test_a_texture_map_shows_what_relighting_does(result: Result) -> None:
    made = matt(result)
    content, white = ptm(made)
    assert white == pytest.approx(white_of(relit(made, np.array([0.0, 0, 1]))))
    for light in [(0, 0, 1), (0.6, 0, 0.8), (-0.48, 0.6, 0.64), (0, -0.8, 0.6)]:
        direction = np.array(light, float)
        expected = encode_srgb(np.clip(relit(made, direction) / white, 0, 1))[made.mask]
        found = shown(content, direction)[made.mask]
        error = np.sqrt(np.mean((found - expected) ** 2))
        # Six coefficients of sRGB codes are that far from a clamped cosine; the colour is exact.
        assert error < 0.1, (light, error)
        assert np.corrcoef(found.ravel(), expected.ravel())[0, 1] > 0.95
    assert (decoded(content)[1][~made.mask] == 0).all()


def test_a_texture_map_is_the_least_squares_fit_to_the_bit_of_its_codes(result: Result) -> None:
    made = matt(result)
    content, white = ptm(made)
    lights = directions()
    assert (np.degrees(np.arcsin(lights[:, 2])) > 9).all()
    np.testing.assert_allclose(np.linalg.norm(lights, axis=-1), 1)
    pictures = np.array(
        [encode_srgb(np.clip(relit(made, light) / white, 0, 1))[made.mask] for light in lights]
    )
    coefficients, colors = decoded(content)
    color = colors[made.mask] / 255
    brightness = np.einsum("npc,pc->np", pictures, color) / np.square(color).sum(axis=-1)
    expected, *_ = np.linalg.lstsq(basis(lights[:, :2]), 255 * brightness, rcond=None)
    span = coefficients[made.mask].max(axis=0) - coefficients[made.mask].min(axis=0)
    difference = np.abs(coefficients[made.mask] - expected.T)
    assert (difference <= 0.02 * span + 1).all()
    assert (np.sqrt(np.mean(difference**2, axis=0)) <= 0.005 * span + 0.5).all()


def of_rti(content: bytes) -> Array:
    """Coefficients (H, W, 3, 9) of an .rti file, as RTIViewer and relight read it."""
    *lines, data = content.split(b"\n", 4)
    assert lines[:2] == [b"#HSH1.2", b"3"]
    assert lines[3] == b"9 2 1"
    width, height, channels = map(int, lines[2].split())
    scale, low = np.frombuffer(data[:72], "<f4").reshape(2, 9)
    codes = np.frombuffer(data[72:], np.uint8).reshape(height, width, channels, 9)[::-1]
    return np.asarray(codes / 255 * scale + low)


def of_web(files: dict[str, bytes]) -> Array:
    """Coefficients (H, W, 3, 9) of planes, as OpenLIME's shader reads them."""
    info = json.loads(files["info.json"])
    assert (info["type"], info["colorspace"], info["nplanes"]) == ("hsh", "rgb", 27)
    planes = [np.asarray(Image.open(io.BytesIO(files[f"plane_{k}.jpg"]))) / 255 for k in range(9)]
    assert planes[0].shape == (info["height"], info["width"], 3)
    [material] = info["materials"]
    scale, bias = (np.reshape(material[name], (9, 3)) for name in ("scale", "bias"))
    return np.stack([(c - b) * s for c, b, s in zip(planes, bias, scale, strict=True)], axis=-1)


def viewer_weights(light: Array) -> Array:
    """Hemispherical harmonics as OpenLIME writes them."""
    phi, cos = np.arctan2(light[1], light[0]), light[2]
    root = np.sqrt(cos - cos**2)
    of = [1 / np.sqrt(2 * np.pi), np.sqrt(6 / np.pi) * np.cos(phi) * root]
    of += [np.sqrt(3 / (2 * np.pi)) * (2 * cos - 1), np.sqrt(6 / np.pi) * root * np.sin(phi)]
    of += [np.sqrt(30 / np.pi) * np.cos(2 * phi) * (cos**2 - cos)]
    of += [np.sqrt(30 / np.pi) * np.cos(phi) * (2 * cos - 1) * root]
    of += [np.sqrt(5 / (2 * np.pi)) * (1 - 6 * cos + 6 * cos**2)]
    of += [np.sqrt(30 / np.pi) * (2 * cos - 1) * root * np.sin(phi)]
    return np.array([*of, np.sqrt(30 / np.pi) * (cos**2 - cos) * np.sin(2 * phi)])


@pytest.mark.parametrize("light", [(0, 0, 1), (0.6, 0, 0.8), (-0.48, 0.6, 0.64), (0, -0.8, 0.6)])
def test_hemispherical_harmonics_show_what_relighting_does(
    result: Result, light: tuple[float, ...]
) -> None:
    made, direction = matt(result), np.array(light, float)
    (content, white), (web, _) = rti(made), openlime(made)
    expected = encode_srgb(np.clip(relit(made, direction) / white, 0, 1))[made.mask]
    texture = shown(ptm(made)[0], direction)[made.mask]
    for coefficients, close in ((of_rti(content), 0.06), (of_web(web), 0.07)):
        found = np.clip(coefficients @ viewer_weights(direction), 0, 1)
        assert rmse(found[made.mask], expected) < min(close, rmse(texture, expected))
    assert np.abs(of_rti(content)[~made.mask]).max() < 1e-6


@pytest.mark.parametrize("form", ["rti", "openlime"])
def test_harmonics_as_a_command_writes_them(result: Result, tmp_path: Path, form: str) -> None:
    result.save(tmp_path / "result")
    done("export", tmp_path / "result", "--out", tmp_path / "out", "--format", form)
    expected = {"relit.rti": rti(Result.load(tmp_path / "result"))[0]}
    if form == "openlime":
        web, _ = openlime(Result.load(tmp_path / "result"))
        expected = {f"openlime/{name}": content for name, content in web.items()}
    assert {name: (tmp_path / "out" / name).read_bytes() for name in expected} == expected


@pytest.mark.parametrize(
    "place", [(-0.48, 0.6, 0.64), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
)
def test_panoramas_hold_lamps_as_texels_of_the_same_irradiance(
    place: tuple[float, float, float], result: Result, tmp_path: Path
) -> None:
    lamps = Lamps(np.array([1]), np.array([place], float), colors=np.array([(1.0, 2.0, 0.5)]))
    lit = dataclasses.replace(result, lamps=lamps, lighting=np.zeros((3, 16, 3)))
    export_result(lit, tmp_path / "out", format="exr")
    shown = images.read_picture(tmp_path / "out" / "lights" / "b.exr").pixels
    np.testing.assert_allclose(
        panorama.project(np.asarray(shown, float)), lit.sh_lighting()[1], atol=0.02
    )
    lighting = Lighting.load(tmp_path / "out" / "lights" / "lighting.json")
    assert lighting.lamps is not None
    np.testing.assert_array_equal(lighting.lamps.places, lamps.places)
