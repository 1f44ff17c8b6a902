"""The review of generated pictures: what it measures, what it refuses, what it lets pass."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numpy as np
import pytest

from pbrfit import InputError
from pbrfit.acquire.review import LOG_CHANGE_MIN, Reviewer, illumination
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array
from pbrfit_evaluation.review.pictures import camera, damaged, relights

SIZE, COUNT = 256, 9


@cache
def view() -> Scene:
    return relights("furnished", "own", 2020, size=SIZE, count=COUNT)


@cache
def pictures() -> tuple[Array, ...]:
    return tuple(camera(picture) for picture in view().images)


@cache
def reviewer() -> Reviewer:
    return Reviewer(pictures()[0])


def failed(verdict: Any) -> set[str]:
    return {check.name for check in verdict.checks if not check.passed}


def test_honest_relights_are_accepted() -> None:
    for picture in pictures()[1:]:
        verdict = reviewer().picture(picture)
        assert verdict.accepted, verdict.reason
        assert verdict.reason == ""
    for verdict in reviewer().together(pictures()[1:]):
        assert verdict.accepted, verdict.reason
        assert [check.name for check in verdict.checks][-2:] == ["colour", "content"]


@pytest.mark.parametrize("gamma", [1.0, 0.8])
def test_the_photograph_with_another_tone_curve_is_a_copy(gamma: float) -> None:
    toned = 0.7 * pictures()[0] ** gamma * np.array([1.1, 1.0, 0.8])
    verdict = reviewer().picture(camera(toned))
    assert failed(verdict) == {"copy"}
    (check,) = [check for check in verdict.checks if check.name == "copy"]
    assert check.value < LOG_CHANGE_MIN
    assert "tone curve" in verdict.reason


@pytest.mark.parametrize(("gain", "word"), [(1e-3, "black"), (200.0, "clipped")])
def test_pictures_of_nothing_are_refused(gain: float, word: str) -> None:
    verdict = reviewer().picture(camera(gain * view().images[1]))
    assert failed(verdict) == {"exposure"}
    assert word in verdict.reason


def test_another_view_is_refused() -> None:
    other = relights("furnished", "own", 2021, size=SIZE, count=2).images[1]
    for wrong in (camera(other), pictures()[1][:, ::-1]):
        assert "edges" in failed(reviewer().picture(wrong))


def test_a_shift_of_two_pixels_is_refused_and_told() -> None:
    wrong = np.roll(pictures()[1], (0, 2), axis=(0, 1))
    verdict = reviewer().picture(wrong)
    assert "shift" in failed(verdict)
    assert "shifted by 2.0 pixels (+2.0, " in verdict.reason
    assert "from the photograph" in verdict.reason


def repainted(image: Array, kind: str) -> Array:
    """A tenth of the picture, where it has much detail, with something else in it."""
    changed = image.copy()
    part = np.s_[100:180, 80:160]
    if kind == "blue":
        changed[part] *= (0.5, 0.8, 1.6)
    elif kind == "removed":
        changed[part] = image[part].mean(axis=(0, 1))
    elif kind == "upside down":
        changed[part] = image[part][::-1, ::-1]
    return changed


@pytest.mark.parametrize(
    "kind",
    ["blue", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("removed", "upside down"))],
)
def test_repaints_are_found_and_told_and_the_others_stay(kind: str) -> None:
    members = list(pictures()[1:])
    members[3] = camera(repainted(view().images[4], kind))
    together = reviewer().together(members)
    assert [not verdict.accepted for verdict in together] == [i == 3 for i in range(8)]
    assert failed(together[3]) <= {"colour", "content", "warp"}
    told = re.search(r"around x = (\d+), y = (\d+)", together[3].reason)
    assert told is not None
    x, y = map(int, told.groups())
    assert 70 <= x <= 170, together[3].reason
    assert 90 <= y <= 190, together[3].reason


def test_a_bend_is_found() -> None:
    rng = np.random.default_rng(7)
    members = list(pictures()[1:])
    members[3] = camera(damaged(view().images[4], "warp", view().segments, rng)[0])
    verdicts = [reviewer().picture(members[3]), reviewer().together(members)[3]]
    assert any("warp" in failed(verdict) for verdict in verdicts)


def test_too_few_pictures_are_not_judged_together() -> None:
    assert illumination.FEWEST == 4
    assert [v.checks for v in reviewer().together(pictures()[1:3])] == [(), ()]
    assert reviewer().together([]) == []
    assert all(v.checks for v in reviewer().together(pictures()[1:4]))


@pytest.mark.slow
def test_what_the_mask_leaves_out_is_not_reviewed() -> None:
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, : SIZE // 2] = False
    masked = Reviewer(pictures()[0], mask=mask)
    members = [picture.copy() for picture in pictures()[1:]]
    members[0][:, : SIZE // 2 - 8] = members[0][::-1, : SIZE // 2 - 8, ::-1]
    assert not reviewer().together(members)[0].accepted
    assert masked.picture(members[0]).accepted
    assert all(verdict.accepted for verdict in masked.together(members))


def test_large_pictures_are_judged_at_a_size_of_their_own() -> None:
    def enlarged(picture: Array) -> Array:
        return np.asarray(np.kron(picture, np.ones((3, 3, 1))), np.float64)

    large = Reviewer(enlarged(pictures()[0]))
    assert large.picture(enlarged(pictures()[1])).accepted
    moved = np.roll(enlarged(pictures()[1]), (6, 0), axis=(0, 1))
    assert "(+0.0, +6.0)" in large.picture(moved).reason.replace("-0.0", "+0.0")


def test_unusable_photographs_and_pictures_are_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="photo: expected something with edges"):
        Reviewer(np.full((80, 80, 3), 0.3))
    with pytest.raises(InputError, match=r"the photograph's shape .*, found \(80, 80, 3\)"):
        reviewer().picture(np.zeros((80, 80, 3)))
