"""The calibration suite: its refits against a general solver, its bars, its command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import Bounds, minimize
from threadpoolctl import threadpool_limits

from evaluation_tasks import recorded
from pbrfit.fit.objective import Objective
from pbrfit_evaluation import uncertainty as suite
from pbrfit_evaluation.suite import Results
from pbrfit_evaluation.uncertainty import refits
from pbrfit_evaluation.uncertainty.figures import figures, verdicts
from pbrfit_evaluation.uncertainty.measure import LIGHTS, Lights, Task, inside
from scene_files import run

Array = NDArray[np.float64]

NOISE = 0.002


def noisy(lights: Lights, size: int) -> tuple[Objective, Array, float]:
    """An objective with noise, the ground truth as x, and the noise in units of x."""
    scene = inside(Task(lights, "room", size, 6, NOISE, 2, 2005))
    assert scene.truth is not None
    rng = np.random.default_rng(7)
    images = scene.images + rng.normal(scale=NOISE, size=scene.images.shape)
    objective = Objective(replace(scene, images=images), threads=1)
    true = scene.truth.materials
    x = objective.pack(true.albedo, true.roughness, true.metallic, scene.truth.lighting)
    return objective, x, NOISE / objective.scale


def lowered(objective: Objective, x: Array) -> float:
    """Sum of squares that L-BFGS-B gets to from x."""
    answer = minimize(
        objective.value_and_grad,
        x,
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(*objective.bounds.T),
        options={"maxiter": 100, "ftol": 0, "gtol": 0},
    )
    return float(answer.fun) * objective.total_weight


@pytest.mark.parametrize("lights", LIGHTS)
def test_another_solver_gets_no_lower_than_refits(lights: Lights) -> None:
    objective, x, sigma = noisy(lights, 10)
    maps = objective.layout.maps
    pixels = np.arange(objective.pixels, dtype=np.uint64)
    found = x.copy()
    if lights == "known":
        refit = refits.with_known_lights(objective, x, pixels, sigma)
        assert refit.converged.all()
        found[maps] = refit.values.T.ravel()
        sum_sq_residuals = float(refit.sum_sq_residuals.sum())
    else:
        with threadpool_limits(1):  # as suites run
            found, converged, sum_sq_residuals = refits.with_free_lights(objective, x, sigma)
        assert converged
    loss, _ = objective.value_and_grad(found)
    assert sum_sq_residuals == pytest.approx(loss * objective.total_weight, rel=1e-5)
    tolerance = 0.1 * sigma**2
    assert lowered(objective, x) > sum_sq_residuals - tolerance
    assert lowered(objective, found) > sum_sq_residuals - tolerance
    # A little away from the minimum it does get lower.
    away = np.clip(found[maps] + np.where(found[maps] < 0.5, sigma, -sigma), 0, 1)
    start = np.concatenate([away, found[maps.stop :]])
    before = objective.value_and_grad(start)[0] * objective.total_weight
    assert lowered(objective, start) < before - 10 * tolerance


def test_pixels_that_have_not_converged_are_said() -> None:
    objective, x, sigma = noisy("known", 4)
    pixels = np.arange(objective.pixels, dtype=np.uint64)
    assert not refits.with_known_lights(objective, x, pixels, sigma, steps=1).converged.any()


def results(ratios: Array, lights: Lights = "known") -> Results[Task]:
    """Those of a scene with deviations of so many times the predicted, (Q,)."""
    predicted = np.full((len(ratios), 5), 0.01)
    arrays = {
        "predicted": predicted,
        "predicted_by_fit": predicted,
        "found": ratios[:, None] * predicted,
        "bias": 0 * predicted,
    }
    numbers = dict.fromkeys(("compared", "converged", "variance", "albedo_scale"), 1.0)
    values = {name: array.tolist() for name, array in arrays.items()} | numbers
    return recorded((Task(lights, "room", 8, 8, 0.01, 9, 2000), values))


@pytest.mark.parametrize(
    ("lights", "ratios", "holds"),
    [
        ("known", [1.0], True),
        ("known", [0.89], False),
        ("known", [1.11], False),
        ("known", [1.0] * 9 + [1.3], True),
        ("known", [1.0] * 8 + [1.3] * 2, False),
        ("known", [], False),
        ("free", [0.81], True),
        ("free", [0.79], False),
        ("free", [1.24], True),
        ("free", [1.26], False),
    ],
)
def test_bars(lights: Lights, ratios: list[float], holds: bool) -> None:
    found = results(np.array(ratios), lights)
    [row] = figures(found)
    assert (row.status == "ok") == holds
    assert all(verdict.holds for verdict in verdicts(found, [row])) == holds
    if ratios:
        assert row.metrics["median"] == pytest.approx(np.median(ratios))


def test_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(suite.SETUPS, "quick", {"known": (8, 16, 60), "free": (8, 8, 4)})
    monkeypatch.setitem(suite.NOISE, "quick", {"known": (0.002,), "free": (1e-4,)})
    out = tmp_path / "uncertainty"
    options = ("--quick", "--jobs", 1, "--first-seed", 2005)
    code = run("evaluate", "uncertainty", "--out", out, *options)
    assert "lights known, noise 0.002" in capsys.readouterr().out
    rows = json.loads((out / "summary.json").read_text(encoding="utf-8"))["rows"]
    assert code == (0 if all(row["status"] == "ok" for row in rows) else 1)
    known, free = (row["metrics"] for row in rows)
    assert rows[0]["status"] == "ok"
    assert known["converged"] == free["converged"] == 1
    assert 0.9 < known["median"] < 1.1
    assert known["variance"] == pytest.approx(1, abs=0.05)
    assert free["values"] > 0
    assert 0.2 < free["median"] < 2
    for name in ("report.html", "uncertainty.md"):
        assert "lights free, noise 0.0001" in (out / name).read_text(encoding="utf-8")
