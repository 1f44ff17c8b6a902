"""The convergence suite: its scenes, its measures, its peers, its report and its command."""

from __future__ import annotations

import csv
import itertools
import json
import math
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
from pbrfit.scene.scene import Scene
from pbrfit.synthetic.lights import condition
from pbrfit_evaluation import convergence, summary
from pbrfit_evaluation.convergence import (
    FULL,
    QUICK,
    SOLVERS,
    Case,
    Curve,
    Effort,
    Task,
    measure,
    plots,
    report,
    solvers,
)
from pbrfit_evaluation.convergence.cases import LIGHTS, make, true_lighting
from pbrfit_evaluation.convergence.measure import (
    QUANTITIES,
    Errors,
    Point,
    Tracker,
    first_reached,
    median_reached,
    on_grid,
)
from pbrfit_evaluation.convergence.solvers import Budget, Solver

SMALL = Case("small", 12, 0.0, "typical")
TINY = Effort("tiny", (SMALL,), seeds=1, iterations=12, evaluations=12, seconds=60.0)


def errors(value: float) -> Errors:
    return Errors(*[value] * len(QUANTITIES))


CURVE = (
    Point(0.0, 0, 1, errors(0.5)),
    Point(1.0, 3, 4, errors(0.09)),
    Point(2.0, 6, 8, errors(0.02)),
    Point(4.0, 9, 16, errors(0.06)),
)
"""Falls below 0.05 and rises again."""


def curve(
    points: tuple[Point, ...] = CURVE,
    case: Case = SMALL,
    solver: str = "lbfgsb",
    seed: int = 100,
) -> Curve:
    return Curve(Task(case, solver, seed, Budget(9, 9, 9.0)), points, "done", 1000.0, 1, 0.5)


# Scenes


def test_condition_of_a_diagonal_light_matrix() -> None:
    lighting = np.zeros((16, 16, 3))
    lighting[range(16), range(16)] = 2.0
    lighting[0, 0, 1] = 50.0
    assert condition(lighting) == pytest.approx(25.0)


def test_conditioning_goes_from_near_the_best_to_nearly_singular() -> None:
    numbers = []
    for lights in LIGHTS:
        scene = make(replace(SMALL, lights=lights), seed=100)
        numbers.append(condition(true_lighting(scene)))
    assert numbers[0] < 60
    assert 300 < numbers[1] < 3000
    assert 3e3 < numbers[2] < 4e4
    assert numbers[3] == pytest.approx(10 * numbers[2], rel=0.3)


@pytest.mark.parametrize("lights", LIGHTS)
def test_pictures_are_those_of_the_lights(lights: Any) -> None:
    scene = make(replace(SMALL, lights=lights), seed=101)
    truth = scene.truth
    assert truth is not None
    rendered = pbrfit.render(truth.materials, scene.normals, true_lighting(scene), scene.fov)
    np.testing.assert_allclose(scene.images, rendered, rtol=1e-12, atol=1e-14)
    assert scene.images.mean() == pytest.approx(0.4)
    assert scene.images.min() > 0


