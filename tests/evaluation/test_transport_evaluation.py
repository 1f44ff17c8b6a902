"""`pbrfit evaluate transport`: what fits are told, verdicts that can fail, files that are written.

How well geometry explains pictures is not tested here. Rooms of our own renderer stand in for those
of Cycles, and fits with geometry for the estimator's, where it has none.
"""

from __future__ import annotations

import json
from argparse import Namespace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation_tasks import own_room, recorded
from pbrfit.cli import main
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import cycles, recipes
from pbrfit_evaluation.explained import Case
from pbrfit_evaluation.explained.figures import ratio
from pbrfit_evaluation.suite import Verdict
from pbrfit_evaluation.table1.rows import BY_KEY as TABLE1
from pbrfit_evaluation.transport import SETUPS, SUITE, figures, measure
from pbrfit_evaluation.transport.figures import CHOICES
from pbrfit_evaluation.transport.measure import NAMES, ROWS, told
from pbrfit_evaluation.transport.variants import BY_KEY, VARIANTS
from scene_files import known

SIZE = 24


@pytest.fixture(scope="module")
def exact() -> Scene:
    return own_room(Case("shadows", "true", 2003, SIZE, 4), 1)


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rooms without Cycles, and short fits."""
    monkeypatch.setattr(measure, "room", own_room)
    monkeypatch.setattr(measure, "fit", partial(recipes.fit, iterations=2, uncertainty=False))
    monkeypatch.setattr(cycles, "why_not", lambda: None)


def test_setups_are_rows_of_table_1_by_cycles_with_true_normals() -> None:
    assert set(SETUPS) == set(ROWS) == set(NAMES)
    rows = [TABLE1[key] for key in ROWS.values()]
    assert {(row.renderer, row.light, row.normals) for row in rows} == {
        ("cycles", "panorama", "true")
    }
    assert [row.transport for row in rows] == ["brdf", "shadows", "full", "full"]


def test_the_true_variant_is_told_the_truth(exact: Scene) -> None:
    scene, facts = told(exact, BY_KEY["true"], 2003)
    np.testing.assert_array_equal(scene.depth, exact.depth)
    assert scene.segments is exact.segments
    assert facts["depth_off"] == 0
    assert facts["purity"] == 1
    assert facts["normals_off"] < 8  # half of so few pixels are at edges


def test_variants_without_geometry_are_told_no_depth(exact: Scene) -> None:
    for key in ("constant", "default", "without"):
        scene, facts = told(exact, BY_KEY[key], 2003)
        assert scene.depth is None
        assert BY_KEY[key].transport is None
        assert "depth_off" not in facts
        np.testing.assert_array_equal(scene.images, exact.images)


def test_wrong_depth_is_told_and_rough_depth_is_worse(exact: Scene) -> None:
    by_key = {key: told(exact, BY_KEY[key], 2003) for key in ("network", "rough", "network-found")}
    network, rough = (by_key[key][1] for key in ("network", "rough"))
    assert 0.005 < network["depth_off"] < rough["depth_off"] < 0.2
    assert network["normals_off"] < rough["normals_off"]
    np.testing.assert_array_equal(by_key["network"][0].depth, by_key["network-found"][0].depth)


def test_segments_are_found_or_left_out(exact: Scene) -> None:
    found, facts = told(exact, BY_KEY["found"], 2003)
    assert not np.array_equal(known(found.segments), known(exact.segments))
    assert 0.5 < facts["purity"] < 1
    without, facts = told(exact, BY_KEY["unsegmented"], 2003)
    assert without.segments is None
    assert "purity" not in facts


def test_integrated_depth_has_the_normals_and_does_not_know_jumps(exact: Scene) -> None:
    scene, facts = told(exact, BY_KEY["integrated"], 2003)
    assert np.nanmedian(known(scene.depth)) == pytest.approx(1)
    assert facts["depth_off"] > 0.02
    assert facts["normals_off"] < 8


@pytest.mark.slow
@pytest.mark.usefixtures("stand_ins")
def test_a_room_is_measured_and_pictured() -> None:
    found = measure.run(Case("shadows", "without", 2003, SIZE, 4, picture=True), 1)
    assert json.loads(json.dumps(found)) == found
    assert found["choice"] == "none"
    assert found["scores"]["relight"] > 0
    case = Case("shadows", "without", 2003, SIZE, 4)
    sheet = figures.relit(recorded((case, found), setups=("shadows",)))
    assert len(np.unique(known(sheet))) > 50
    assert "pictures" not in measure.run(Case("shadows", "constant", 2003, SIZE, 4), 1)


@pytest.mark.slow
@pytest.mark.parametrize("key", [variant.key for variant in VARIANTS])
def test_every_variant_runs(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "room", own_room)
    found = measure.run(Case("shadows", key, 2003, SIZE, 4), 1)
    assert found["choice"] in figures.CHOICES


def asked(*, quick: bool = False, **changes: Any) -> Namespace:
    """Options as on the command line."""
    effort = {name: both[quick] for name, both in SUITE.effort.items()}
    rest = {"lights": 16, "first_seed": measure.FIRST_SEED, "cycles_cache": None}
    return Namespace(**{**effort, **rest, **changes})


def of(setup: Any, variant: str, seed: int, error: float, **changes: float) -> tuple[Case, Any]:
    scores = dict.fromkeys(figures.METRICS, error) | changes
    facts = {"depth_off": 0.1, "normals_off": 5.0, "segments": 20.0, "purity": 0.9}
    values = {"scores": scores, "facts": facts, "choice": "occlusion"}
    return Case(setup, variant, seed, SIZE, 4), values


def judged(*pairs: Any, setup: str = "shadows") -> list[Verdict]:
    results = recorded(*pairs, **vars(asked(setups=(setup,))))
    return list(figures.verdicts(results, figures.rows(results)))


@pytest.mark.parametrize(("found", "failing"), [(0.199, 0), (0.201, 4), (0.301, 8)])
def test_true_depth_has_to_beat_the_guess_and_what_there_is_without(
    found: float, failing: int
) -> None:
    pairs = [of("shadows", "constant", 1, 0.2), of("shadows", "without", 1, 0.3)]
    verdicts = judged(*pairs, of("shadows", "true", 1, found))
    assert len(verdicts) == 8
    assert sum(not verdict.holds for verdict in verdicts) == failing


@pytest.mark.parametrize(("relight", "holds"), [(0.308, True), (0.31, False)])
def test_other_variants_must_spoil_nothing(relight: float, holds: bool) -> None:
    pair = of("shadows", "without", 1, 0.3), of("shadows", "found", 1, 0.2, relight=relight)
    [verdict] = judged(*pair)
    assert verdict.holds == holds
    assert verdict.where == "relight"


def test_without_shadows_true_depth_must_spoil_nothing_and_need_not_help() -> None:
    pairs = of("brdf", "constant", 1, 0.1), of("brdf", "without", 1, 0.3)
    [verdict] = judged(*pairs, of("brdf", "true", 1, 0.3), setup="brdf")
    assert verdict.holds


def test_ratios_are_of_rooms_that_both_have() -> None:
    results = recorded(
        *(of("shadows", "true", 1, 0.1), of("shadows", "true", 2, 0.3)),
        *(of("shadows", "without", 1, 0.2), of("shadows", "without", 3, 9.0)),
    )
    assert ratio(results, "shadows", "albedo", "true", "without") == pytest.approx(0.5)
    assert np.isnan(ratio(results, "shadows", "albedo", "rough", "without"))


def test_rows_say_what_was_chosen_and_why_some_were_not_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cycles, "why_not", lambda: "no bpy")
    pairs = of("shadows", "without", 1, 0.3), of("shadows", "true", 1, 0.2)
    options = asked(setups=("shadows",))
    rows = {row.solver: row for row in figures.rows(recorded(*pairs, **vars(options)))}
    assert rows["true depth"].metrics["chose_occlusion"] == 1
    assert "chose_occlusion" not in rows["no depth"].metrics
    assert rows["rough depth"].status == "not run: no bpy"
    assert rows["constant guess"].status == "not run: no bpy"


@pytest.mark.slow
@pytest.mark.usefixtures("stand_ins")
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    code = main(["evaluate", "transport", "--out", str(out), "--quick", "--jobs", "1",
                 "--lights", "4"])  # fmt: skip
    assert code == 1  # a fit that is no better does not hold
    assert "and shadows, true depth: albedo over that without depth" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {
        "records", "report.html", "transport.md", "scenes.csv", "summary.json", "transport.png",
        "relit-shadows.png",
    }  # fmt: skip
    rows = json.loads((out / "summary.json").read_text(encoding="utf-8"))["rows"]
    by_solver = {row["solver"]: row for row in rows if row["scenes"]}
    assert set(by_solver) == {"constant guess", "no depth", "true depth"}
    # Our renderer's rooms neither block nor reflect light.
    chosen = {f"chose_{one}": float(one == "none") for one in CHOICES}
    assert chosen.items() <= by_solver["true depth"]["metrics"].items()


def test_command_without_cycles_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cycles, "why_not", lambda: "no bpy")
    out = tmp_path / "out"
    assert main(["evaluate", "transport", "--out", str(out), "--quick", "--jobs", "1"]) == 0
    assert "no bpy" in (out / "report.html").read_text(encoding="utf-8")
    capsys.readouterr()
