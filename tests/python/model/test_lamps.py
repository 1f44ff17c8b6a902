"""Lamps as data, in `lighting.json`, and what surfaces show under them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import InputError, Materials
from pbrfit.model.geometry import positions, unit
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import Lighting
from pbrfit.model.reflection import MODELS, Model, render, render_directional, render_lamps
from scene_files import known

HEIGHT, WIDTH, FOV = 5, 7, 40.0
UP = math.sqrt(0.5)


def surfaces() -> tuple[Materials, Any, Any]:
    """Materials, normals and depth; a pixel is masked, and another has no depth."""
    random = np.random.default_rng(2)
    shape = (HEIGHT, WIDTH)
    materials = Materials(
        random.uniform(0, 1, (*shape, 3)),
        random.uniform(0.2, 1, shape),
        random.uniform(0, 1, shape),
    )
    normals = unit(random.normal(size=(*shape, 3)) * 0.4 + (0, 0, 1))
    for values in (materials.albedo, materials.roughness, materials.metallic, normals):
        values[1, 2] = np.nan
    depth = random.uniform(2, 3, shape)
    depth[3, 3] = np.nan
    return materials, normals, depth


def three() -> Lamps:
    """Of picture 0 a far lamp and a near one; of picture 2 a far one."""
    return Lamps(
        np.array([0, 0, 2]),
        np.array([(0, UP, UP), (0.5, 1.0, -0.5), (1, 0, 0)]),
        np.array([False, True, False]),
        np.array([(1, 0.5, 0.25), (3, 3, 3), (0.2, 0.2, 0.2)]),
        np.array([(0, 0, -1), (0, -UP, -UP), (0, 0, -1)]),
        np.array([0.0, 1.5, 0.0]),
    )


def sky(count: int = 3) -> Any:
    light = np.random.default_rng(5).normal(size=(count, 16, 3))
    light[:, 0] = 4
    return light


@pytest.mark.parametrize("model", MODELS)
def test_pictures_are_sums_over_their_lamps_and_ambient_light(model: Model) -> None:
    materials, normals, depth = surfaces()
    lamps, ambient = three(), sky()
    found = render_lamps(materials, normals, lamps, ambient, FOV, depth, model=model)
    expected = render(materials, normals, ambient, FOV, model=model)
    for k in (0, 2):
        expected[lamps.pictures[k]] += render_directional(
            materials, normals, lamps.places[k], lamps.colors[k], FOV, model=model
        )
    points = positions(depth, FOV)
    for i, j in np.ndindex(HEIGHT, WIDTH):
        away = lamps.places[1] - points[i, j]
        distance = np.linalg.norm(away)
        if not np.isfinite(distance):
            expected[0, i, j] = np.nan
            continue
        cosine = max(-away @ lamps.axes[1] / distance, 0.0)
        color = lamps.colors[1] * cosine**1.5 / distance**2
        alone = render_directional(materials, normals, away / distance, color, FOV, model=model)
        expected[0, i, j] += alone[i, j]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
    assert np.isnan(found[:, 1, 2]).all()
    assert np.isfinite(found[1:, 3, 3]).all()


def test_a_near_lamp_that_is_far_is_a_far_lamp() -> None:
    materials, normals, depth = surfaces()
    far = Lamps(np.array([0]), np.array([(0, 0.6, 0.8)]), colors=np.ones((1, 3)))
    near = Lamps(np.array([0]), 1e7 * far.places, np.array([True]), 1e14 * far.colors)
    pictures = [render_lamps(materials, normals, one, None, FOV, depth) for one in (far, near)]
    there = np.isfinite(depth)
    np.testing.assert_allclose(pictures[0][:, there], pictures[1][:, there], rtol=1e-5, atol=1e-6)


def test_half_of_a_lamp_is_half_as_bright_and_without_light_all_is_black() -> None:
    materials, normals, depth = surfaces()
    lamps = three()
    whole = render_lamps(materials, normals, lamps, None, FOV, depth)
    share = np.full((3, HEIGHT, WIDTH), 0.5)
    half = render_lamps(materials, normals, lamps, None, FOV, depth, visibility=share)
    np.testing.assert_allclose(half, whole / 2, rtol=1e-15)
    assert np.nanmax(np.abs(whole[1])) == 0
    share[1:] = 0
    one = render_lamps(materials, normals, lamps, None, FOV, depth, visibility=share)
    assert (one[2][np.isfinite(one[2])] == 0).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth": None}, "lamps: expected depth for near lamps, found none"),
        ({"ambient": sky(2)}, "lamps: expected indices of 2 pictures, found 2"),
        ({"ambient": sky(3)[0]}, r"ambient: expected shape \(N, 16, 3\), found \(16, 3\)"),
        ({"visibility": np.ones((1, 5, 7))}, r"visibility: expected shape \(3, 5, 7\), found"),
        ({"depth": np.ones((2, 2))}, "depth: expected shape"),
        (
            {"lamps": Lamps(np.array([0]), np.array([(0, 0, 1)]))},
            "lamps: expected known colors, found NaN",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(changes: dict[str, Any], message: str) -> None:
    materials, normals, depth = surfaces()
    given = {"lamps": three(), "ambient": None, "fov": FOV, "depth": depth} | changes
    with pytest.raises(InputError, match=message):
        render_lamps(materials, normals, **given)


NAMES = ("a", "b", "ç d")


def test_lamps_come_back_from_a_file_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "lighting.json"
    Lighting(NAMES, sky(), three()).save(path)
    content = json.loads(path.read_text("utf-8"))
    assert list(content) == ["version", "basis", "order", "pictures", "coefficients", "lamps"]
    assert content["version"] == 2
    far = {"picture": "a", "direction": [0, UP, UP], "color": [1, 0.5, 0.25]}
    assert content["lamps"][0] == far
    assert content["lamps"][1] == {
        "picture": "a",
        "position": [0.5, 1.0, -0.5],
        "color": [3, 3, 3],
        "axis": [0, -UP, -UP],
        "exponent": 1.5,
    }
    found = Lighting.load(path)
    assert found.pictures == NAMES
    np.testing.assert_array_equal(found.coefficients, sky())
    same(found.lamps, three())
    found.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


def same(found: Lamps | None, expected: Lamps) -> None:
    for name in ("pictures", "places", "near", "colors", "axes", "exponents"):
        np.testing.assert_array_equal(getattr(known(found), name), getattr(expected, name))


def test_lamps_in_the_order_of_pictures() -> None:
    found = three().of_pictures([NAMES.index("ç d"), NAMES.index("a")])
    np.testing.assert_array_equal(found.pictures, [0, 1, 1])
    np.testing.assert_array_equal(found.places, three().places[[2, 0, 1]])
    with pytest.raises(InputError, match="lamps: expected indices of 1 pictures, found 2"):
        Lighting(("a",), sky(1), three())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 3}, "found ValueError: version 3 in place of 2"),
        ({"version": None}, "found ValueError: lamps without version 2"),
        ({"lamps": None}, "expected JSON with basis.*found KeyError: 'lamps'"),
        ({"lamps": {}}, "in place of a list of lamps"),
        ({"lamps": [{"picture": "a"}]}, "lamp 1: expected picture and direction or position"),
        (
            {"lamps": [{"picture": "e", "direction": [0, 0, 1]}]},
            "lamp 1: expected the name of a picture of the file, found e",
        ),
        (
            {"lamps": [{"picture": "a", "direction": [0, 0, 2]}]},
            "lamp 1: expected a direction of length 1, found 2",
        ),
        (
            {"lamps": [{"picture": "a", "position": [0, 0, math.inf]}]},
            "inf in place of a finite number",
        ),
    ],
)
def test_other_lamps_are_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "lighting.json"
    Lighting(NAMES, sky(), three()).save(path)
    content = json.loads(path.read_text("utf-8")) | change
    content = {name: value for name, value in content.items() if value is not None}
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match=message) as raised:
        Lighting.load(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)
