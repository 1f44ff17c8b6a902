"""The solvers suite: its measures, its processes, its verdicts and its command."""

from __future__ import annotations

import json
import math
import os
from argparse import Namespace
from collections.abc import Sequence
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
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.solvers import (
    SUITE,
    comparisons,
    exact,
    figures,
    fits,
    memory,
    own_process,
    race,
)
from pbrfit_evaluation.solvers.fits import Case
from pbrfit_evaluation.suite import Results, Verdict


@pytest.fixture(scope="module")
def scene() -> Scene:
    return fits.in_float32(fits.room(1000, 12, noise=0.01, held_out=1))


@pytest.fixture(scope="module")
def fitted(scene: Scene) -> Result:
    return fits.fit(scene, "lbfgsb", iterations=15, priors=None, threads=1)


# -------------------------------------------------------------------------------------- measures


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
    worst = wrong["worst"]
    assert (worst["y"], worst["x"]) == (2, 3)
    assert worst["roughness found"] == pytest.approx(roughness[2, 3])
    assert worst["off"] == pytest.approx(0.5)
    metal = [float(true.metallic[at]) >= 0.5 for at in ((2, 3), (4, 5))]
    assert wrong["metal"] == sum(metal)
    assert json.loads(json.dumps(wrong)) == wrong


def test_exact_is_exact_in_every_map() -> None:
    assert exact.is_exact(3e-8, [1e-6, 1e-6, 0.0])
    assert not exact.is_exact(3e-8, [1e-6, 1e-6, 0.0], exact.RECON_FLOAT64)
    for bad in (1.1e-6, math.nan):
        assert not exact.is_exact(3e-8, [0.0, bad])
        assert not exact.is_exact(bad, [0.0])


# ------------------------------------------------------------------------------------- processes


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
    task = race.Task("paper", 1000, 12, 10)
    values = race.work(task, 1)
    assert values["is_mark"]
    assert values["residual"] == values["points"][-1][2] < values["points"][0][2]
    failed = replace(task, seed=7)
    pairs = [recorded(task, values), (failed, Record(failed.key, None, "no", 1.0))]
    rest = race.rest(Results(Namespace(), pairs))
    assert {t.seed for t in rest} == {task.seed}
    assert {t.runner for t in rest} >= {"gauss-newton", "auto", "lbfgsb"}
    assert all(t.mark == (values["residual"], values["seconds"]) for t in rest)


def test_memory_is_that_of_the_fit_and_its_pictures(tmp_path: Path) -> None:
    memory.write_scene(tmp_path / "scene.npz", 16, 1)
    with np.load(tmp_path / "scene.npz") as kept:
        assert kept["images"].dtype == np.float32
        assert kept["images"].mean() == pytest.approx(0.4, rel=1e-5)
    peak, _ = memory.peak_of_fit(tmp_path / "scene.npz", "lbfgsb", 1)
    assert peak is None or peak >= 0


# -------------------------------------------------------------------------------------- verdicts


def recorded(task: Any, values: Any) -> tuple[Any, Record]:
    return task, Record(task.key, values, None, 1.0)


def judged(part: str, pairs: Sequence[tuple[Any, Record]]) -> list[Verdict]:
    [of] = [one for one in SUITE.parts if one.name == part]
    results = Results(Namespace(cycles_scenes=0), pairs)
    return list(of.verdicts(results, of.figures(results)))


def told(verdicts: Sequence[Verdict], words: str) -> Verdict:
    [found] = [verdict for verdict in verdicts if verdict.what.startswith(words)]
    return found


