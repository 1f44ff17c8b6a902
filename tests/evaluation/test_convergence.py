"""The convergence suite: its scenes, its measures, its peers, its figures and its command."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit import Materials
from pbrfit.fit.objective import Objective
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.arrays import known
from pbrfit_evaluation.convergence import figures
from pbrfit_evaluation.convergence.measure import (
    CASES,
    QUANTITIES,
    Budget,
    Case,
    Point,
    Tracker,
    first_reached,
    make,
    measure,
    median_reached,
    trial,
)
from pbrfit_evaluation.convergence.solvers import Task, fit_with_ours
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.suite import Results, Verdict
from scene_files import truth_of

SMALL = Case("small", 12)


def point(seconds: float, iteration: int, evaluations: int, error: float) -> Point:
    cost = {"seconds": seconds, "processor": 2 * seconds, "iteration": iteration}
    cost |= {"evaluations": evaluations}
    return {**cost, **dict.fromkeys(QUANTITIES, error)}


CURVE = (point(0, 0, 1, 0.5), point(1, 3, 4, 0.09), point(2, 6, 8, 0.02), point(4, 9, 16, 0.06))
"""Falls below 0.05 and rises again."""


def test_truth_has_no_errors_and_known_changes_have_known_ones() -> None:
    scene = make(SMALL, 100)
    true, lighting = truth_of(scene).materials, known(truth_of(scene).lighting)
    errors = measure(scene, true, lighting)
    assert math.isnan(errors.pop("held_out"))
    assert max(errors.values()) < 1e-12
    found = measure(scene, replace(true, albedo=0.5 * true.albedo), lighting)
    assert found["albedo_scaled"] == pytest.approx(0.0, abs=1e-12)
    assert found["albedo"] == pytest.approx(0.5 * math.sqrt(np.mean(true.albedo**2)))
    assert found["roughness"] == found["metallic"] == 0.0
    halved = measure(scene, true, 0.5 * lighting)
    assert halved["recon"] == pytest.approx(0.5 * math.sqrt(np.mean(scene.images**2)))
    assert halved["relight"] == pytest.approx(0.0, abs=1e-12)  # not under lights that were found
    beyond = Materials(true.albedo, true.roughness, np.full_like(true.metallic, 1.0 + 1e-7))
    assert math.isfinite(measure(scene, beyond, lighting)["recon"])


def test_median_counts_never_as_late() -> None:
    for times, expected in (
        ([], None),
        ([3.0, None, 1.0], 3.0),
        ([None, None, 1.0], None),
        ([1.0, 2.0], 2.0),
        ([1.0, None], None),
    ):
        assert median_reached(times) == expected
    assert first_reached(CURVE, "recon", 0.05) == CURVE[2]
    assert first_reached([point(0, 0, 1, math.nan)], "recon", 1.0) is None


def test_the_solver_tells_its_state_with_the_clock_stopped() -> None:
    scene = make(SMALL, 100)
    tracker = Tracker(partial(measure, scene, threads=1))
    fit_with_ours(scene, Budget(8, 0, 60.0), tracker, 1, solver="lbfgsb", priors=None)
    result = pbrfit.decompose(
        scene, solver="lbfgsb", iterations=8, threads=1, priors=None, refine_normals="off"
    )
    for at in tracker.points:
        row = list(result.history["iteration"]).index(at["iteration"])
        assert at["evaluations"] == result.history["evaluations"][row]
        assert at["albedo"] == pytest.approx(result.history["albedo_rmse"][row])
        assert at["recon"] == pytest.approx(result.history["recon_rmse"][row], rel=1e-3)
    last = tracker.points[-1]
    assert last["relight"] == pytest.approx(result.metrics["relight_rmse"])
    assert last["albedo_scaled"] == pytest.approx(result.metrics["albedo_scaled_rmse"])
    seconds = [at["seconds"] for at in tracker.points]
    assert seconds == sorted(seconds)


def test_real_pictures_are_judged_by_those_held_out(tmp_path: Path) -> None:
    scene = make_scene("room", size=12, lights=8, held_out=1, seed=3)
    replace(scene, truth=None).save(tmp_path / "room")
    case = Case("real-12", 12, folder=tmp_path / "room")
    assert case.judged == "held_out"
    fitted, errors = trial(case, 100, threads=1)
    assert len(fitted.images) == 6
    assert scene.lighting is None
    true = truth_of(scene).materials
    found = errors(true, np.zeros((6, 16, 3)))
    assert found["held_out"] < 1e-3
    assert found["recon"] < 1e-3
    assert math.isnan(found["albedo"])
    grey = replace(true, albedo=np.full_like(true.albedo, 0.5))
    assert errors(grey, np.zeros((6, 16, 3)))["held_out"] > 0.05


def options(*cases: str, seeds: int = 1, iterations: int = 12) -> argparse.Namespace:
    budget = {"iterations": iterations, "evaluations": 12, "seconds": 60.0}
    return argparse.Namespace(
        model="paper", cases=cases, seeds=seeds, real=None, solvers=None, **budget
    )


def test_torch_loss_and_gradient_are_ours() -> None:
    pytest.importorskip("torch")
    from pbrfit_evaluation.convergence.torch_peer import Problem

    scene = make(Case("c", 16, 0.01), 100)
    objective = Objective(scene, threads=1)
    x = objective.start()
    of_maps = slice(0, 5 * objective.pixels)
    noise = np.random.default_rng(0).normal(0, 0.1, of_maps.stop)
    x[of_maps] = np.clip(x[of_maps] + noise, 0.1, 0.9)  # clear of the bounds, for the sigmoid
    problem = Problem(scene, objective, x, light_unit=2.0)
    loss, gradient = objective.value_and_grad(x)
    assert float(problem.evaluate().detach()) == pytest.approx(loss, rel=1e-5)
    maps, lights = (unknown.grad.numpy().ravel() for unknown in problem.unknowns)
    m = x[of_maps]
    for found, expected in (
        (maps, gradient[of_maps] * m * (1 - m)),
        (lights, 2.0 * gradient[maps.size :]),
    ):
        assert np.linalg.norm(found - expected) <= 1e-4 * np.linalg.norm(expected)
    materials, lighting = problem.state()
    true, true_lights = objective.unpack(x)
    np.testing.assert_allclose(materials.albedo, true.albedo, atol=1e-6)
    np.testing.assert_allclose(lighting, true_lights, rtol=1e-5, atol=1e-6)


def record(task: Task, points: Any) -> tuple[Task, Record]:
    """Of a run with these checkpoints; of one that failed without."""
    found = {"points": points, "threads": 1, "load": 0.5}
    error = None if points else "OSError: full"
    return task, Record(task.key, found if points else None, error, 1.0)


def results(*curves: tuple[Point, ...] | None) -> Results[Task]:
    """Runs of "lbfgsb" on scenes of a case; None for one that failed."""
    tasks = [
        Task(CASES["noisy-128"], "lbfgsb", 100 + i, Budget(9, 9, 9.0)) for i in range(len(curves))
    ]
    return Results(options("noisy-128"), [*map(record, tasks, curves)])


def test_rows_take_medians_and_count_failures() -> None:
    slow = tuple({name: 3 * value for name, value in at.items()} for at in CURVE)
    found = results(CURVE, slow, None)
    row = next(row for row in figures.rows(found) if row.solver == "lbfgsb")
    assert row.status == "1 of 3 runs failed"
    assert row.metrics["albedo"] == pytest.approx(0.12)
    assert row.metrics["seconds"] == pytest.approx(8.0)
    assert row.metrics["seconds_to_near"] == pytest.approx(6.0)  # 2 and 3 · 2
    assert row.metrics["processor_to_near"] == pytest.approx(12.0)
    assert row.metrics["seconds_to_floor"] is None  # 0.004 is below all of them
    assert figures.rows(found)[-1].scenes == 0


def raced(**runs: tuple[Point, ...]) -> list[Verdict]:
    """Verdicts on one scene of 512², by the curve of each solver."""
    large, budget = CASES["clean-512"], Budget(9, 9, 9.0)
    pairs = [
        record(Task(large, name.replace("_", "-"), 100, budget), points)
        for name, points in runs.items()
    ]
    return list(figures.verdicts(Results(options("clean-512"), pairs), []))


def test_speed_is_against_the_sooner_of_ours_and_against_the_peer() -> None:
    verdicts = raced(
        lbfgsb_paper=(point(0, 0, 1, 0.5), point(50, 9, 9, 0.1)),
        lbfgsb=(point(0, 0, 1, 0.5), point(40, 5, 5, 0.1), point(60, 9, 9, 0.01)),
        gauss_newton=(point(0.5, 0, 1, 0.5), point(1, 3, 3, 0.09), point(5, 9, 9, 0.001)),
        torch_lbfgs=(point(0, 0, 1, 0.5), point(500, 9, 9, 0.11)),
    )
    found = {one.what.rpartition(" than ")[2].partition(",")[0]: one for one in verdicts}
    assert {what: (one.value, one.bar, one.holds) for what, one in found.items()} == {
        "lbfgsb": (40.0, 20.0, True),
        "torch": (500.0, 10.0, True),
    }
    assert found["torch"].where == "from 500 to 500; torch never reached it on 1: at least so much"
    never = raced(lbfgsb_paper=CURVE, gauss_newton=(point(2, 0, 1, 0.5),))
    assert [(verdict.value, verdict.holds) for verdict in never] == [(0.0, False)]
    assert not raced(gauss_newton=CURVE)
