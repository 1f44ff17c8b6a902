"""`pbrfit evaluate uncertainty`: scenes are what they say, bars can fail on both sides, files.

How well posteriors are calibrated is not tested here: figures are of records made by hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from evaluation_tasks import recorded
from pbrfit.model.geometry import angles_between
from pbrfit.result.verdict import PARAMETERS, ROUGH_ERROR, USABLE_ERROR, deserved
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.grid import NOISE, Case
from pbrfit_evaluation.suite import Results
from pbrfit_evaluation.uncertainty import figures
from pbrfit_evaluation.uncertainty.figures import (
    ABOVE_GUESS,
    COVERED,
    UNDETERMINED_WRONG,
    USABLE_RIGHT,
)
from pbrfit_evaluation.uncertainty.measure import CONDITIONS, calibration, made
from scene_files import truth_of

SEED = 7


def scene(name: str, size: int = 16) -> Scene:
    return made(name, "furnished", SEED, size, "paper", 1)


@pytest.fixture(scope="module")
def clean() -> Scene:
    return scene("clean")


def test_a_scene_is_the_same_each_time() -> None:
    np.testing.assert_array_equal(scene("jpeg").images, scene("jpeg").images)


@pytest.mark.parametrize("name", CONDITIONS)
def test_scenes_have_true_materials(name: str, clean: Scene) -> None:
    first = scene(name)
    assert first.images.dtype == np.float32
    assert first.depth is None
    found, true = truth_of(first).materials, truth_of(clean).materials
    np.testing.assert_array_equal(found.roughness, true.roughness)
    if name == "grey":
        assert np.ptp(found.albedo, axis=-1).max() == 0
    else:
        np.testing.assert_array_equal(found.albedo, true.albedo)
    if name not in ("png", "jpeg", "three"):
        assert first.images.mean() == pytest.approx(0.4, rel=0.01)


def test_what_is_told_wrong(clean: Scene) -> None:
    noisy = scene("noise")
    assert (noisy.images - clean.images).std() == pytest.approx(NOISE, rel=0.03)
    told = scene("fov-90")
    assert (told.fov, clean.fov) == (90, 60)
    np.testing.assert_array_equal(told.images, clean.images)
    off: dict[str, float] = {"normals-3": 3, "normals-5": 5}
    for name, degrees in off.items():
        wrong = scene(name)
        angles = angles_between(wrong.normals, clean.normals)
        assert angles.mean() == pytest.approx(degrees, rel=0.2)  # of few patches
        np.testing.assert_array_equal(wrong.images, noisy.images)
    other = scene("other-model")
    assert (clean.model, other.model) == ("paper", "principled")
    assert np.abs(other.images - clean.images).max() > 0.01
    assert len(scene("three").images) == 3


def planted(scale: float, count: int = 20_000) -> Mapping[str, Any]:
    """Calibration of Gaussian errors so many times as large as is said."""
    rng = np.random.default_rng(1)
    deviation = 10 ** rng.uniform(-3, -1, count)
    true = np.full(count, 0.5)
    found = true + scale * deviation * rng.standard_normal(count)
    low, high = found - 1.96 * deviation, found + 1.96 * deviation
    return calibration(found, true, deviation, low, high)


def test_rounding_is_no_error_and_what_is_said_to_be_exact_must_be() -> None:
    zero = np.zeros(4)
    found = np.array([0.5, 0.5 + 1e-7, 0.6, 0.5])
    of = calibration(found, np.full(4, 0.5), zero, found, found)
    assert of["within_1"] == of["within_2"] == of["in_interval"] == 0.75


def record(
    within_2: float = 0.95,
    rmse: float = 0.05,
    guess: float = 0.3,
    said: str | None = None,
) -> dict[str, Any]:
    """What a scene may have, alike in all maps; its verdicts are right unless another is given."""
    one = {
        **planted(1.0, 1000),
        "within_2": within_2,
        "rmse": rmse,
        "guess": guess,
        "expected_error": rmse,
        "cause": "",
    }
    maps = {
        name: {**one, "said": said or deserved(name, rmse), "deserved": deserved(name, rmse)}
        for name in PARAMETERS
    }
    return {"said": maps, "scores": {"seconds": 1.0}}


def results(*values: Mapping[str, Any] | str, name: str = "noise") -> Results[Case]:
    """A row of these scenes."""
    pairs = ((Case(name, "default", i, 8), one) for i, one in enumerate(values))
    return recorded(*pairs, conditions=[name])


def missed(*values: Mapping[str, Any]) -> list[str]:
    """What does not hold of such scenes."""
    found = results(*values)
    bars = figures.verdicts(found, figures.rows(found))
    return [
        one.what.removeprefix(f"{CONDITIONS['noise'].title}: ") for one in bars if not one.holds
    ]


COVERAGE = "share of errors within two deviations, "
NOT_DETERMINED = record(rmse=min(ROUGH_ERROR.values()), said="not determined")


@pytest.mark.parametrize(
    ("scenes", "expected"),
    [
        ([record(COVERED[0]), record(COVERED[1])], []),
        ([record(COVERED[0] - 0.001)], [f"{COVERAGE}least"]),
        ([record(COVERED[1] + 0.001)], [f"{COVERAGE}largest"]),
        ([record(guess=0.05 / (ABOVE_GUESS - 0.001))], []),
        ([record(guess=0.05 / (ABOVE_GUESS + 0.001))], ["error over the constant guess's"]),
        ([record(rmse=2 * USABLE_ERROR["albedo"], said="usable")] + 19 * [record()], []),
        (
            [record(rmse=2 * USABLE_ERROR["albedo"], said="usable")] + 18 * [record()],
            ["share of maps called “usable” and right"],
        ),
        ([NOT_DETERMINED] + 9 * [record(rmse=0.29)], []),
        (
            [NOT_DETERMINED] + 8 * [record(rmse=0.29)],
            ["share of maps called “not determined” and wrong"],
        ),
    ],
)
def test_demands_hold_up_to_their_bounds(scenes: Any, expected: list[str]) -> None:
    assert (USABLE_RIGHT, UNDETERMINED_WRONG) == (0.95, 0.1)
    assert missed(*scenes) == expected


def test_verdicts_are_counted_by_what_was_said_and_what_is_true() -> None:
    found = results(record(), record(rmse=0.29), record(rmse=0.05, said="not determined"))
    np.testing.assert_array_equal(figures.confusion(found), [[3, 0, 0], [0, 0, 0], [3, 0, 3]])