def test_exact_rooms_are_counted_and_auto_ends_no_higher_than_lbfgsb() -> None:
    def rooms(good: int, auto: float = 1e-9) -> list[Verdict]:
        pairs = []
        for i in range(67):
            run = {"exact": i < good, "recon": 1e-9, "worst_map": 0.0, "seconds": 1.0}
            runs = dict.fromkeys(exact.FITS, run)
            runs["auto"] = run | {"recon": auto if i == 1 else 1e-9}
            pairs.append(recorded(Case("exact", 1000 + i, 128, 500), runs))
        return judged("exact", pairs)

    of64 = rooms(64)
    assert len(of64) == 4
    assert all(v.holds for v in of64)
    assert all((v.value, v.bar) == (64, 64) for v in of64[:3])
    assert of64[0].where == "not: 1064, 1065, 1066"
    assert not any(v.holds for v in rooms(63)[:3])
    above = rooms(67, auto=2e-9)[3]
    assert above.value == pytest.approx(2.0)
    assert (above.holds, above.where) == (False, "seed 1001; above in 1 of 67")


def test_noise_is_held_against_the_mark_and_lbfgsbs_maps() -> None:
    def run(above: float, error: float) -> dict[str, float]:
        return {"above_mark": above, **dict.fromkeys(figures.NOISE_METRICS, error)}

    values = {
        "gauss-newton": run(0.05, 0.1),
        "auto": run(5e-4, 0.103),
        "lbfgsb": run(0.1, 0.1),
        "auto, priors": run(0.5, 0.05),
        "lbfgsb, priors": run(0.5, 0.05),
    }
    found = judged("noise", [recorded(Case("noise", 1000, 8, 9, noise=0.01), values)])
    assert [v.holds for v in found] == [True, False, False, True]
    assert [v.value for v in found] == pytest.approx([5e-4, 0.05, 1.03, 1.0])
    assert found[2].what == "auto over lbfgsb, noise 0.01, no priors: worst mean error"


def test_the_same_start_must_not_end_higher() -> None:
    def pair(kind: str, noise: float, ratio: float) -> Any:
        values = {name: {"auto": ratio, "lbfgsb": 1.0} for name in comparisons.SETTINGS}
        return recorded(Case("start", 1, 8, 9, kind, noise), values)

    pairs = [pair("room", 0.0, 0.5), pair("spheres", 0.01, 1.00001)]
    found = judged("start", pairs)
    assert len(found) == len(comparisons.SETTINGS)
    assert not any(v.holds for v in found)
    assert all(v.where == "spheres_10_1; above in 1 of 2" for v in found)
    assert all(v.holds for v in judged("start", pairs[:1]))


def test_gap_columns_are_ratios_of_means() -> None:
    def scores(recon: float, other: float | None) -> dict[str, Any]:
        return {"recon": recon, "albedo": 0.2, "roughness": 0.2, "metallic": 0.2, "relight": other}

    def pair(seed: int, ours: Any, paper: Any) -> Any:
        return recorded(Case("gap", seed, 8, 9, "sh2"), {"auto": ours, "paper": paper})

    recon, mean, worst = judged("gap", [
        pair(1, scores(0.1, 0.5), scores(0.3, 0.4)), pair(2, scores(0.3, 0.5), scores(0.1, 0.3))
    ])  # fmt: skip
    assert [recon.value, mean.value] == pytest.approx([1.0, (1 / 0.7) ** 0.2])
    assert worst.value == pytest.approx(1 / 0.7)
    assert (worst.where, worst.holds) == ("relight", False)
    missing = judged("gap", [pair(1, scores(0.1, None), scores(0.2, None))])
    assert missing[1].value == pytest.approx(0.5**0.25)  # no relit pictures: no column


def test_priors_are_held_to_the_ratio_of_means() -> None:
    without = dict.fromkeys(("roughness", *figures.PRIORS_METRICS), 0.1)
    values = {"none": without, "default": dict.fromkeys(without, 0.06) | {"metallic": 0.11}}
    found = judged("priors", [
        recorded(Case("priors", 3000, 8, 9, name), values) for name in comparisons.PRIORS_CASES
    ])  # fmt: skip
    assert len(found) == 10
    assert not told(found, "merged: roughness").holds
    assert told(found, "varying: roughness").holds
    assert told(found, "none: worst").value == pytest.approx(1.1)
    assert told(found, "none: worst").where == "metallic"


