"""Fits by a robust loss: what it gains where pictures have outliers, and its options."""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit.fit.objective import Objective
from pbrfit.fit.robust import CAUCHY_SCALE, MEDIAN_TO_SIGMA, irls_weights
from pbrfit.fit.settings import DEGREES_OF_FREEDOM_SHARE_MIN, NOISE_SIGMA_MIN
from pbrfit.result.options import ROBUST_LOSSES, SOLVERS, Solver
from pbrfit.synthetic import make_scene
from scene_files import truth_of
from scene_kinds import at_truth

ROBUST = ROBUST_LOSSES
NOISE = 0.01


def room(**options: Any) -> pbrfit.Scene:
    return make_scene("room", **{"size": 24, "lights": 8, "seed": 2002, "held_out": 2} | options)


def with_shadows(scene: pbrfit.Scene, share: float = 0.05) -> pbrfit.Scene:
    """The scene with some samples at 30 % of what they were."""
    hit = np.random.default_rng(0).random(scene.images.shape[:3]) < share
    return dataclasses.replace(scene, images=np.where(hit[..., None], 0.3, 1) * scene.images)


@cache
def shadows(seed: int = 2002) -> pbrfit.Scene:
    return with_shadows(room(noise=0.004, seed=seed))


@cache
def fit(case: str, robust: Any, seed: int = 2002) -> pbrfit.Result:
    """A scene with shadows, fitted as `CASES` says."""
    options: dict[str, Any] = {"refine_normals": "off", "uncertainty": False}
    return pbrfit.decompose(shadows(seed), robust=robust, **options, **CASES[case])


