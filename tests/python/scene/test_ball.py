"""Balls: where they are in the picture, and the lamps that they show."""

from __future__ import annotations

import functools
import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from balls import ALBEDO, COLOR, ball_pictures, far_lamps
from pbrfit import InputError
from pbrfit.model.geometry import angles_between, view_directions
from pbrfit.scene.ball import (
    KINDS,
    Ball,
    BallKind,
    BallLights,
    checked_ball,
    find_ball,
    lights_of_balls,
    sphere_normals,
)

SIZE = (120, 160)
BALL = Ball(95.3, 52.8, 30.4)
LAMPS = far_lamps(5)
NAMES = tuple("abcde")


@functools.cache
def pictures(kind: BallKind, fov: float) -> NDArray[np.float32]:
    made = ball_pictures(kind, BALL, SIZE, fov, LAMPS)
    made.setflags(write=False)
    return made


def lights(images: NDArray[Any], *balls: Ball, fov: float = 40.0, **options: Any) -> BallLights:
    return lights_of_balls(images, options.pop("limits", None), NAMES, balls, fov, **options)


def test_in_perspective_normals_are_those_of_a_sphere_in_space() -> None:
    """Whose outline is an ellipse."""
    fov, centre, radius = 40.0, np.array([1.2, 0.6, -6.0]), 0.8
    rays = -view_directions(*SIZE, fov)
    along = rays @ centre
    reach = along**2 - centre @ centre + radius**2
    hit = reach >= 0
    rows, columns = np.nonzero(hit)
    ball = Ball(columns.mean(), rows.mean(), np.sqrt(hit.sum() / np.pi))
    points = rays[hit] * (along[hit] - np.sqrt(reach[hit]))[:, None]
    true = (points - centre) / radius
    normals, _ = sphere_normals(ball, SIZE, fov, columns, rows)
    off = angles_between(normals, true)
    inner = true @ -centre / np.linalg.norm(centre) > 0.4
    assert np.nanmedian(off) < 0.5
    assert off[inner].max() < 3


@pytest.mark.parametrize("fov", [0.0, 40.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_ball_is_found_to_half_a_pixel(kind: BallKind, fov: float) -> None:
    found = find_ball(pictures(kind, fov))
    off = [found.x - BALL.x, found.y - BALL.y, found.radius - BALL.radius]
    assert np.abs(off).max() < 0.5


def test_in_large_pictures_it_is_found_at_full_size() -> None:
    ball = Ball(200.2, 90.7, 60.3)
    images = ball_pictures("matt", ball, (180, 360), 40.0, LAMPS[:2])
    found = find_ball(images)
    off = [found.x - ball.x, found.y - ball.y, found.radius - ball.radius]
    assert np.abs(off).max() < 0.5


@pytest.mark.parametrize("what", ["nothing", "noise", "square"])
def test_what_is_no_ball_is_not_found(what: str) -> None:
    images = np.zeros((3, *SIZE, 3), np.float32)
    if what == "noise":
        images += np.random.default_rng(0).random(images.shape, dtype=np.float32)
    elif what == "square":
        images[:, 30:80, 40:90] = 1
    with pytest.raises(InputError, match=r"ball: expected a circle .*--circle X,Y,R says where"):
        find_ball(images)


@pytest.mark.parametrize(
    ("circle", "message"),
    [
        ((10.0, 10.0, 3.9), "circle: expected a radius of 4 pixels or more, found 3.9"),
        ((160.0, 10.0, 9.0), "circle: expected a centre within 160 × 120 pixels, found 160,10"),
        ((0.0, -1.0, 9.0), "circle: expected a centre within"),
        ((float("nan"), 1.0, 9.0), "circle: expected a centre within"),
        ((1.0, 1.0, float("nan")), "circle: expected a radius"),
    ],
)
def test_circles_beyond_the_picture_are_refused(circle: Any, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        checked_ball(circle[0], circle[1], circle[2], SIZE)


@pytest.mark.parametrize("fov", [0.0, 40.0])
@pytest.mark.parametrize(("kind", "most"), [("mirror", 2.0), ("matt", 0.3)])
def test_directions_of_lamps(kind: BallKind, most: float, fov: float) -> None:
    found = lights(pictures(kind, fov), BALL, fov=fov)
    assert found.kind == kind
    off = angles_between(found.directions, LAMPS)
    assert off.max() < most
    assert (off < 2 * found.degrees + 0.1).all()
    assert found.degrees.max() < 3
    np.testing.assert_allclose(np.linalg.norm(found.directions, axis=-1), 1)


def test_the_colour_of_a_matt_ball_s_lamp_times_its_albedo() -> None:
    found = lights(pictures("matt", 40.0), BALL)
    np.testing.assert_allclose(found.colors, np.tile(ALBEDO * COLOR, (5, 1)), rtol=0.02)
    assert found.residuals.max() < 0.03
    mirror = lights(pictures("mirror", 40.0), BALL)
    assert np.isnan(mirror.colors).all()
    assert np.isnan(mirror.residuals).all()


def test_a_lamp_behind_a_mirror_ball_is_seen_at_its_rim() -> None:
    lamps = far_lamps(3, seed=2)
    lamps[:, 2] = [-0.3, -0.5, 0.2]
    lamps /= np.linalg.norm(lamps, axis=-1, keepdims=True)
    images = ball_pictures("mirror", BALL, SIZE, 0.0, lamps)
    found = lights_of_balls(images, None, NAMES[:3], [BALL], 0.0, "mirror")
    assert angles_between(found.directions, lamps).max() < 6
    assert found.degrees.min() > 1


def test_an_attached_shadow_tells_nothing_and_a_clipped_side_neither() -> None:
    lamp = np.array([[0.9, 0.1, 0.42]])
    lamp /= np.linalg.norm(lamp)
    images = ball_pictures("matt", BALL, SIZE, 0.0, lamp)
    limits = np.where(images > 0.35, 1, 0).astype(np.uint8)
    clipped = np.minimum(images, 0.35)
    free = lights_of_balls(clipped, limits, ("a",), [BALL], 0.0, "matt")
    assert angles_between(free.directions, lamp).max() < 0.5
    taken = lights_of_balls(clipped, None, ("a",), [BALL], 0.0, "matt")
    assert angles_between(taken.directions, lamp).max() > 3
    assert taken.degrees[0] > free.degrees[0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_picture_in_which_a_ball_shows_no_lamp_is_named(kind: BallKind) -> None:
    images = pictures(kind, 40.0).copy()
    images[2] = 0
    with pytest.raises(InputError, match=r"ball: expected a .* in every picture, found none in c"):
        lights(images, BALL, kind=kind)
