"""Which light is taken: lamps on pictures of lamps, harmonics on pictures of harmonics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pbrfit import Result, decompose
from pbrfit.fit.lamps.decision import choose
from pbrfit.fit.lamps.picture_light import fit_picture_light
from pbrfit.model.geometry import angles_between
from pbrfit.model.lamps import Lamps
from pbrfit.result.relighting import rendered_picture
from pbrfit.synthetic import make_scene
from planted_lamps import far, planted, setup, without_colors
from scene_files import room
from under_lamps import ball_under_lamps


def assert_same(one: Result, other: Result) -> None:
    np.testing.assert_array_equal(one.albedo, other.albedo)
    np.testing.assert_array_equal(one.roughness, other.roughness)
    np.testing.assert_array_equal(one.metallic, other.metallic)
    np.testing.assert_array_equal(one.lighting, other.lighting)
    assert one.lamps is None
    assert other.lamps is None


@pytest.mark.slow
def test_lamps_are_taken_on_pictures_of_lamps() -> None:
    choice = choose(planted(far(8), size=32).scene, setup(light="auto"))
    assert choice.lamps
    assert choice.figures["left_out_lamps"] < choice.figures["left_out_sh"]
    assert choice.figures["left_out_pixels"] > 100
    assert "of left-out pixels lamps leave" in choice.why


@pytest.mark.slow
def test_harmonics_are_taken_on_theirs_and_stay_as_they_are() -> None:
    scene = make_scene("room", size=24, lights=4, held_out=1)
    assert not choose(scene, setup(light="auto")).lamps
    auto, asked = (decompose(scene, light=light, iterations=8) for light in ("auto", "sh"))
    assert_same(auto, asked)
    assert any(said.startswith("lamps: ") for said in auto.left_out)


@pytest.mark.slow
def test_two_pictures_are_too_few_for_lamps() -> None:
    scene = room()
    two = replace(scene, images=scene.images[:2], names=scene.names[:2], limits=None)
    choice = choose(two, setup(light="auto"))
    assert (choice.lamps, choice.why) == (False, "fewer than 3 pictures")
    auto, asked = (decompose(two, light=light, iterations=4) for light in ("auto", "sh"))
    assert_same(auto, asked)


def test_what_is_known_decides() -> None:
    scene = room()
    assert choose(replace(scene, lamps=without_colors(far(3))), setup(light="auto")).lamps
    known = np.zeros((3, 16, 3))
    known[:, 0] = 1.0
    choice = choose(replace(scene, lighting=known), setup(light="auto"))
    assert (choice.lamps, choice.why) == (False, "lights are known")


@pytest.mark.parametrize("ambient_terms", [0, 9])
def test_the_lamp_of_one_more_picture_is_found(ambient_terms: int) -> None:
    result = ball_under_lamps()
    place, color = np.array([[0.36, 0.48, 0.8]]), np.array([[1.1, 0.9, 0.7]])
    lamp = Lamps(np.zeros(1, np.intp), place, colors=color)
    around = np.zeros((1, 16, 3))
    if ambient_terms:
        around[:, :4] = 0.05 * np.random.default_rng(0).normal(size=(1, 4, 3))
        around[:, 0] += 0.2
    picture = rendered_picture(replace(result, lamps=lamp, lighting=around, pictures=("new",)), 0)
    found, ambient = fit_picture_light(result, picture, ambient_terms=ambient_terms)
    assert angles_between(found.places, lamp.places)[0] < 1
    np.testing.assert_allclose(found.colors, lamp.colors, rtol=0.05)
    assert ambient.shape == (16, 3)
    known, _ = fit_picture_light(
        result, picture, direction=lamp.places[0], ambient_terms=ambient_terms
    )
    np.testing.assert_array_equal(known.places, lamp.places)
    np.testing.assert_allclose(known.colors, lamp.colors, rtol=0.05)
