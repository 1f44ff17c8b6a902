"""`pbrfit evaluate lamps`: where lamps are, how far found ones are off, verdicts, the command.

How well fits find lamps is not tested here. A room of our own renderer stands in for one of Cycles.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation_tasks import own_room, recorded
from pbrfit.model.lamps import Lamps
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw
from pbrfit_evaluation import cycles, recipes
from pbrfit_evaluation.cycles.export import export
from pbrfit_evaluation.explained import Case
from pbrfit_evaluation.lamps import SETUPS, figures, measure
from pbrfit_evaluation.lamps.measure import NAMES, ROWS, lamps_off
from pbrfit_evaluation.lamps.variants import BY_KEY, CONSTANT, HARMONICS, NEAR
from pbrfit_evaluation.normal_errors import unit
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.table1.rows import BY_KEY as TABLE1
from scene_files import run

SIZE = 16
LIGHTS = 4


def with_lamps(case: Case, _: int) -> tuple[Scene, Lamps]:
    """Stand in for `measure.room`: a room of our renderer, and some lamps."""
    places = np.random.default_rng(case.seed).normal((0, 1, -1), 0.5, (case.lights, 3))
    return own_room(case, 1), Lamps(np.arange(case.lights), places, np.ones(case.lights, bool))


CASE = Case("points-shadows", NEAR, 2003, SIZE, LIGHTS, picture=True)


@pytest.fixture(scope="module")
def room() -> tuple[Scene, Lamps]:
    return with_lamps(CASE, 1)


def test_setups_are_rooms_of_table_1_under_points() -> None:
    assert set(SETUPS) == set(ROWS) == set(NAMES)
    rows = [TABLE1[key] for key in ROWS.values()]
    assert {(row.light, row.renderer, row.scene) for row in rows} == {
        ("points", "cycles", "furnished")
    }
    assert [row.transport for row in rows] == ["shadows", "brdf"]


def test_true_lamps_are_inside_the_room_and_not_in_furniture() -> None:
    row = TABLE1[ROWS["points-shadows"]]
    task = table1.Task(row.key, 8200, SIZE, LIGHTS, 0)
    lamps = table1.cycles_lamps(task, row)
    assert lamps.near.all()
    assert lamps.pictures.tolist() == list(range(LIGHTS))
    [stream] = np.random.SeedSequence(8200).spawn(1)
    world = draw(row.scene, np.random.default_rng(stream))
    for mesh in export(world, SIZE, 60.0).meshes[: world.walls]:
        heights = np.einsum("kvi,vi->kv", lamps.places[:, None] - mesh.vertices, mesh.normals)
        assert heights.min() >= 0.5  # metres from every wall


def test_true_lamps_are_those_that_are_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    class StopError(Exception):
        pass

    def rendered(job: Any, **_: object) -> None:
        asked.append(job.positions)
        raise StopError

    monkeypatch.setattr("pbrfit_evaluation.cycles.scene.rendered", rendered)
    row = TABLE1[ROWS["points-shadows"]]
    task = table1.Task(row.key, 8203, SIZE, LIGHTS, 0)
    with pytest.raises(StopError):
        table1.cycles_scene(task, row, 1)
    np.testing.assert_array_equal(table1.cycles_lamps(task, row).places, asked[0])


def test_lamps_at_their_places_are_not_off(room: tuple[Scene, Lamps]) -> None:
    scene, true = room
    assert lamps_off(true, true, scene) == {"cm": 0, "degrees": 0, "near": 1}
    moved = replace(true, places=true.places + np.array([0.03, 0, 0.04]))
    off = lamps_off(moved, true, scene)
    assert off["cm"] == pytest.approx(5)
    assert 0 < off["degrees"] < 10


def test_far_lamps_are_off_by_angles_alone(room: tuple[Scene, Lamps]) -> None:
    scene, true = room
    far = Lamps(true.pictures, unit(true.places), np.zeros(len(true), bool))
    off = lamps_off(far, true, scene)
    assert off.keys() == {"degrees", "near"}
    assert off["near"] == 0
    assert lamps_off(None, true, scene) == {}


@pytest.mark.slow
def test_variants_are_told_what_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    told: dict[str, Any] = {}
    light: dict[str, Any] = {}

    def explain(scene: Scene, *_: object, **options: Any) -> Any:
        told[key], light[key] = scene, options.get("light")
        return recipes.explain(scene, "start", model="principled", threads=1)

    monkeypatch.setattr(measure, "room", with_lamps)
    monkeypatch.setattr(measure, "fit", explain)
    monkeypatch.setattr(measure, "explain", explain)
    for key in BY_KEY:
        measure.run(replace(CASE, variant=key, picture=False), 1)
    assert [key for key in BY_KEY if told[key].depth is not None] == [
        key for key in BY_KEY if BY_KEY[key].depth
    ]
    assert [key for key in BY_KEY if told[key].lamps is not None] == ["known"]
    assert light[CONSTANT] is None
    expected = {"sh": "sh", "lamps": "lamps", NEAR: "lamps", "auto-depth": "auto", "known": "lamps"}
    assert {key: light[key] for key in expected} == expected


def values(error: float, cm: float | None = None) -> dict[str, Any]:
    scores = dict.fromkeys((*figures.ERRORS, "recon", "seconds"), error)
    return {"scores": scores, "lamps": {} if cm is None else {"cm": cm, "near": 1.0}}


def results(found: dict[str, dict[str, Any]]) -> Any:
    cases = [replace(CASE, variant=key, picture=False) for key in found]
    pairs = zip(cases, found.values(), strict=True)
    return recorded(*pairs, setups=["points-shadows"], variants=list(found))


def test_lamps_have_to_be_worth_something() -> None:
    good = {CONSTANT: values(0.3), HARMONICS: values(0.4), NEAR: values(0.2, 3.0)}
    assert all(one.holds for one in figures.verdicts(results(good), None))
    for spoilt in (values(0.35, 3.0), values(0.2, 6.0)):
        assert not all(one.holds for one in figures.verdicts(results({**good, NEAR: spoilt}), None))


def test_auto_spoils_nothing() -> None:
    for error, holds in ((0.2, True), (0.21, False)):
        found = results({HARMONICS: values(0.2), "auto": values(error)})
        assert [verdict.holds for verdict in figures.verdicts(found, None)] == [holds]


@pytest.mark.slow
def test_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(measure, "room", with_lamps)
    monkeypatch.setattr(cycles, "why_not", lambda: None)
    monkeypatch.setattr(measure, "fit", partial(recipes.fit, iterations=2, uncertainty=False))
    out = tmp_path / "out"
    few = ("--scenes", 1, "--size", SIZE, "--lights", LIGHTS, "--jobs", 1, "--first-seed", 2003)
    variants = ("--variants", CONSTANT, HARMONICS)
    code = run("evaluate", "lamps", "--quick", *few, *variants, "--out", out)
    assert code == 0, capsys.readouterr().err
    rows = json.loads((out / "summary.json").read_text(encoding="utf-8"))["rows"]
    assert [row["solver"] for row in rows if row["scenes"]] == [
        BY_KEY[key].words for key in (CONSTANT, HARMONICS)
    ]
    assert (out / "maps-points-shadows.png").is_file()
