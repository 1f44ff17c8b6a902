"""The solvers suite: its measures, its verdicts, its processes, its report and its command."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit import Materials
from pbrfit.cli import main
from pbrfit.fit.objective import Objective
from pbrfit.result import metrics
from pbrfit.result.options import Priors
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation import page, solvers, summary
from pbrfit_evaluation.commands import solvers as command
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.solvers import (
    FULL,
    PARTS,
    QUICK,
    Measured,
    Part,
    exact,
    fits,
    gap,
    memory,
    noise,
    own_process,
    priors,
    race,
    report,
    start,
)
from pbrfit_evaluation.solvers.report.verdicts import speeds, verdicts
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.verdicts import Verdict, digits


@pytest.fixture(scope="module")
def scene() -> Scene:
    return fits.in_float32(fits.room(1000, 12, noise=0.01, held_out=1))


@pytest.fixture(scope="module")
def fitted(scene: Scene) -> Result:
    return fits.fit(scene, "lbfgsb", iterations=15, priors=None, threads=1)


def recorded(task: Any, values: Any) -> tuple[Any, Record]:
    return task, Record(task.key, values, None, 1.0)


def measured(**found: Any) -> Measured:
    by_part: dict[Any, Any] = found
    return Measured(QUICK, 1, by_part, {})


# Measures


def test_the_objective_is_that_which_is_minimised(scene: Scene, fitted: Result) -> None:
    objective = Objective(scene, threads=1)
    x = objective.pack(fitted.albedo, fitted.roughness, fitted.metallic, fitted.lighting)
    found = fits.objective_value(scene, fitted, threads=1)
    assert found == pytest.approx(objective.data_value_and_grad(x)[0], rel=1e-6)
    assert found == pytest.approx(fitted.history["loss"][-1], rel=1e-5)
    some = replace(Priors.none(), smoothness=0.1)
    with_penalty = Objective(scene, threads=1, priors=some)
    more = with_penalty.add_penalties(x, np.zeros_like(x))
    assert more > 0
    assert fits.objective_value(scene, fitted, priors=some) == pytest.approx(found + more)
    robust = "huber", 0.001
    objective.robust = robust
    assert fits.objective_value(scene, fitted, robust=robust) == pytest.approx(
        objective.data_value_and_grad(x)[0]
    )


def test_residuals_are_those_of_the_pictures_with_and_without_noise(
    scene: Scene, fitted: Result
) -> None:
    assert fits.residual(scene, fitted) == pytest.approx(fitted.metrics["recon_rmse"], rel=1e-12)
    truth = scene.truth
    assert truth is not None
    assert truth.lighting is not None
    perfect = replace(fitted, materials=truth.materials, lighting=truth.lighting)
    assert fits.clean_residual(scene, perfect) == 0.0
    assert fits.residual(scene, perfect) == pytest.approx(0.01, rel=0.05)
    assert fits.clean_residual(scene, fitted) > 0
    assert fits.rms(scene) == pytest.approx(
        math.sqrt(np.mean(np.square(scene.images, dtype=float)))
    )


def test_wrong_pixels_are_counted_and_told_by_kind(scene: Scene, fitted: Result) -> None:
    truth = scene.truth
    assert truth is not None
    true = truth.materials
    roughness = true.roughness.copy()
    albedo = true.albedo.copy()
    roughness[2, 3] += 0.5 if roughness[2, 3] < 0.5 else -0.5
    albedo[4, 5, 1] += 2e-4
    albedo[6, 7, 1] += 0.5e-4  # within what counts as right
    found = replace(fitted, materials=Materials(albedo, roughness, true.metallic))
    wrong = exact.describe_wrong(scene, found)
    assert wrong["count"] == 2
    assert [tuple(pixel["pixel"]) for pixel in wrong["worst"]] == [(2, 3), (4, 5)]
    assert wrong["worst"][0]["roughness"][1] == pytest.approx(roughness[2, 3])
    assert wrong["worst"][1]["off"] == pytest.approx([2e-4, 0.0, 0.0])
    metal = [float(true.metallic[at]) >= 0.5 for at in ((2, 3), (4, 5))]
    assert wrong["kinds"]["metal"] == sum(metal)
    assert json.loads(json.dumps(wrong)) == wrong


def test_exact_is_exact_in_every_map() -> None:
    good = {"recon": 3e-8, "albedo": 1e-6, "roughness": 1e-6, "metallic": 0.0}
    assert exact.is_exact(good)
    assert not exact.is_exact(good, exact.RECON_FLOAT64)
    for name in good:
        assert not exact.is_exact(good | {name: 1.1e-6})
        assert not exact.is_exact(good | {name: math.nan})


# Processes


def _mean_of(values: list[float]) -> float:
    return float(np.mean(values))


def _fail(_: object) -> None:
    raise ValueError("two\nlines")


def _die(code: int) -> None:
    os._exit(code)


def test_a_process_of_its_own_answers_fails_or_dies() -> None:
    assert own_process.call(_mean_of, [1.0, 3.0]) == 2.0
    with pytest.raises(RuntimeError, match=r"^ValueError: two lines$"):
        own_process.call(_fail, 0)
    with pytest.raises(RuntimeError, match="ended with code 7"):
        own_process.call(_die, 7)


def test_the_tracker_knows_when_the_mark_is_reached(scene: Scene, fitted: Result) -> None:
    truth = scene.truth
    assert truth is not None
    assert truth.lighting is not None
    ends = fitted.materials, fitted.lighting
    perfect = truth.materials, truth.lighting
    tracker = race.Tracker(scene, 0.0105, threads=1)
    assert fits.residual(scene, fitted) > 0.0105
    for step in range(40):
        tracker.visit(float(step), step, step + 1, lambda: ends, claimed=1.0)
    assert len(tracker.points) < 30  # checkpoints thin out
    assert tracker.reached is None
    tracker.visit(41.5, 41, 41, lambda: perfect, claimed=0.010)  # near the mark by its own account
    assert tracker.reached == 41.5
    assert tracker.points[-1][:2] == (41.5, 41)
    assert tracker.points[-1][2] == pytest.approx(0.01, rel=0.05)
    tracker.end(50.0, 50, 50, lambda: ends)
    assert tracker.reached == 41.5
    assert tracker.points[-1][2] == pytest.approx(metrics.rmse(
        pbrfit.render(fitted.materials, scene.normals, fitted.lighting, scene.fov), scene.images
    ))  # fmt: skip


def test_a_peer_is_stopped_at_the_mark(scene: Scene, fitted: Result) -> None:
    tracker = race.Tracker(scene, 1.0, threads=1)
    with pytest.raises(race.ReachedError):
        tracker.visit(1.0, 1, 1, lambda: (fitted.materials, fitted.lighting))
    assert tracker.reached == 1.0


def test_a_runner_races_in_its_own_process() -> None:
    [task] = race.plan_marks(1, 12, 10)
    values = race.work(task, 1)
    assert values["is_mark"]
    assert values["residual"] == values["points"][-1][2] < values["points"][0][2]
    rest = race.plan_rest([(task, values), (replace(task, seed=7), None)])
    assert {t.seed for t in rest} == {task.seed}
    assert {t.runner for t in rest} >= {"gauss-newton", "auto", "lbfgsb"}
    assert all(t.mark == race.Mark(values["residual"], values["seconds"]) for t in rest)


def test_memory_is_that_of_the_fit_and_its_pictures(tmp_path: Path) -> None:
    memory.write_scene(tmp_path / "scene.npz", 16, 1)
    with np.load(tmp_path / "scene.npz") as kept:
        assert kept["images"].dtype == np.float32
        assert kept["images"].mean() == pytest.approx(0.4, rel=1e-5)
    peak, _ = memory.peak_of_fit(tmp_path / "scene.npz", "lbfgsb", 1)
    assert peak is None or peak >= 0
    assert memory.Task("auto", 100).picture_bytes == 16 * 100 * 100 * 12


# Plans


@pytest.mark.parametrize("effort", [FULL, QUICK])
def test_plans_have_unique_names(effort: solvers.Effort) -> None:
    without = replace(effort, cycles_scenes=0)
    tasks = [task for part in PARTS for task in solvers.plan(part, without)]
    assert len({task.key for task in tasks}) == len(tasks)
    assert {type(task) for task in tasks} == {
        exact.Task, noise.Task, start.Task, gap.Task, priors.Task, race.Task, memory.Task
    }  # fmt: skip


def test_the_command_names_all_parts() -> None:
    assert command.NAMES == PARTS


# Verdicts


def of(judged: list[Verdict[Part]], start_of_what: str) -> Verdict[Part]:
    [found] = [verdict for verdict in judged if verdict.what.startswith(start_of_what)]
    return found


def exact_run(recon: float) -> dict[str, Any]:
    return {"recon": recon, **dict.fromkeys(exact.MAPS, 1e-7), "seconds": 1.0, "wrong": {
        "count": 0, "kinds": {}, "worst": []}}  # fmt: skip


def test_exact_rooms_are_counted_against_their_share() -> None:
    def rooms(good: int) -> Measured:
        return measured(exact=[
            recorded(exact.Task(1000 + i, 128, 500), {
                name: exact_run(1e-13 if i < good else 1e-3) for name, _, _ in exact.FITS
            }) for i in range(67)
        ])  # fmt: skip

    judged = verdicts(rooms(64))
    assert len(judged) == 4
    assert all(v.holds and (v.value, v.bar) == (64, 64) for v in judged[:3])
    assert judged[0].where == "not: 1064, 1065, 1066"
    assert not any(v.holds for v in verdicts(rooms(63))[:3])


def test_auto_ends_no_higher_than_lbfgsb_without_noise() -> None:
    def room(seed: int, auto: float) -> Any:
        runs = {name: exact_run(1e-3) for name, _, _ in exact.FITS}
        return recorded(exact.Task(seed, 8, 9), runs | {"auto": exact_run(auto)})

    judged = verdicts(measured(exact=[room(1, 1e-9), room(2, 2e-3)]))
    found = of(judged, "auto's residual")
    assert found.value == pytest.approx(2.0)
    assert (found.holds, found.where) == (False, "seed 2; above in 1 of 2")


def test_the_objective_with_noise_is_held_against_the_lower_mark() -> None:
    def scores(value: float) -> dict[str, float]:
        return dict.fromkeys(noise.METRICS, value)

    def run(objective: float, value: float) -> dict[str, Any]:
        return {"objective": objective, "scores": scores(value)}

    values = {
        "gauss-newton from the truth": run(2.0, 0.1),
        "gauss-newton": run(2.1, 0.1),
        "auto": run(2.001, 0.103),
        "lbfgsb": run(2.2, 0.1),
        "auto, priors": run(3.0, 0.05),
        "lbfgsb, priors": run(3.0, 0.05),
    }
    judged = verdicts(measured(noise=[recorded(noise.Task(1000, 8, 0.01, 9), values)]))
    assert len(judged) == 4
    auto = of(judged, "auto, noise 0.01")
    assert auto.value == pytest.approx(5e-4)
    assert auto.holds
    assert of(judged, "gauss-newton, noise").value == pytest.approx(0.05)
    plain = of(judged, "auto over lbfgsb, noise 0.01, no priors")
    assert plain.value == pytest.approx(1.03)
    assert not plain.holds
    assert of(judged, "auto over lbfgsb, noise 0.01, priors").value == pytest.approx(1.0)


def test_the_same_start_must_not_end_higher() -> None:
    def values(ratio: float) -> dict[str, Any]:
        return {name: {"auto": ratio, "lbfgsb": 1.0} for name in start.SETTINGS}

    pairs = [
        recorded(start.Task("room", 1, 8, 0.0, 9), values(0.5)),
        recorded(start.Task("spheres", 1, 8, 0.01, 9), values(1.00001)),
    ]
    judged = verdicts(measured(start=pairs))
    assert len(judged) == len(start.SETTINGS)
    assert not any(v.holds for v in judged)
    assert all(v.where == "spheres_10_1; above in 1 of 2" for v in judged)
    assert all(v.holds for v in verdicts(measured(start=pairs[:1])))


def test_gap_columns_are_ratios_of_means() -> None:
    def scores(recon: float, other: float | None) -> dict[str, Any]:
        return {"recon": recon, "albedo": 0.2, "roughness": 0.2, "metallic": 0.2, "relight": other}

    def pair(seed: int, ours: Any, paper: Any) -> Any:
        task = gap.Task(table1.Task("sh2", seed, 8, 16, 9))
        return recorded(task, {"auto": ours, "paper": paper})

    judged = verdicts(measured(gap=[
        pair(1, scores(0.1, 0.5), scores(0.3, 0.4)), pair(2, scores(0.3, 0.5), scores(0.1, 0.3))
    ]))  # fmt: skip
    recon, mean, worst = judged
    assert recon.value == pytest.approx(1.0)
    assert worst.value == pytest.approx(1 / 0.7)
    assert (worst.where, worst.holds) == ("relight", False)
    assert mean.value == pytest.approx((1 / 0.7) ** 0.2)
    missing = verdicts(measured(gap=[pair(1, scores(0.1, None), scores(0.2, None))]))
    assert missing[1].value == pytest.approx(0.5**0.25)  # no relit pictures: no column


def test_priors_are_held_to_the_ratio_of_means() -> None:
    def values(factor: float) -> dict[str, Any]:
        names = ("roughness", *priors.METRICS)
        return {
            "none": dict.fromkeys(names, 0.1),
            "default": dict.fromkeys(names, 0.1 * factor) | {"metallic": 0.11},
        }

    judged = verdicts(measured(priors=[
        recorded(priors.Task(case, 3000, 8, 9), values(0.6)) for case in priors.CASES
    ]))  # fmt: skip
    assert len(judged) == 10
    assert not of(judged, "merged: roughness").holds
    assert of(judged, "varying: roughness").holds
    worst = of(judged, "none: worst")
    assert worst.value == pytest.approx(1.1)
    assert worst.where == "metallic"


def race_run(seconds: float, reached: float | None, *, is_mark: bool = False) -> dict[str, Any]:
    return {
        "points": [[0.0, 1, 0.5], [seconds, 9, 0.1]],
        "residual": 0.1,
        "seconds": seconds,
        "evaluations": 9,
        "reached": reached,
        "is_mark": is_mark,
        "stop_reason": "done",
        "pictures_rms": 0.5,
    }


def raced(**runs: Any) -> Measured:
    return measured(race=[
        recorded(race.Task(key.replace("_", "-"), 1000, 8, 9), values)
        for key, values in runs.items()
    ])  # fmt: skip


def test_speed_is_against_the_sooner_of_ours_and_against_the_peer() -> None:
    found = raced(
        paper=race_run(50.0, None, is_mark=True),
        lbfgsb=race_run(60.0, 40.0),
        auto=race_run(5.0, 1.0),
        gauss_newton=race_run(2.0, None),
        torch=race_run(500.0, None),
    )
    assert speeds(found, "auto", "lbfgsb")[1000].ratio == 40.0
    assert speeds(found, "gauss-newton", "lbfgsb")[1000].ratio == 0.0
    never = speeds(found, "auto", "torch")[1000]
    assert (never.ratio, never.bounded) == (500.0, True)
    judged = verdicts(found)
    assert of(judged, "auto: times sooner at the mark than torch").holds
    assert "never reached" in of(judged, "auto: times sooner at the mark than torch").where
    assert not of(judged, "gauss-newton: times sooner at the mark than lbfgsb").holds


def test_without_the_peer_nothing_is_said_of_it() -> None:
    judged = verdicts(raced(paper=race_run(50.0, None, is_mark=True), auto=race_run(5.0, 1.0)))
    assert [v.what.split(",")[0] for v in judged] == ["auto: times sooner at the mark than lbfgsb"]


def test_memory_is_held_to_the_pictures_bytes() -> None:
    def pair(solver: Any, size: int, ratio: float) -> Any:
        task = memory.Task(solver, size)
        peak = ratio * task.picture_bytes
        return recorded(task, {"peak": peak, "pictures": task.picture_bytes, "seconds": 1.0})

    judged = verdicts(measured(memory=[
        pair("auto", 512, 7.9), pair("gauss-newton", 512, 4.1), pair("lbfgsb", 512, 20.0),
        pair("auto", 2048, 7.9),
    ]))  # fmt: skip
    assert [v.holds for v in judged] == [True, False, True, True]
    assert judged[-1].value == pytest.approx(7.9 * 16 * 2048**2 * 12 / 2**30)


def test_a_figure_that_is_no_number_holds_nothing() -> None:
    for at_least in (False, True):
        assert not Verdict("exact", "", math.nan, 1.0, at_least=at_least).holds


def test_digits_tell_a_bar_from_what_is_just_beyond() -> None:
    assert [digits(v) for v in (1.02, 64, 3e-8, 0.0)] == ["1.02", "64", "3·10⁻⁸", "0"]
    assert digits(math.inf) == "infinite"


# Report


def test_the_report_has_a_section_for_each_part_and_says_what_failed(tmp_path: Path) -> None:
    found = raced(
        paper=race_run(50.0, None, is_mark=True),
        auto=race_run(5.0, 1.0),
        torch=race_run(500.0, None),
    )
    rooms = [recorded(exact.Task(1000 + i, 8, 9), {
        name: exact_run(10.0 ** -(8 + i)) for name, _, _ in exact.FITS
    }) for i in range(3)]  # fmt: skip
    failed = exact.Task(1003, 8, 9)
    rooms.append((failed, Record(failed.key, None, "ValueError: no", 1.0)))
    whole = replace(found, found={**found.found, "exact": rooms}, notes={"race": "slow peer"})
    report.write(tmp_path, whole)
    text = (tmp_path / page.FILE).read_text(encoding="utf-8")
    for piece in ("Exact: pictures", "Race", "What failed", "exact_1003", "never", "slow peer"):
        assert piece in text
    assert "Memory" not in text
    assert (tmp_path / "race.png").read_bytes().startswith(b"\x89PNG")
    content = json.loads((tmp_path / summary.FILE).read_text(encoding="utf-8"))
    rows = {row["name"]: row for row in content["rows"]}
    assert len(rows) == len(verdicts(whole))
    assert any(row["status"] == "not held" for row in rows.values())
    lines = (tmp_path / report.SCENES).read_text(encoding="utf-8").splitlines()
    assert "exact,exact_1000,auto/recon,1e-08" in lines
    assert any("sooner at the mark" in line for line in report.lines(whole))


def test_the_command_runs_parts_and_goes_on(tmp_path: Path, monkeypatch: Any) -> None:
    def by_lbfgsb(scene: Scene, _: str, **options: Any) -> Result:
        return fits.fit(scene, "lbfgsb", **options)

    for module in (exact, start, gap, priors):
        monkeypatch.setattr(module, "fit", by_lbfgsb)
    out = tmp_path / "out"
    options = ["evaluate", "solvers", "--quick", "--quiet", "--scenes", "1", "--size", "12"]
    options += ["--iterations", "3", "--out", str(out), "--part", "priors", "start"]
    code = main(options)
    assert code in (0, 1)
    text = (out / page.FILE).read_text(encoding="utf-8")
    assert "The same start" in text
    records = {path.name: path.stat().st_mtime_ns for path in (out / "records").iterdir()}
    assert len(records) == len(start.KINDS) * len(start.NOISE) + len(priors.CASES)
    assert main([*options, "--resume"]) == code
    assert records == {p.name: p.stat().st_mtime_ns for p in (out / "records").iterdir()}
