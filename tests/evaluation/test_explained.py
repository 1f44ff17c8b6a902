"""Rooms by Cycles that are explained in several ways: `pbrfit evaluate transport` and `lamps`.

What fits are told, rows, files that are written. How well geometry explains
pictures, and fits find lamps, is not tested here. Rooms of our own renderer stand in for those of
Cycles, and fits with geometry for the estimator's, where it has none.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation_tasks import depth_off, normals_off, own_room
from pbrfit.fit.decompose import decompose
from pbrfit.model.geometry import unit
from pbrfit.model.lamps import Lamps
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import cycles, recipes
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.table1.measure import ROWS as TABLE1
from pbrfit_evaluation.transport import measure
from pbrfit_evaluation.transport.figures import CHOICES
from pbrfit_evaluation.transport.measure import (
    LAMPS,
    OF_GEOMETRY,
    ROWS,
    VARIANTS,
    lamps_off,
    told,
)
from scene_files import known, run

SIZE = 24
LIGHTS = 4

CASE = Case("points-shadows", "lamps-depth", 8200, SIZE, lights=LIGHTS)
ROW = TABLE1[ROWS["points-shadows"][0]]


def stand_in(case: Case, _: int) -> tuple[Scene, Lamps | None]:
    """In place of `measure.room`: a room of our renderer, and some lamps where it has such."""
    places = np.random.default_rng(case.seed).normal((0, 1, -1), 0.5, (case.lights, 3))
    lamps = Lamps(np.arange(case.lights), places, np.ones(case.lights, bool))
    return own_room(case, 1), lamps if case.condition in LAMPS.conditions else None


@pytest.fixture(scope="module")
def exact() -> Scene:
    return own_room(Case("shadows", "true", 2003, SIZE, lights=4), 1)


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rooms without Cycles, and short fits."""

    def short(scene: Scene, **options: Any) -> Any:
        return decompose(scene, **{**options, "iterations": 2, "uncertainty": False})

    monkeypatch.setattr(measure, "room", stand_in)
    monkeypatch.setattr(recipes, "decompose", short)
    monkeypatch.setattr(cycles, "why_not", lambda: None)


def test_the_true_variant_is_told_the_truth(exact: Scene) -> None:
    scene = told(exact, VARIANTS["true"], 2003)
    np.testing.assert_array_equal(scene.depth, exact.depth)
    assert scene.segments is exact.segments


def test_variants_without_geometry_are_told_no_depth(exact: Scene) -> None:
    for key in ("constant", "default", "without"):
        scene = told(exact, VARIANTS[key], 2003)
        assert scene.depth is None
        assert "transport" not in VARIANTS[key].options
        np.testing.assert_array_equal(scene.images, exact.images)


def test_wrong_depth_is_told_and_rough_depth_is_worse(exact: Scene) -> None:
    network, rough = (told(exact, VARIANTS[key], 2003).depth for key in ("network", "rough"))
    off = [depth_off(depth, exact.depth, exact.valid) for depth in (network, rough)]
    assert 0.005 < off[0] < off[1] < 0.2


def test_integrated_depth_has_the_normals_and_does_not_know_jumps(exact: Scene) -> None:
    depth = known(told(exact, VARIANTS["integrated"], 2003).depth)
    assert np.nanmedian(depth) == pytest.approx(1)
    assert depth_off(depth, exact.depth, exact.valid) > 0.02
    assert normals_off(depth, exact.normals, exact.fov, exact.valid) < 8


@pytest.mark.slow
@pytest.mark.parametrize("key", OF_GEOMETRY)
def test_every_variant_runs(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "room", stand_in)
    found = measure.run(Case("shadows", key, 2003, SIZE, lights=4, picture=key == "without"), 1)
    assert json.loads(json.dumps(found)) == found
    assert found["choice"] in CHOICES
    assert found["scores"]["relight"] > 0
    assert ("maps" in found) == (key == "without")


@pytest.mark.slow
@pytest.mark.usefixtures("stand_ins")
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ("evaluate", "transport", "--out", out, "--quick", "--jobs", 1, "--lights", LIGHTS)
    assert run(*command) == 0
    assert "true depth" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {
        "records", "report.html", "transport.md", "scenes.csv", "summary.json",
        "maps-shadows.png",
    }  # fmt: skip
    rows = json.loads((out / "summary.json").read_text(encoding="utf-8"))["rows"]
    by_solver = {row["solver"]: row for row in rows if row["scenes"]}
    assert set(by_solver) == {"constant guess", "no depth", "true depth"}
    # Our renderer's rooms neither block nor reflect light.
    chosen = {f"chose_{one}": float(one == "none") for one in CHOICES}
    assert chosen.items() <= by_solver["true depth"]["metrics"].items()


# ---------------------------------------------------------------------------------------- lamps


def test_true_lamps_are_those_that_are_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []

    class StopError(Exception):
        pass

    def rendered(job: Any, **_: object) -> None:
        given.append(job.positions)
        raise StopError

    monkeypatch.setattr("pbrfit_evaluation.cycles.scene.rendered", rendered)
    with pytest.raises(StopError):
        table1.cycles_scene(CASE, ROW, 1)
    np.testing.assert_array_equal(table1.cycles_lamps(CASE, ROW).places, given[0])


def test_lamps_are_off_by_distances_and_far_ones_by_angles_alone() -> None:
    scene, true = stand_in(CASE, 1)
    assert true is not None
    assert lamps_off(true, true, scene) == {"cm": 0, "degrees": 0, "near": 1}
    moved = replace(true, places=true.places + np.array([0.03, 0, 0.04]))
    off = lamps_off(moved, true, scene)
    assert off["cm"] == pytest.approx(5)
    assert 0 < off["degrees"] < 10
    far = Lamps(true.pictures, unit(true.places), np.zeros(len(true), bool))
    off = lamps_off(far, true, scene)
    assert off.keys() == {"degrees", "near"}
    assert off["near"] == 0
    assert lamps_off(None, true, scene) == {}
