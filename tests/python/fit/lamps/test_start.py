"""The start of a fit with lamps: planted scenes are found, and what cannot be is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lamp_scenes import LampScene, around, ball, relief
from pbrfit import InputError
from pbrfit.fit.lamps.ambiguity import SQUARE_ON, square_on_cost
from pbrfit.fit.lamps.samples import BAS_RELIEF, FirstShape
from pbrfit.fit.lamps.start import start_of_known_lamps, start_of_unknown_lamps


def found(scene: LampScene) -> FirstShape:
    return start_of_unknown_lamps(scene.samples, scene.usable, scene.mask, scene.views, scene.fov)


def under_known(scene: LampScene, strengths: np.ndarray | None = None) -> FirstShape:
    return start_of_known_lamps(
        scene.samples, scene.usable, scene.mask, scene.views, scene.directions, strengths
    )


def test_known_lamps_tell_a_glossy_ball() -> None:
    scene = ball(around(12, 40, 10), gloss=0.5, size=48)
    assert scene.error(under_known(scene, scene.strengths).normals) < 0.5


def test_strengths_of_known_lamps_are_found_where_directions_tell_them() -> None:
    strengths = np.linspace(0.7, 1.3, 8)
    scene = ball(around(8, 40, 15), strengths=strengths, size=48)
    start = under_known(scene)
    relative = start.strengths[:, 1] / start.strengths[:, 1].mean()
    np.testing.assert_allclose(relative, strengths / strengths.mean(), rtol=0.01)
    assert start.undetermined == ()
    of_three = under_known(ball(around(3, 40, 5), size=48))
    assert any("strengths" in words for words in of_three.undetermined)


def test_samples_are_albedo_times_strength_times_cosine() -> None:
    scene = ball(around(9, 40, 10), size=48, coded=False)
    start = under_known(scene)
    shading = np.maximum(np.einsum("hwi,ni->nhw", start.normals, start.directions), 0)
    again = start.albedo * shading[..., None] * start.strengths[:, None, None]
    off = np.abs(again - scene.samples)[:, scene.mask]
    # Pixels at the terminator of several lamps have too few samples to be exact.
    assert np.quantile(off, 0.99) < 1e-3
    assert np.isnan(start.albedo[~scene.mask]).all()


@pytest.mark.slow
def test_a_ball_of_several_albedos_under_unknown_lamps() -> None:
    scene = ball(around(9, 40, 10), strengths=np.linspace(0.9, 1.1, 9), size=56)
    start = found(scene)
    assert scene.error(start.normals) < 1.0
    assert scene.lamp_error(start.directions) < 1.0
    assert start.undetermined == ()
    bulged = ball(-around(9, 40, 10) * [1, 1, -1], size=56)
    assert bulged.error(found(bulged).normals) < 1.0


def test_cues_have_the_slopes_of_their_sum_by_bas_reliefs() -> None:
    relief = found(ball(around(9, 40, 10), size=40)).relief
    assert relief is not None
    at, step = np.array([[0.9, 0, 0.1], [0, 0.9, -0.05], [0, 0, 1.0]]), 1e-5
    for k, one in enumerate(BAS_RELIEF):
        up, down = (relief(at + sign * step * one @ at)[0] for sign in (1, -1))
        np.testing.assert_allclose(relief(at)[1][k], (up - down) / (4 * step), rtol=1e-4)
    assert (np.linalg.eigvalsh(relief.curvature(at)) >= -1e-9).all()


def test_a_mean_normal_off_the_axis_costs_as_a_normal_deviation() -> None:
    one = np.array([[np.sin(SQUARE_ON), 0.0, np.cos(SQUARE_ON)]])
    assert square_on_cost(one)[0] == pytest.approx(0.5, rel=0.02)
    level = np.concatenate([one, one * [-1, 1, 1]])
    assert square_on_cost(level)[0] == pytest.approx(0.0, abs=1e-12)


def test_half_a_ball_is_not_turned_to_the_camera() -> None:
    scene = ball(around(9, 40, 10), size=56)
    half = scene.mask & (scene.normals[..., 0] > 0.25)
    start = found(replace(scene, mask=half, usable=scene.usable & half[..., None]))
    mean = start.normals[half].mean(axis=0)
    assert np.degrees(np.arctan2(mean[0], mean[2])) > 30.0  # 42 in truth


def test_a_ball_in_four_pictures() -> None:
    scene = ball(around(4, 40, 5), size=56)
    assert scene.error(found(scene).normals) < 4.0


@pytest.mark.slow
def test_without_an_outline_a_relief_is_lit_from_above_and_that_is_said() -> None:
    directions = around(9, 40, 10) + np.array([0.0, 0.3, 0.0])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scene = relief(directions, size=56)
    start = found(scene)
    assert scene.error(start.normals) < 3.0
    assert any("bulged the other way" in words for words in start.undetermined)
    below = relief(directions * [1, -1, 1], size=56)
    turned = found(below).normals * [-1, -1, 1]
    assert below.error(turned) < 3.0


def test_perspective_tells_a_relief_from_the_one_bulged_the_other_way() -> None:
    directions = around(9, 40, 10) - np.array([0.0, 0.3, 0.0])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scene = relief(directions, size=56, fov=50)
    start = found(scene)
    assert scene.error(start.normals) < 2.0
    assert start.undetermined == ()


@pytest.mark.parametrize("known", [False, True])
def test_lamps_in_a_plane_leave_a_part_of_normals_and_that_is_said(known: bool) -> None:
    angle = np.radians(np.linspace(-50, 50, 7))
    scene = ball(np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1), size=48)
    start = under_known(scene) if known else found(scene)
    assert any("plane" in words for words in start.undetermined)
    assert np.isfinite(start.normals[scene.mask]).all()
    # Across the plane the ball's outline gives a rough shape.
    assert scene.error(start.normals) < 15.0


def test_pictures_in_one_channel() -> None:
    scene = ball(around(9, 40, 10), size=48)
    one = scene.samples[..., :1], scene.usable[..., :1]
    start = start_of_unknown_lamps(*one, scene.mask, scene.views)
    assert start.albedo.shape == (48, 48, 3)
    assert scene.error(start.normals) < 1.0


def test_a_clipped_red_leaves_green_and_blue() -> None:
    """An orange ball whose red is clipped wherever a lamp is near."""
    scene = ball(around(8, 40, 10), size=48)
    red = scene.samples[..., 0].clip(max=0.4 * scene.samples[..., 0].max())
    orange = np.concatenate([red[..., None], scene.samples[..., 1:]], axis=-1)
    usable = scene.usable.copy()
    usable[..., 0] &= red < red.max()
    lost = ~np.asarray(usable.all(axis=-1))[:, scene.mask]
    assert lost.mean() > 0.3
    start = start_of_known_lamps(
        orange, usable, scene.mask, scene.views, scene.directions, scene.strengths
    )
    assert scene.error(start.normals) < 0.5
    some = scene.mask & (usable[..., 0] & (red > 0.02)).any(axis=0)
    off = (start.albedo / scene.albedo)[some]
    assert np.abs(np.log(off / np.median(off, axis=0))).mean() < 0.02


def test_two_pictures_are_refused() -> None:
    of = ball(around(3, 40), size=24)
    with pytest.raises(InputError, match="three or more"):
        start_of_unknown_lamps(of.samples[:2], of.usable[:2], of.mask, of.views)


@pytest.mark.parametrize("pixels", [1, 4, 20])
def test_few_pixels_and_equal_lamps_are_no_crash(pixels: int) -> None:
    scene = ball(around(5, 40), size=24)
    mask = np.zeros_like(scene.mask)
    mask[12, 2 : 2 + pixels] = True
    usable = scene.usable & mask[..., None]
    equal = ball(np.tile(around(1, 30), (5, 1)), size=48)
    of_few = start_of_unknown_lamps(scene.samples, usable, mask, scene.views)
    for start, of in ((of_few, mask), (found(equal), equal.mask)):
        assert np.isfinite(start.normals[of]).all()
        assert start.undetermined
    assert "rank 1" in found(equal).undetermined[0]


def test_black_pixels_and_black_pictures_are_no_crash() -> None:
    scene = ball(around(8, 40, 10), size=48)
    scene.samples[2] = 0.0
    scene.samples[:, 20:24, 20:24] = 0.0
    start = found(scene)
    assert np.isfinite(start.normals[scene.mask]).all()
    assert scene.error(start.normals) < 3.0
    assert (start.strengths[2] == 0).all()
    assert "picture 3" in start.undetermined[-1]