SEEDS = (2002, 2003, 2004)
MAPS = ("albedo_scaled_rmse", "roughness_rmse", "metallic_rmse")
CASES: dict[str, dict[str, Any]] = {
    "lbfgsb": {"solver": "lbfgsb", "iterations": 200, "priors": None},
    "lbfgsb, material prior": {"solver": "lbfgsb", "iterations": 120},
    "gauss-newton": {"solver": "gauss-newton", "priors": None},
    "gauss-newton, material prior": {"solver": "gauss-newton"},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("loss", [*ROBUST, "auto"])
def test_outliers_do_less_harm_than_to_squares(loss: str, case: str) -> None:
    """Means of three scenes: single ones of 24 x 24 pixels scatter by a fifth."""
    if loss == "auto" and "lbfgsb" in case:
        pytest.skip("squares")
    by_squares, robust = ([fit(case, name, seed) for seed in SEEDS] for name in ("none", loss))
    for name in MAPS:
        errors = [np.mean([one.metrics[name] for one in of]) for of in (robust, by_squares)]
        assert errors[0] < 0.9 * errors[1], name
    left = 0  # where they are: outliers; by default, if left-out pictures ask for it
    for one, other in zip(robust, by_squares, strict=True):
        left += one.metrics["recon_rmse"] > other.metrics["recon_rmse"]
        assert (one.options.robust, other.options.robust) == (loss, "none")
        if case == "lbfgsb":
            assert len(one.history) - 1 == 200
    assert left >= (2 if loss == "auto" else 3)


@pytest.mark.slow
def test_the_first_stage_is_by_squares() -> None:
    by_squares, robust = fit("lbfgsb", "none").history, fit("lbfgsb", "cauchy").history
    np.testing.assert_array_equal(robust["loss"][:61], by_squares["loss"][:61])
    assert robust["loss"][-1] < by_squares["loss"][-1]
    # Root of the robust loss, below that of the squares.
    assert robust["recon_rmse"][-1] < fit("lbfgsb", "cauchy").metrics["recon_rmse"]


@cache
def from_the_truth(solver: Solver, robust: Any) -> pbrfit.Result:
    scene = shadows()
    return pbrfit.decompose(
        scene,
        solver=solver,
        start=truth_of(scene).materials,
        iterations=60,
        priors=None,
        robust=robust,
        refine_normals="off",
        uncertainty=False,
    )


@pytest.mark.parametrize(
    ("loss", "solver"),
    [
        pytest.param(*pair, marks=[] if pair == ("cauchy", "lbfgsb") else pytest.mark.slow)
        for pair in product(ROBUST, SOLVERS)
    ],
)
def test_a_fit_from_a_given_start_becomes_robust_too(loss: Any, solver: Solver) -> None:
    fits = [from_the_truth(solver, name) for name in ("none", loss)]
    errors = [fit.metrics["albedo_rmse"] for fit in fits]
    assert errors[1] < 0.8 * errors[0]


def test_the_scale_is_that_of_the_noise() -> None:
    """At the truth nothing of the noise is taken up but by the unknowns' number, as if it were."""
    scene = room(noise=NOISE)
    objective = Objective(scene)
    x = at_truth(objective, scene)
    degrees = 1 - objective.size / objective.samples
    for name in ROBUST:
        loss = objective.robust_around(x, name)
        assert loss is not None
        sigma = NOISE / objective.scale / np.sqrt(degrees)
        assert loss[0] == name
        assert loss[1] == pytest.approx(CAUCHY_SCALE * sigma, rel=0.03)
    assert objective.robust_around(x, "none") is None


def test_perfectly_explained_pictures_have_a_scale() -> None:
    objective = Objective(room())
    x = at_truth(objective, room())
    assert objective.robust_around(x, "cauchy") == ("cauchy", CAUCHY_SCALE * NOISE_SIGMA_MIN)


def test_more_unknowns_than_samples_have_a_scale() -> None:
    scene = room(size=4, lights=2, noise=NOISE)
    objective = Objective(scene)
    assert objective.size > objective.samples
    x = np.clip(objective.start(), 0.1, None)
    residuals = objective.problem.residuals(x, np.arange(16, dtype=np.uint64))
    median = np.median(np.abs(residuals))
    expected = CAUCHY_SCALE * MEDIAN_TO_SIGMA * median / np.sqrt(DEGREES_OF_FREEDOM_SHARE_MIN)
    found = objective.robust_around(x, "cauchy")
    assert found is not None
    assert found[1] == pytest.approx(expected, rel=1e-6)
    result = pbrfit.decompose(scene, iterations=10, robust="cauchy")
    assert np.isfinite(result.albedo).all()


@pytest.mark.parametrize("free_normals", [False, True])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("name", ROBUST)
def test_reweighted_squares_have_the_gradient_of_the_loss(
    name: str, weighted: bool, free_normals: bool
) -> None:
    scene = with_shadows(room(size=12))
    if weighted:
        weights = np.random.default_rng(2).random(scene.images.shape[:3])
        scene = dataclasses.replace(scene, weights=np.where(weights < 0.1, 0, weights))
    objective = Objective(scene, free_normals=free_normals)
    x = np.clip(objective.start(), 0.01, None)
    squares, _ = objective.value_and_grad(x)
    assert objective.reweighted(x) is objective
    objective.robust = objective.robust_around(x, name)
    assert objective.robust is not None
    loss, gradient = objective.value_and_grad(x)
    assert loss < 0.9 * squares
    reweighted = objective.reweighted(x)
    assert reweighted.robust is None
    # Each is a mean, over sums of weights of its own.
    factors = irls_weights(
        objective.robust[1], objective.problem.residuals(x, np.arange(144, dtype="u8"))
    )
    if objective.weights is not None:
        factors *= objective.weights
    by_squares = reweighted.value_and_grad(x)[1] * factors.sum(dtype=float) / objective.total_weight
    np.testing.assert_allclose(by_squares, gradient, rtol=0, atol=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("weighted", [False, True])
def test_some_pixels_of_reweighted_squares_keep_their_weights(weighted: bool) -> None:
    scene = with_shadows(room(size=12))
    if weighted:
        weights = np.random.default_rng(2).random(scene.images.shape[:3])
        scene = dataclasses.replace(scene, weights=weights)
    objective = Objective(scene)
    x = np.clip(objective.start(), 0.01, None)
    objective.robust = objective.robust_around(x, "cauchy")
    everything = np.arange(144, dtype=np.uint64)
    whole = objective.reweighted(x)
    sums = whole.problem.normal_equations(x, everything)[2]
    few = np.arange(3, 144, 5, dtype=np.uint64)
    shares = np.linspace(0.1, 1, len(few))
    for share, expected in ((None, sums[few]), (shares, shares * sums[few])):
        part = whole.restricted(few, share)
        own = part.problem.normal_equations(whole.part_of(x, few), everything[: len(few)])[2]
        np.testing.assert_allclose(own, expected, rtol=1e-5)
    twice = whole.restricted(few, shares).restricted(np.array([2, 5], np.uint64))
    own = twice.problem.normal_equations(whole.part_of(x, few[[2, 5]]), everything[:2])[2]
    np.testing.assert_allclose(own, (shares * sums[few])[[2, 5]], rtol=1e-5)
