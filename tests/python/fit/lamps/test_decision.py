"""What is decided about the light of a scene, and what a result says about it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pbrfit import Result, Scene, decompose
from pbrfit.result.refinement import FROM_PICTURES
from pbrfit.synthetic import make_scene
from planted_lamps import far, without_colors

FEW: dict[str, Any] = {"iterations": 3, "uncertainty": False}


@pytest.fixture(scope="module")
def room() -> Scene:
    made = make_scene("furnished", size=24, lights=4, seed=3)
    return Scene(images=made.images, normals=made.normals, mask=made.mask, fov=made.fov)


def said(result: Result) -> list[str]:
    return [line for line in result.left_out if line.startswith("lamps: ")]


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"light": "sh"}, "not asked for"),
        ({"mono_light": True}, "not asked for"),
        ({}, "light from all around explains the pictures"),
    ],
)
def test_what_is_asked_for_decides(room: Scene, options: dict[str, Any], why: str) -> None:
    result = decompose(room, **FEW, **options)
    assert said(result) == [f"lamps: {why}"]
    assert result.lamps is None


@pytest.mark.parametrize(("pixels", "pictures"), [(31, 4), (500, 3), (500, 2)])
def test_few_pixels_or_pictures_decide_nothing(room: Scene, pixels: int, pictures: int) -> None:
    mask = np.zeros_like(room.valid)
    mask.ravel()[np.flatnonzero(room.valid)[:pixels]] = True
    few = Scene(images=room.images[:pictures], normals=room.normals, mask=mask, fov=room.fov)
    found = decompose(few, **FEW)
    assert found.held_out is None
    assert said(found) == ["lamps: not compared with light from all around"]
    lamps = decompose(replace(few, lamps=without_colors(far(pictures))), **FEW).lamps
    assert (lamps is None) == (pictures == 2)


@pytest.mark.parametrize("light", ["sh", "lamps"])
def test_normals_that_nobody_gave_are_said_to_be_of_the_pictures(room: Scene, light: str) -> None:
    untold = Scene(images=room.images[:3], mask=room.mask, fov=room.fov)
    result = decompose(untold, light=light, refine_normals="off", **FEW)
    assert result.refinement.in_words().startswith(FROM_PICTURES)
    assert "as given" not in result.refinement.in_words()
    assert (result.lamps is None) == (light == "sh")
    assert said(result) == (["lamps: not asked for"] if light == "sh" else [])
