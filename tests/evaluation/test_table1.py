"""The Table 1 suite: what fits are given, and its rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from evaluation_tasks import recorded
from pbrfit.model.reflection import DEFAULT_MODEL, MODELS
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.scores import SCORES
from pbrfit_evaluation.table1 import measure
from pbrfit_evaluation.table1.figures import rows
from pbrfit_evaluation.table1.measure import ROWS, Case
from scene_files import known


def case(row: str, way: str = "default", seed: int = 1001, **more: Any) -> Case:
    return Case(
        row, way, seed, **{"size": 16, "model": DEFAULT_MODEL, "lights": 4, "iterations": 2} | more
    )


def given(row: str, **more: Any) -> Scene:
    """What a fit is given of a row's scene."""
    of = case(row, **more)
    return measure.as_given(measure.room(of, 1), of)


@pytest.mark.parametrize("key", ["base", "fov90", "normals", "normals-refined", "detailed"])
def test_a_scene_is_told_what_its_row_says_and_nothing_else(key: str) -> None:
    row, scene = ROWS[key], given(key)
    truth = make_scene(row.scene, size=16, lights=4, held_out=4, seed=1001)
    np.testing.assert_array_equal(scene.images, truth.images)
    assert scene.fov == row.fov
    assert scene.model == DEFAULT_MODEL
    assert np.array_equal(scene.normals, truth.normals) == (row.normals == "true")


def test_our_renderer_uses_the_model_that_is_fitted_but_in_one_row() -> None:
    swapped = [key for key, row in ROWS.items() if row.swapped]
    assert swapped == ["other-model"]
    [other] = swapped
    for model in MODELS:
        own, apart = (given(key, model=model) for key in ("base", other))
        assert own.model == model
        assert apart.model != model
        assert apart.model in MODELS
        np.testing.assert_array_equal(own.normals, apart.normals)


def test_rows_have_the_papers_figures_and_say_why_some_were_not_run() -> None:
    pairs: list[tuple[Case, Any]] = []
    for way in ROWS["base"].ways:
        pairs.append(
            (case("base", way, 1000, model="paper"), {"scores": dict.fromkeys(SCORES, 0.25)})
        )
        pairs.append((case("base", way, 1001, model="paper"), "ValueError: no"))
    asked = {"conditions": ["base", "cycles-brdf"], "model": "paper", "quick": True}
    found = rows(recorded(*pairs, **asked))
    assert {row.status for row in found[:3]} == {"1 of 2 scenes failed"}
    assert known(found[0].paper)["albedo"] == 0.065
    assert [row.guess for row in found] == [False, False, True] * 2
    assert found[-1].status == "not run: --quick leaves out what takes minutes"