def raced(**times: tuple[float, float | None]) -> list[Any]:
    return [
        recorded(race.Task(key.replace("_", "-"), 1000, 8, 9), {
            "residual": 0.1, "seconds": seconds, "evaluations": 9, "reached": reached,
            "is_mark": key == "paper", "pictures_rms": 0.5,
        })
        for key, (seconds, reached) in times.items()
    ]  # fmt: skip


def test_speed_is_against_the_sooner_of_ours_and_against_the_peer() -> None:
    pairs = raced(
        paper=(50.0, None),
        lbfgsb=(60.0, 40.0),
        auto=(5.0, 1.0),
        gauss_newton=(2.0, None),
        torch=(500.0, None),
    )
    runs = {task.runner: record.values for task, record in pairs}
    assert figures.speed(runs, "auto", "lbfgsb") == (40.0, False)
    assert figures.speed(runs, "gauss-newton", "lbfgsb") == (0.0, False)
    assert figures.speed(runs, "auto", "torch") == (500.0, True)
    found = judged("race", pairs)
    assert told(found, "auto: times sooner at the mark than torch").holds
    assert "never reached" in told(found, "auto: times sooner at the mark than torch").where
    assert not told(found, "gauss-newton: times sooner at the mark than lbfgsb").holds
    alone = judged("race", raced(paper=(50.0, None), auto=(5.0, 1.0)))
    assert [v.what.split(",")[0] for v in alone] == ["auto: times sooner at the mark than lbfgsb"]


def test_memory_is_held_to_the_pictures_bytes() -> None:
    def pair(solver: Any, size: int, ratio: float) -> Any:
        pictures = 16 * size**2 * 12 / 2**20
        values = {"pictures_mib": pictures, "peak_mib": ratio * pictures, "seconds": 1.0}
        return recorded(memory.Task(solver, size), values | {"peak_over_pictures": ratio})

    found = judged("memory", [
        pair("auto", 512, 7.9), pair("gauss-newton", 512, 4.1), pair("lbfgsb", 512, 20.0),
        pair("auto", 2048, 7.9),
    ])  # fmt: skip
    assert [v.holds for v in found] == [True, False, True, True]
    assert found[-1].value == pytest.approx(7.9 * 16 * 2048**2 * 12 / 2**30)


# --------------------------------------------------------------------------------------- command


@pytest.mark.parametrize("quick", [False, True])
def test_cases_have_unique_names(quick: bool) -> None:
    sizes = {name: both[quick] for name, both in SUITE.effort.items()}
    asked = Namespace(**{**sizes, "cycles_scenes": 0, "cycles_cache": None, "large": True})
    keys = [case.key for part in SUITE.parts for case in part.cases(asked)]
    assert len(set(keys)) == len(keys)
    assert {key.split("_")[0] for key in keys} == {part.name for part in SUITE.parts}


def test_the_command_runs_parts_and_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["evaluate", "solvers", "--quick", "--quiet", "--scenes", "1", "--size", "12"]
    options += ["--iterations", "3", "--out", str(out), "--part", "exact", "gap", "race"]
    assert main(options) == 1  # nothing holds after three iterations
    rows = json.loads((out / "summary.json").read_text("utf-8"))["rows"]
    by_name = {row["name"]: row for row in rows}
    assert by_name["exact: auto's residual over lbfgsb's"]["metrics"]["bar"] == 1
    assert by_name["rooms without noise"]["metrics"]["recon"] > 0
    assert by_name["SH2 decomposition"]["scenes"] == 1
    assert any(name.startswith("race: auto: times sooner") for name in by_name)
    assert "exact,exact_1000,auto/recon," in (out / "scenes.csv").read_text("utf-8")
    assert {path.stem for path in out.glob("*.png")} == {"exact", "gap", "race"}
    records = {path.name: path.stat().st_mtime_ns for path in (out / "records").iterdir()}
    assert len(records) >= 1 + 3 + 4
    assert main([*options, "--resume"]) == 1
    assert records == {p.name: p.stat().st_mtime_ns for p in (out / "records").iterdir()}