def test_lights_are_positive_in_every_direction() -> None:
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    basis = pbrfit.sh_basis(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    for lights in LIGHTS:
        scene = make(replace(SMALL, lights=lights), seed=102)
        radiance = np.einsum("dk,nkc->dnc", basis, true_lighting(scene))
        assert radiance.min() >= -1e-12


def test_noise_is_a_share_of_the_mean_radiance() -> None:
    clean, noisy = (make(Case("c", 24, noise, "alike"), 100) for noise in (0.0, 0.02))
    assert np.std(noisy.images - clean.images) == pytest.approx(0.02 * 0.4, rel=0.02)
    np.testing.assert_array_equal(true_lighting(noisy), true_lighting(clean))
    np.testing.assert_array_equal(noisy.images, make(Case("c", 24, 0.02, "alike"), 100).images)


def test_unknown_lights_are_refused() -> None:
    with pytest.raises(pbrfit.InputError, match="lights: expected one of spread"):
        make(replace(SMALL, lights="dark"), 0)  # type: ignore[arg-type]


# Measures


def test_truth_has_no_errors_and_known_changes_have_known_ones() -> None:
    scene = make(SMALL, 100)
    assert scene.truth is not None
    true, lighting = scene.truth.materials, true_lighting(scene)
    assert max(measure.measure(scene, true, lighting).__dict__.values()) < 1e-12
    found = measure.measure(scene, replace(true, albedo=0.5 * true.albedo), lighting)
    assert found.albedo_scaled == pytest.approx(0.0, abs=1e-12)
    assert found.albedo == pytest.approx(0.5 * math.sqrt(np.mean(true.albedo**2)))
    assert found.roughness == found.metallic == 0.0
    halved = measure.measure(scene, true, 0.5 * lighting)
    assert halved.recon == pytest.approx(0.5 * math.sqrt(np.mean(scene.images**2)))
    assert halved.relight == pytest.approx(0.0, abs=1e-12)  # not under the lights that were found


def test_measuring_needs_a_truth() -> None:
    scene = make(SMALL, 100)
    assert scene.truth is not None
    with pytest.raises(pbrfit.InputError, match="ground truth"):
        measure.measure(replace(scene, truth=None), scene.truth.materials, true_lighting(scene))


def test_checkpoints_are_spread_evenly_over_the_logarithm() -> None:
    scene = make(SMALL, 100)
    assert scene.truth is not None
    state = scene.truth.materials, true_lighting(scene)
    tracker = Tracker(scene, threads=1)
    for evaluations in range(1, 101):
        tracker.visit(0.5 * evaluations, evaluations - 1, evaluations, lambda: state)
    tracker.end(60.0, 99, 100, lambda: state)
    seen = [point.evaluations for point in tracker.points]
    assert seen[:9] == [1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert seen[-1] == 100
    assert len(seen) == len(set(seen))
    assert max(b / a for a, b in itertools.pairwise(seen[8:])) < 1.25
    assert tracker.points[-1].seconds == 60.0


def test_time_to_an_error_by_hand() -> None:
    at = first_reached(CURVE, "albedo", 0.1)
    assert (at.seconds, at.evaluations, at.kept) == (1.0, 4, True)
    at = first_reached(CURVE, "albedo", 0.05)
    assert (at.seconds, at.evaluations, at.kept) == (2.0, 8, False)
    at = first_reached(CURVE, "albedo", 0.02)
    assert at.seconds == 2.0  # at the threshold is reached
    at = first_reached(CURVE, "albedo", 0.019)
    assert (at.seconds, at.evaluations, at.kept) == (None, None, False)


def test_an_error_that_is_no_number_reaches_nothing() -> None:
    assert first_reached([Point(0, 0, 1, errors(math.nan))], "recon", 1.0).seconds is None


def test_median_counts_never_as_late() -> None:
    assert median_reached([]) is None
    assert median_reached([3.0]) == 3.0
    assert median_reached([3.0, None, 1.0]) == 3.0
    assert median_reached([None, None, 1.0]) is None
    assert median_reached([1.0, 2.0]) == 2.0
    assert median_reached([1.0, None]) is None


def test_curves_on_a_grid_by_hand() -> None:
    grid = np.array([0.5, 1.0, 10.0, 100.0, 1000.0])
    found = on_grid(grid, [1.0, 100.0], [1.0, 1e-2])
    np.testing.assert_allclose(found, [np.nan, 1.0, 0.1, 1e-2, 1e-2])


def test_points_survive_a_record() -> None:
    assert [Point.from_row(json.loads(json.dumps(p.as_row()))) for p in CURVE] == list(CURVE)


# Solvers


def test_the_solver_tells_its_state_with_the_clock_stopped() -> None:
    scene = make(SMALL, 100)
    tracker = Tracker(scene, threads=1)
    solvers.fit_with_ours(scene, Budget(8, 0, 60.0), tracker, 1)
    result = pbrfit.decompose(
        scene, solver="lbfgsb", iterations=8, threads=1, priors=None, refine_normals="off"
    )
    for point in tracker.points:
        row = list(result.history["iteration"]).index(point.iteration)
        assert point.evaluations == result.history["evaluations"][row]
        assert point.errors.albedo == pytest.approx(result.history["albedo_rmse"][row])
        assert point.errors.recon == pytest.approx(result.history["recon_rmse"][row], rel=1e-3)
    last = tracker.points[-1].errors
    assert last.relight == pytest.approx(result.metrics["relight_rmse"])
    assert last.albedo_scaled == pytest.approx(result.metrics["albedo_scaled_rmse"])
    seconds = [point.seconds for point in tracker.points]
    assert seconds == sorted(seconds)


def test_given_start_is_the_default_one() -> None:
    scene = make(SMALL, 100)
    one_stage = Tracker(scene, threads=1)
    solvers.by_name("lbfgsb-one-stage").run(scene, Budget(1, 0, 60.0), one_stage, 1)
    staged = Tracker(scene, threads=1)
    solvers.by_name("lbfgsb").run(scene, Budget(1, 0, 60.0), staged, 1)
    assert one_stage.points[0].errors.recon == pytest.approx(staged.points[0].errors.recon)


def test_known_lights_are_the_true_ones() -> None:
    scene = make(SMALL, 100)
    tracker = Tracker(scene, threads=1)
    solvers.by_name("lbfgsb-known-lights").run(scene, Budget(0, 0, 60.0), tracker, 1)
    start, _ = Objective(scene).unpack(Objective(scene).start())
    rendered = pbrfit.render(start, scene.normals, true_lighting(scene), scene.fov)
    assert tracker.points[0].errors.recon == pytest.approx(metrics.rmse(rendered, scene.images))


def test_unknown_solver_is_refused() -> None:
    with pytest.raises(pbrfit.InputError, match="solver: expected one of lbfgsb, "):
        solvers.by_name("magic")


def test_a_solver_that_needs_what_is_absent_is_not_planned(monkeypatch: Any) -> None:
    absent = Solver("other", "other", "needs much", SOLVERS[0].run, needs=("no_such_package",))
    assert absent.missing == "not run: no_such_package is not installed"
    monkeypatch.setattr(convergence, "SOLVERS", (SOLVERS[0], absent))
    assert {task.solver for task in convergence.plan(TINY)} == {"lbfgsb"}
    monkeypatch.setattr(report, "SOLVERS", (SOLVERS[0], absent))
    ours, other = report.groups(TINY, [curve()], seeds=1)
    assert ours.status == "ok"
    assert (other.status, other.metrics()) == (absent.missing, {})


def test_plans_have_unique_names_and_reported_seeds() -> None:
    for effort in (QUICK, FULL):
        tasks = convergence.plan(effort, 10)
        assert len({task.key for task in tasks}) == len(tasks)
        assert {task.seed for task in tasks} == set(range(100, 110))
    budgets = {task.case.size: task.budget.seconds for task in convergence.plan(FULL)}
    assert budgets[128] == 4 * budgets[64] == 4 * budgets[32]


# Peers


def view_of(scene: Scene) -> Any:
    from pbrfit_evaluation.convergence.torch_peer import Problem, Settings

    def problem(settings: Settings) -> Problem:
        objective = Objective(scene, threads=1)
        return Problem(scene, objective, inside(objective), settings)

    return problem


def inside(objective: Objective) -> Any:
    """A point clear of the bounds, so that a sigmoid can say it."""
    x = objective.start()
    maps = slice(0, 5 * objective.pixels)
    x[maps] = np.clip(x[maps] + np.random.default_rng(0).normal(0, 0.1, maps.stop), 0.1, 0.9)
    return x


@pytest.mark.parametrize("bounds", ["sigmoid", "clamp"])
def test_torch_loss_and_gradient_are_ours(bounds: Any) -> None:
    pytest.importorskip("torch")
    from pbrfit_evaluation.convergence.torch_peer import Settings

    scene = make(Case("c", 16, 0.01, "typical"), 100)
    problem = view_of(scene)(Settings("adam", bounds, rate=0.1, light_unit=2.0))
    objective = Objective(scene, threads=1)
    x = inside(objective)
    loss, gradient = objective.value_and_grad(x)
    assert float(problem.evaluate().detach()) == pytest.approx(loss, rel=1e-5)
    maps, lights = (unknown.grad.numpy().ravel() for unknown in problem.unknowns)
    m = x[: maps.size]
    slope = m * (1 - m) if bounds == "sigmoid" else 1.0
    for found, expected in (
        (maps, gradient[: maps.size] * slope),
        (lights, 2.0 * gradient[maps.size :]),
    ):
        assert np.linalg.norm(found - expected) <= 1e-4 * np.linalg.norm(expected)
    found, lighting = problem.state()
    true, true_lighting = objective.unpack(x)
    np.testing.assert_allclose(found.albedo, true.albedo, atol=1e-6)
    np.testing.assert_allclose(lighting, true_lighting, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["torch-lbfgs", "torch-adam"])
def test_torch_optimisers_descend_and_count(name: str) -> None:
    pytest.importorskip("torch")
    scene = make(SMALL, 100)
    tracker = Tracker(scene, threads=1)
    reason = solvers.by_name(name).run(scene, Budget(0, 60, 60.0), tracker, 1)
    first, last = tracker.points[0], tracker.points[-1]
    assert first.evaluations == 1
    assert 60 <= last.evaluations <= 90
    assert reason.startswith(str(last.evaluations))
    assert last.errors.recon < 0.5 * first.errors.recon
    assert all(np.isfinite(point.as_row()).all() for point in tracker.points)


def test_torch_adam_may_clamp() -> None:
    pytest.importorskip("torch")
    from pbrfit_evaluation.convergence import torch_peer

    scene = make(SMALL, 100)
    tracker = Tracker(scene, threads=1)
    settings = torch_peer.Settings("adam", "clamp", rate=0.3)
    torch_peer.fit(scene, settings, torch_peer.Limits(5, 60.0), tracker, 1)
    assert [point.evaluations for point in tracker.points] == [1, 2, 3, 4, 5]


def test_time_limit_ends_a_peer() -> None:
    pytest.importorskip("torch")
    scene = make(SMALL, 100)
    for name in ("torch-lbfgs", "torch-adam"):
        reason = solvers.by_name(name).run(scene, Budget(0, 10**6, 0.0), Tracker(scene, 1), 1)
        assert "time limit" in reason


# Report


def test_times_say_what_was_not_reached_and_what_is_below_the_noise() -> None:
    noisy = replace(SMALL, noise=0.01)  # 0.004
    rows = [dict(zip(report.TIME_COLUMNS, row, strict=True)) for row in report.time_rows(
        [curve(case=noisy)]
    )]  # fmt: skip
    status = {(row["quantity"], row["target"]): row["status"] for row in rows}
    assert status["albedo", 0.1] == status["albedo", 0.02] == "reached"
    assert status["albedo", 0.01] == status["recon", 1e-2] == "not reached"
    assert status["recon", 3e-3] == "below the noise"
    assert {row["kept"] for row in rows if row["target"] == 0.02} == {"no"}


def test_groups_take_medians_and_count_failures() -> None:
    low, high = (
        curve(tuple(Point(f * p.seconds, p.iteration, p.evaluations, errors(f * p.errors.albedo))
                    for p in CURVE), seed=seed)
        for f, seed in ((1.0, 100), (3.0, 101))
    )  # fmt: skip
    group = report.groups(TINY, [low, high], seeds=3)[0]
    assert group.status == "1 of 3 runs failed"
    found = group.metrics()
    assert found["albedo"] == pytest.approx(0.12)
    assert found["seconds"] == pytest.approx(8.0)
    assert group.time_to("albedo", 0.1) == (6.0, 2)
    assert group.time_to("albedo", 0.05) == (None, 1)


def test_plots_are_drawn_for_several_seeds_and_for_one() -> None:
    for curves in ([curve()], [curve(), curve(CURVE[:3], seed=101)]):
        assert plots.draw(curves, "recon").startswith(b"\x89PNG")


def run(*arguments: object) -> int:
    return main([str(argument) for argument in ("evaluate", "convergence", *arguments)])


def test_command_writes_curves_times_summary_and_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(convergence, "QUICK", TINY)
    monkeypatch.setattr(plots, "draw", lambda _curves, quantity: quantity.encode())
    out = tmp_path / "out"
    assert run("--out", out, "--quick", "--quiet") == 0
    assert capsys.readouterr().out == ""
    with (out / report.CURVES).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == report.CURVE_COLUMNS
    able = [solver for solver in SOLVERS if not solver.missing]
    assert {row["solver"] for row in rows} == {solver.name for solver in able}
    assert all(float(row["recon"]) > 0 for row in rows)
    with (out / report.TIMES).open(newline="", encoding="utf-8") as file:
        times = list(csv.DictReader(file))
    assert tuple(times[0]) == report.TIME_COLUMNS
    assert len(times) == len(able) * sum(map(len, measure.TARGETS.values()))
    for row in times:
        assert (row["status"] == "reached") == bool(row["seconds"]) == bool(row["evaluations"])
    content = json.loads((out / summary.FILE).read_text(encoding="utf-8"))
    assert content["protocol"] == f"{report.PROTOCOL}, tiny"
    status = {row["solver"]: row["status"] for row in content["rows"]}
    assert status == {solver.name: solver.missing or "ok" for solver in SOLVERS}
    last = [row for row in rows if row["solver"] == "lbfgsb"][-1]
    assert content["rows"][0]["metrics"]["albedo"] == pytest.approx(float(last["albedo"]))
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "lbfgsb-paper" in page
    for quantity in QUANTITIES:
        assert (out / f"{quantity}.png").read_bytes() == quantity.encode()

    assert run("--out", out, "--quick", "--quiet") == 2  # it is there
    assert "expected a folder that does not exist yet" in capsys.readouterr().err
    before = (out / report.CURVES).read_bytes()
    assert run("--out", out, "--quick", "--resume") == 0
    assert (out / report.CURVES).read_bytes() == before  # times and all: nothing was run again
    assert "12², no noise, lights typical" in capsys.readouterr().out


def test_too_many_seeds_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--out", tmp_path / "out", "--seeds", 101) == 2
    assert "--seeds: expected at most 100, found 101" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_materials_beyond_their_range_by_a_rounding_are_measured() -> None:
    scene = make(SMALL, 100)
    assert scene.truth is not None
    true = scene.truth.materials
    beyond = Materials(true.albedo, true.roughness, np.full_like(true.metallic, 1.0 + 1e-7))
    assert math.isfinite(measure.measure(scene, beyond, true_lighting(scene)).recon)
