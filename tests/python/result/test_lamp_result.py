"""Results with lamps and a height: what they keep, and their pictures again."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import DirectionalLight, InputError, Result, relight
from pbrfit.fit.lamps.picture_light import light_of_picture
from pbrfit.model.geometry import angles_between, view_directions
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import render
from pbrfit.result.preview import preview
from pbrfit.result.relighting import turned
from relit import fitted, shaded_ball
from result_files import FILES
from scene_files import known
from under_lamps import ball_under_lamps, near_lamp


@pytest.fixture(scope="module")
def result() -> Result:
    return ball_under_lamps()


def test_lamps_and_height_are_kept(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted([*FILES, "height.exr"])
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert "height.exr" in content["files"]
    found = Result.load(tmp_path / "out")
    lamps, height = known(found.lamps), known(found.height)
    np.testing.assert_array_equal(lamps.places, known(result.lamps).places)
    np.testing.assert_array_equal(lamps.colors, known(result.lamps).colors)
    np.testing.assert_array_equal(height, known(result.height).astype(np.float32))
    assert np.isnan(height[~found.mask]).all()
    found.save(tmp_path / "again")
    for name in (*FILES, "height.exr"):
        if name != "result.json":
            again = (tmp_path / "again" / name).read_bytes()
            assert again == (tmp_path / "out" / name).read_bytes(), name


def test_a_missing_or_other_height_is_told(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    (tmp_path / "out" / "height.exr").write_bytes(b"")
    with pytest.raises(InputError, match=r"height\.exr"):
        Result.load(tmp_path / "out")
    (tmp_path / "out" / "height.exr").unlink()
    with pytest.raises(OSError, match=r"height\.exr"):
        Result.load(tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lamps": near_lamp((0, 0, 1))}, "lamps: expected depth for near lamps, found none"),
        ({"height": np.zeros((2, 2))}, r"height: expected \(32, 32\), found \(2, 2\)"),
    ],
)
def test_unfit_parts_are_refused(result: Result, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        dataclasses.replace(result, **change)


def test_a_picture_is_lit_by_its_own_lamps_and_ambient_light(result: Result) -> None:
    assert result.lamps is not None
    surface = result.materials, result.normals
    for i in range(3):
        expected = render(*surface, result.lighting[i], result.fov, model=result.model)
        for k in np.flatnonzero(result.lamps.pictures == i):
            x, y, z = result.lamps.places[k].tolist()
            azimuth, elevation = math.degrees(math.atan2(x, z)), math.degrees(math.asin(y))
            lamp = DirectionalLight(azimuth, elevation, tuple(result.lamps.colors[k].tolist()))
            expected += relight(result, lamp)
        np.testing.assert_allclose(relight(result, picture=i), expected, rtol=1e-10, atol=1e-12)
    lamps, ambient = result.lights[0]
    alone = relight(result, lamps)
    sky = relight(result, ambient)
    np.testing.assert_allclose(alone + sky, relight(result, picture=0), rtol=1e-12)


def test_lamps_are_turned_as_a_hard_light_is(result: Result) -> None:
    light = DirectionalLight(20, 30)
    lamps = Lamps(np.array([0]), light.direction[None], colors=np.ones((1, 3)))
    found = turned((lamps, result.lighting[0]), 70)
    np.testing.assert_allclose(found[0].places[0], light.turned(70).direction, atol=1e-15)
    np.testing.assert_allclose(found[1], turned(result.lighting[0], 70))
    with pytest.raises(InputError, match="expected far ones to be turned, found near ones"):
        turned(near_lamp((0, 0, 1)), 10)


def test_surroundings_cast_shadows_of_lamps() -> None:
    ball = shaded_ball()
    direction = np.array([0.6, 0.6, 0.53])
    direction /= np.linalg.norm(direction)
    far = Lamps(np.array([0]), direction[None], colors=np.ones((1, 3)))
    under = DirectionalLight(
        float(np.degrees(np.arctan2(direction[0], direction[2]))),
        float(np.degrees(np.arcsin(direction[1]))),
    )
    expected = relight(ball, under)
    np.testing.assert_allclose(relight(ball, far), expected, atol=1e-9)
    # So far away that it is as good as far.
    size = 1e4
    near = Lamps(np.array([0]), size * direction[None], np.array([True]), size**2 * np.ones((1, 3)))
    differing = np.abs(relight(ball, near) - expected).max(axis=-1) > 1e-2
    assert differing.mean() < 0.005
    assert not np.allclose(relight(ball, far, shadows=False), expected)


def test_ambient_light_among_surroundings_stays(result: Result) -> None:
    ball = shaded_ball()
    sky = fitted().lighting[0]
    none = Lamps(np.zeros(0, int), np.zeros((0, 3)), colors=np.zeros((0, 3)))
    np.testing.assert_allclose(relight(ball, (none, sky)), relight(ball, sky), rtol=1e-6)
    with pytest.raises(InputError, match=r"ambient: expected finite \(16, 3\)"):
        relight(result, (none, result.lighting))
    with pytest.raises(InputError, match="lamps: expected indices of 1 pictures, found 2"):
        relight(result, known(result.lamps))


def test_the_preview_shows_lamps(result: Result) -> None:
    dark = dataclasses.replace(result, lamps=None)
    assert not np.array_equal(preview(result), preview(dark))


@pytest.mark.parametrize("ambient", [0.0, 0.2, -0.01])
def test_the_lamp_of_one_more_picture_is_found(result: Result, ambient: float) -> None:
    """Levels that were cut too low are no negative light."""
    place, color = np.array([[0.36, 0.48, 0.8]]), np.array([[1.1, 0.9, 0.7]])
    lamp = Lamps(np.zeros(1, np.intp), place, colors=color)
    around = np.zeros((1, 16, 3))
    around[:, 0] = max(ambient, 0.0)
    picture = relight(
        dataclasses.replace(result, lamps=lamp, lighting=around, pictures=("new",)), picture=0
    )
    used = result.mask
    maps = (
        np.asarray(of[used], float) for of in (result.albedo, result.roughness, result.metallic)
    )
    height, width = used.shape
    views = view_directions(height, width, result.fov)[used]
    samples = np.asarray(picture[used], float) + min(ambient, 0.0)
    found, sky, shown = light_of_picture(
        samples, np.ones_like(samples), result.normals[used], views, tuple(maps), result.model
    )
    assert angles_between(found.places, lamp.places)[0] < 1
    np.testing.assert_allclose(found.colors, lamp.colors, rtol=0.05)
    assert sky.shape == (16, 3)
    np.testing.assert_allclose(sky, around[0], atol=0.01 if ambient >= 0 else 0.0)
    np.testing.assert_allclose(shown, samples, atol=0.02)
