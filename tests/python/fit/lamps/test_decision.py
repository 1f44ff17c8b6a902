"""What is decided about the light of a scene, and what a result says about it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pbrfit import Result, Scene, decompose
from pbrfit.fit.lamps import decision
from pbrfit.result.refinement import FROM_PICTURES
from pbrfit.synthetic import make_scene

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
        ({"mono_light": True}, "one light for all channels was asked for"),
    ],
)
def test_what_is_asked_for_decides(room: Scene, options: dict[str, Any], why: str) -> None:
    result = decompose(room, **FEW, **options)
    assert said(result) == [f"lamps: {why}"]
    assert result.lamps is None


def test_few_pixels_decide_nothing(room: Scene) -> None:
    rows, columns = np.nonzero(room.valid)
    mask = np.zeros_like(room.valid)
    mask[rows[:31], columns[:31]] = True
    few = Scene(images=room.images, normals=room.normals, mask=mask, fov=room.fov)
    assert said(decompose(few, **FEW)) == ["lamps: too few pixels"]


def test_pixels_that_show_nothing_have_no_say(room: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decision, "HARMONICS_LEFT_MIN", 0.0)
    black = room.images.copy()
    black[:, :8] = 0
    weights = np.ones(room.images.shape[:3], np.float32)
    weights[:, 8:12] = 0
    result = decompose(
        Scene(images=black, normals=room.normals, mask=room.mask, weights=weights, fov=room.fov),
        **FEW,
    )
    assert result.lamps is not None or "of left-out pixels lamps leave" in said(result)[0]


def test_two_pictures_decide_nothing(room: Scene) -> None:
    two = Scene(images=room.images[:2], normals=room.normals, mask=room.mask, fov=room.fov)
    assert said(decompose(two, **FEW)) == ["lamps: fewer than 3 pictures"]


@pytest.mark.parametrize("light", ["sh", "lamps"])
def test_normals_that_nobody_gave_are_said_to_be_of_the_pictures(room: Scene, light: str) -> None:
    untold = Scene(images=room.images, mask=room.mask, fov=room.fov)
    result = decompose(untold, light=light, refine_normals="off", **FEW)
    assert result.refinement.in_words().startswith(FROM_PICTURES)
    assert "as given" not in result.refinement.in_words()
    assert (result.lamps is None) == (light == "sh")
    assert said(result) == (["lamps: not asked for"] if light == "sh" else [])
