"""Scenes × conditions × ways: cases, rows, bars and sheets that suites share."""

from __future__ import annotations

import io
import math
from argparse import Namespace
from typing import Any

import pytest
from PIL import Image

from evaluation_tasks import recorded
from pbrfit.synthetic import make_scene
from pbrfit_evaluation import recipes
from pbrfit_evaluation.grid import Case, Grid, measured
from pbrfit_evaluation.grid.figures import Bar, grid_rows, of_bars, pictures
from pbrfit_evaluation.suite import csv_files

WAYS = {"fit": recipes.Way("a fit"), "guess": recipes.GUESS}
GRID = Grid(
    {"plain": "as it is", "dark": "in the dark", "odd": "odd"},
    WAYS,
    brings={"dark": ["plain"]},
    of_condition={"odd": ["fit"]},
    kinds=("room", "spheres"),
    pictured=("fit",),
    why_not=lambda options, condition, _: options.lost if condition == "odd" else "",
)


def asked(**options: Any) -> Namespace:
    given = {"conditions": ["dark", "odd"], "ways": list(WAYS), "lost": "", "first_seed": 5}
    return Namespace(**{**given, "scenes": 2, "size": 8, **options})


def test_cases_are_those_asked_for_and_what_they_are_compared_with() -> None:
    found = [(case.condition, case.way, case.seed, case.kind) for case in GRID.cases(asked())]
    assert found[:2] == [("plain", "fit", 5, "room"), ("plain", "fit", 6, "spheres")]
    assert [one[:2] for one in found[::2]] == [
        *(("plain", "fit"), ("dark", "fit"), ("odd", "fit"), ("plain", "guess"), ("dark", "guess"))
    ]
    pictured = {(c.way, c.seed) for c in GRID.cases(asked()) if c.picture}
    assert pictured == {("fit", 5)}
    assert len({case.key for case in GRID.cases(asked(model="both"))}) == 20
    assert {c.way for c in GRID.cases(asked(ways=["guess"]))} == {"guess"}
    assert not [c for c in GRID.cases(asked(lost="nowhere")) if c.condition == "odd"]


def scored(condition: str, way: str, seed: int, error: float | str) -> tuple[Case, Any]:
    case = Case(condition, way, seed, 8)
    return case, error if isinstance(error, str) else {"scores": {"albedo": error, "recon": 1.0}}


def test_rows_say_what_failed_and_what_was_not_run() -> None:
    pairs = [scored("plain", "fit", 5, 0.25), scored("plain", "fit", 6, "OSError: full")]
    found = grid_rows(GRID, recorded(*pairs, **vars(asked(lost="nowhere"))), ["albedo"])
    assert [(row.name, row.solver) for row in found[::2]] == [
        *(("as it is", "a fit"), ("in the dark", "a fit"), ("odd", "a fit"))
    ]
    assert (found[0].metrics["albedo"], found[0].status) == (0.25, "1 of 2 scenes failed")
    assert (found[-1].metrics, found[-1].status) == ({}, "not run: nowhere")
    assert [row.guess for row in found[:2]] == [False, True]


def test_bars_are_between_means_of_scenes_that_both_have() -> None:
    pairs = [scored("plain", "fit", 5, 0.1), scored("plain", "fit", 6, 0.3)]
    results = recorded(*pairs, scored("plain", "guess", 5, 0.2), scored("dark", "fit", 5, "no"))

    def judged(of: str, over: tuple[str, str] | None, most: float) -> Any:
        bar = Bar("it", (of, "fit"), over, ["albedo", "recon"], most)
        return list(of_bars(results, [bar]))

    [ratio] = judged("plain", ("plain", "guess"), 1.0)
    assert (ratio.value, ratio.holds, ratio.where) == (1.0, True, "recon")
    assert not judged("plain", ("plain", "guess"), 0.999)[0].holds
    [itself] = judged("plain", None, 0.9)
    assert (itself.value, itself.holds) == (1.0, False)
    [broken] = judged("dark", ("plain", "fit"), 9.0)
    assert math.isnan(broken.value)
    assert not broken.holds
    assert judged("odd", ("plain", "fit"), 9.0) == []  # not asked for


def test_a_case_is_measured_pictured_and_written() -> None:
    scene = make_scene("room", size=8, lights=4, held_out=2, seed=1)
    case = Case("plain", "guess", 1, 8, iterations=1, picture=True)
    result, values = measured(case, recipes.GUESS, scene, 1)
    assert result.history.iterations == 0
    assert values["scores"]["recon"] == pytest.approx(result.metrics["recon_rmse"])
    assert values["scores"]["processor"] > 0
    results = recorded((case, values))
    [sheet] = pictures(results, {"guess": "a guess"}, "Said.")
    assert sheet.name == "maps-plain"
    assert len(Image.open(io.BytesIO(sheet.png)).convert("RGB").getcolors(10**6) or ()) > 10
    curve = [{"at": 1, "error": 0.5, "why": ["a", "b"]}, {"at": 2, "error": 0.25}]
    files = csv_files(recorded((case, {**values, "curve": curve})))
    [line] = files["scenes.csv"]
    assert (line["condition"], line["way"], line["seed"]) == ("plain", "guess", 1)
    assert line["albedo"] == values["scores"]["albedo"]
    assert "maps" not in line
    assert [(of["seed"], of["at"]) for of in files["curve.csv"]] == [(1, 1), (1, 2)]
    assert files["curve.csv"][0]["why"] == "a b"
