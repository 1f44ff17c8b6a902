"""Normals and lights that are given and contradict each other, or the pictures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pbrfit import Scene, decompose
from pbrfit.fit import given
from pbrfit.model.geometry import unit
from pbrfit.model.lamps import Lamps
from pbrfit.result.verdict import nothing_usable
from pbrfit.synthetic import make_scene
from planted_lamps import dome, far, planted, relief
from scene_files import truth_of

NEXT, REVERSED = "those of the next pictures", "those in reverse order"


def drawn(seed: int, *, known: bool) -> Scene:
    """Lamps in a ring or anywhere, a ball or a relief, 1 % noise."""
    rng = np.random.default_rng(seed)
    count, size = int(rng.integers(5, 13)), int(rng.choice([32, 48]))
    lamps = far(count, slant=float(rng.uniform(25, 50)), spread=0.0 if seed % 2 else 15.0)
    fov = 40.0 if seed % 3 == 0 else 0.0
    shape = relief(size, fov) if fov else dome(size)
    scene = planted(
        lamps, size=size, shape=shape, fov=fov, known=lamps, metal=seed % 4 == 0, ambient=0.1
    ).scene
    noisy = scene.images + rng.normal(0, 0.01 * scene.images.mean(), scene.images.shape)
    scene = replace(scene, images=noisy)
    return scene if known else without_normals(scene)


def without_normals(scene: Scene) -> Scene:
    unknown: Any = None
    return replace(scene, normals=unknown, normals_known=False)


def turned(scene: Scene, signs: tuple[float, float, float]) -> Scene:
    assert scene.lamps is not None
    return replace(scene, lamps=replace(scene.lamps, places=scene.lamps.places * signs))


def paired(scene: Scene, order: Any) -> Scene:
    assert scene.lamps is not None
    return replace(scene, lamps=replace(scene.lamps, places=scene.lamps.places[order]))


def with_normals_flipped(scene: Scene, signs: tuple[float, float, float]) -> Scene:
    return replace(
        scene, normals=np.where(scene.valid[..., None], scene.normals, (0, 0, 1)) * signs
    )


def said(scene: Scene) -> tuple[str, str] | None:
    one = given.contradiction(scene)
    return None if one is None else (one.what, one.remedy.split(" (")[0])


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5))]
)
def test_what_is_right_is_not_contradicted_and_what_is_wrong_is(seed: int, known: bool) -> None:
    scene = drawn(seed, known=known)
    assert scene.lamps is not None
    count = np.arange(len(scene.lamps))
    assert said(scene) is None
    for axes in ("X", "Y"):
        found = said(turned(scene, given.FLIPS[axes]))
        assert found is not None
        assert found[0] == "lamps"
        assert found[1] == f"the other sign of {axes}" or not known
    assert said(paired(scene, np.roll(count, 1))) == ("lamps", NEXT)
    if known:
        few = scene.of_pictures([0, 1, 2])
        assert said(few) is None
        assert said(turned(few, given.FLIPS["Y"])) == ("lamps", "the other sign of Y")
        assert said(paired(scene, count[::-1])) == ("lamps", REVERSED)
        assert said(turned(scene, given.FLIPS["X and Y"])) == ("lamps", "the other sign of X and Y")
        flipped = with_normals_flipped(scene, given.FLIPS["Y"])
        assert said(flipped) == ("normals", "the other sign of Y")


@pytest.mark.parametrize("kind", ["room", "spheres", "furnished", "detailed"])
def test_normals_are_those_of_a_surface_or_not(kind: str) -> None:
    scene = make_scene(kind, size=96, lights=2, held_out=1, seed=3)
    assert said(scene) is None
    for axes in ("X", "Y"):
        found = said(with_normals_flipped(scene, given.FLIPS[axes]))
        assert found is not None
        assert found[0] == "normals"


def test_normals_that_tell_nothing_are_not_contradicted() -> None:
    """Planes, whatever their normals, and noise."""
    scene = make_scene("room", size=48, lights=2, held_out=1, seed=3)
    plane = replace(scene, normals=np.broadcast_to((0.6, 0.0, 0.8), scene.normals.shape))
    assert said(plane) is None
    noise = unit(np.random.default_rng(2).normal(0, 0.3, scene.normals.shape) + np.array((0, 0, 1)))
    assert said(replace(scene, normals=noise)) is None


@pytest.mark.parametrize(("true", "told"), [(0.0, 40.0), (40.0, 0.0), (60.0, 30.0)])
def test_a_wrong_field_of_view_flips_no_normals(true: float, told: float) -> None:
    scene = planted(far(4), shape=relief(48, true), size=48, fov=true).scene
    assert said(replace(scene, fov=told)) is None


def test_near_lamps_that_are_flipped_are_named() -> None:
    truth = far(6)
    lamps = Lamps(truth.pictures, 1.5 * truth.places + np.array((0, 0, -2)), near=np.ones(6, bool))
    shape = relief(40, 40.0)
    scene = planted(
        replace(lamps, colors=truth.colors), shape=shape, fov=40.0, with_depth=True, known=lamps
    ).scene
    assert said(scene) is None
    assert said(turned(scene, given.FLIPS["Y"])) == ("lamps", "the other sign of Y")


@pytest.mark.parametrize("seed", [1, 2])
def test_far_lamps_that_are_turned_or_slanted_otherwise_are_named(seed: int) -> None:
    scene, angle = drawn(seed, known=True), np.radians(20)
    assert scene.lamps is not None
    about_z = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0]])
    for turn, known, remedy in (
        (np.vstack([about_z, (0, 0, 1)]), True, "lamps turned by -15 degrees about Z"),
        (np.diag([1.7, 1.7, 1.0]), True, "lamps 0.7 times as slanted"),
        (np.diag([0.5, 0.5, 1.0]), False, "lamps 1.5 times as slanted"),
        (np.vstack([about_z, (0, 0, 1)]), False, "lamps turned by -15 degrees about Z"),
    ):
        places = unit(scene.lamps.places @ turn)
        wrong = replace(scene, lamps=replace(scene.lamps, places=places))
        assert said(wrong if known else without_normals(wrong)) == ("lamps", remedy)


@pytest.mark.parametrize("kind", ["room", "furnished"])
@pytest.mark.parametrize("pictures", [2, 5])
def test_known_light_is_that_of_its_picture(kind: str, pictures: int) -> None:
    scene = make_scene(kind, size=48, lights=pictures, held_out=1, noise=0.01, seed=pictures)
    light = truth_of(scene).lighting
    assert light is not None
    assert said(replace(scene, lighting=light)) is None
    assert said(replace(scene, lighting=np.roll(light, 1, axis=0))) == ("lights", NEXT)
    of_y = np.where(np.isin(np.arange(16), [1, 4, 5, 9, 10, 11]), -1.0, 1.0)[:, None]
    found = said(replace(scene, lighting=light * of_y))
    assert found == ("lights", "the other sign of Y")
    for times in (0.5, 2.0) if pictures > 2 else ():  # two pictures leave too little
        found = said(replace(scene, lighting=times * light))
        assert found == ("lights", f"lights {1 / times:g} times as bright")


@pytest.mark.parametrize(("share", "contradicted"), [(0.4, False), (0.6, True)])
def test_most_normals_face_the_camera(share: float, contradicted: bool) -> None:
    scene = make_scene("room", size=24, lights=2, held_out=1, seed=3)
    away = np.arange(24)[:, None, None] < 24 * share
    found = said(replace(scene, normals=np.where(away, -scene.normals, scene.normals)))
    assert (found == ("normals", "the other sign of Z, which points to the viewer")) == contradicted


def test_differences_count_from_three_standard_errors_on() -> None:
    ones = np.array([-1.0, 1.0] * 50)
    error = ones.std(ddof=1) / 10
    assert not given._is_surely_positive(ones + 2.99 * error)
    assert given._is_surely_positive(np.append(ones + 3.01 * error, np.nan))
    assert not given._is_surely_positive(np.array([5.0]))


def test_lamps_have_to_lower_what_is_left_by_more_than_fits_differ() -> None:
    left, noise = np.full(64, 0.1), np.linspace(-1e-4, 1e-4, 64)
    assert not given._is_lower((1 - 0.9 * given.GAIN_MIN) * left + noise, left)
    assert given._is_lower((1 - 1.1 * given.GAIN_MIN) * left + noise, left)
    assert given._is_lower(0.9 * (uneven := np.exp(np.linspace(-16, 16, 64))), uneven)


def test_nothing_is_usable_that_follows_from_contradicted_lamps(
    caplog: pytest.LogCaptureFixture,
) -> None:
    scene = drawn(1, known=True)
    found = decompose(turned(scene, given.FLIPS["Y"]), light="lamps")
    assert found.uncertainty is not None
    assert nothing_usable(found.uncertainty.verdicts)
    for one in found.uncertainty.verdicts.values():
        assert one.cause.startswith("Y of the lamps looks flipped: with the other sign, ")
        assert one.remedy == "the other sign of Y would help"
    assert "Y of the lamps looks flipped" in found.assumed["lamps"]
    assert sum("Y of the lamps looks flipped" in one for one in caplog.messages) == 1


@pytest.mark.parametrize("seed", range(4))
def test_mirrored_segments_and_depth_of_another_view_are_named(seed: int) -> None:
    kind = ("room", "spheres")[seed % 2]
    scene = replace(make_scene(kind, size=48, lights=6, seed=seed, noise=0.01), lighting=None)
    assert scene.segments is not None
    assert said(scene) is None
    for axes in given.MIRRORED.values():
        mirrored = replace(scene, segments=np.flip(scene.segments, axes))
        assert said(mirrored) == ("segments", "the segments of this picture")
    x = np.linspace(0, 1, 48)
    assert said(replace(scene, depth=np.broadcast_to(1 + 40 * x, (48, 48)))) == (
        "depth", "depth and normals of one view",
    )  # fmt: skip
