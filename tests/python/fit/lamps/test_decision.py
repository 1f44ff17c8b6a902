"""What is decided about the light of a scene, and what a result says about it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pbrfit import Objective, Result, Scene, decompose
from pbrfit.fit import settings
from pbrfit.fit.lamps import decision
from pbrfit.fit.transport import find_lights
from pbrfit.result.refinement import FROM_PICTURES
from pbrfit.synthetic import make_scene
from planted_lamps import far, planted, setup

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
    monkeypatch.setattr(decision, "light_share", lambda *_: 1.0)
    black = room.images.copy()
    black[:, :8] = 0
    weights = np.ones(room.images.shape[:3], np.float32)
    weights[:, 8:12] = 0
    result = decompose(
        Scene(images=black, normals=room.normals, mask=room.mask, weights=weights, fov=room.fov),
        **FEW,
    )
    assert result.lamps is not None or "of left-out pixels lamps leave" in said(result)[0]


PAIRS = np.arange(4000) ^ 1


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2, 0.4, 1.0])
def test_the_share_of_light_is_what_alike_pixels_have_in_common(share: float) -> None:
    """Of squares before the channels' mean, which leaves a third of those of noise."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(4000, 8, 3))
    of_light = rng.normal(size=(2000, 8, 1)).repeat(2, axis=0)
    found = decision.light_share(np.sqrt(1 - share) * noise + np.sqrt(share) * of_light, PAIRS)
    common = share / (share + (1 - share) / 3)
    assert share <= found + 0.02
    most = min(1, (common + 2 * np.sqrt(1 / 8 / 4000)) / decision.PAIRS_IN_COMMON)
    assert found == pytest.approx(most / (3 - 2 * most), abs=0.06)


def test_nothing_in_common_is_no_share() -> None:
    opposite = np.ones((4000, 8, 3))
    opposite[1::2] = -1
    assert decision.light_share(opposite, PAIRS) == 0
    assert decision.light_share(np.ones((4000, 8, 3)), PAIRS) == 1
    assert decision.light_share(np.zeros((4000, 8, 3)), PAIRS) == 0


LEAST_GAIN = 1 - np.exp(-settings.TRANSPORT_GAIN_MIN)


@pytest.mark.parametrize(
    ("left", "share", "tried"),
    [
        (0.1, LEAST_GAIN - 0.001, False),
        (0.1, LEAST_GAIN + 0.001, True),
        (0.03, (0.02 / 0.03) ** 2 - 0.001, False),
        (0.03, (0.02 / 0.03) ** 2 + 0.001, True),
        (0.0199, 1.0, False),
        (0.0201, 1.0, True),
    ],
)
def test_lamps_are_tried_where_another_light_could_be_clearly_better(
    room: Scene, monkeypatch: pytest.MonkeyPatch, left: float, share: float, tried: bool
) -> None:
    scores = np.full(288, 2 * np.log(left))
    by_harmonics = decision._Left(scores, np.arange(576), np.ones((288, 4, 3)))
    monkeypatch.setattr(decision, "_left_by_harmonics", lambda *_: by_harmonics)
    monkeypatch.setattr(decision, "light_share", lambda *_: share)
    monkeypatch.setattr(decision, "_left_by_lamps", lambda *_: scores - 1)
    choice = decision.choose(room, setup(light="auto"))
    assert choice.lamps == tried
    assert ("left_out_lamps" in choice.figures) == tried
    assert tried or choice.why.startswith("light from all around leaves ")
    assert ("mostly noise" in choice.why) == (not tried and share < 1)


def test_in_one_channel_noise_cannot_be_told(room: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = np.full(288, 2 * np.log(0.1))
    by_harmonics = decision._Left(scores, np.arange(576), np.zeros((288, 4, 1)))
    monkeypatch.setattr(decision, "_left_by_harmonics", lambda *_: by_harmonics)
    monkeypatch.setattr(decision, "_left_by_lamps", lambda *_: scores)
    assert "left_out_lamps" in decision.choose(room, setup(light="auto")).figures


def test_lamps_are_not_tried_on_noise() -> None:
    noisy = make_scene("furnished", size=24, lights=8, seed=0, noise=0.03)
    choice = decision.choose(noisy, setup(light="auto"))
    assert choice.why.endswith("of left-out pixels, mostly noise")
    assert choice.figures["left_out_light"] < LEAST_GAIN


@pytest.mark.slow
def test_lamps_are_tried_on_lamps_in_noise() -> None:
    scene = planted(far(8), size=32).scene
    sigma = 0.03 * float(scene.images[:, scene.valid].mean()) / 0.4
    noise = sigma * np.random.default_rng(0).normal(size=scene.images.shape)
    images = np.maximum(scene.images + noise, 0).astype(np.float32)
    choice = decision.choose(replace(scene, images=images), setup(light="auto"))
    assert choice.lamps
    assert choice.figures["left_out_light"] > 2 * LEAST_GAIN


@pytest.mark.parametrize(("enough", "rounds"), [(True, 1), (False, 3)])
def test_rounds_end_where_little_enough_is_left(room: Scene, enough: bool, rounds: int) -> None:
    looks = []

    def is_enough() -> bool:
        looks.append(enough)
        return enough

    objective = Objective(room)
    find_lights(objective, objective.start(), lambda: False, is_enough=is_enough)
    assert len(looks) == rounds == (1 if enough else settings.TRANSPORT_ROUNDS - 1)


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
