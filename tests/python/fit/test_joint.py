"""Joint steps of lights, materials and offsets of clusters, and pixels that are tried again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

import pbrfit
from pbrfit import Objective, Scene
from pbrfit.fit import settings
from pbrfit.fit.joint import JointFit, SharedFit, minimize
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.normal_equations import as_in_x
from pbrfit.fit.pixels import fit_all, place, retry_outliers, taken
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from scene_files import known
from scene_kinds import FREE_LIGHTS, all_pixels, at_truth, objective_of, sum_sq_at

EXACT = 1e-7
"""Root mean square of residuals where pictures are rounded to float32, at mean radiance 0.4."""

PRIORS = ("alone", "prior", "clusters")
each_prior = pytest.mark.parametrize("priors", PRIORS)
each_kind = pytest.mark.parametrize("kind", FREE_LIGHTS)


@pytest.fixture(scope="module")
def room() -> Scene:
    return make_scene("room", size=24, lights=8, seed=2000, held_out=2)


@pytest.fixture(scope="module")
def noisy() -> Scene:
    return make_scene("room", size=18, lights=6, noise=0.01, seed=2001, held_out=2)


def fitted(objective: Objective, x: Array, prior: GaussianPrior | None = None) -> Array:
    """Sums of squares when all pixels of x have their best materials."""
    return known(fit_all(objective, x, starts=2, steps=100, prior=prior))


def joint_fit(objective: Objective, priors: str = "alone", **options: Any) -> JointFit:
    """From the start, with all priors on lights, pixels at their best."""
    rng = np.random.default_rng(3)
    x, prior, fixed = objective.start(), None, None
    blocks = objective.layout.roughness_metallic
    if priors != "alone":
        mean = rng.uniform(0.2, 0.8, (objective.pixels, len(blocks)))
        cluster = rng.permutation(np.arange(objective.pixels) % 5) if priors == "clusters" else None
        prior = GaussianPrior(mean, rng.uniform(0.01, 0.05, mean.shape), cluster, blocks)
        fixed = prior.held(x)
    sum_sq = fitted(objective, x, fixed)
    lights = replace(LightPrior.around(objective, x), noise=1e-4, grey=1e-5)
    return JointFit(objective, x, sum_sq, SharedFit(lights), prior, **options)


def settled(fit: JointFit) -> JointFit:
    """Of those pixels that are at their best; a few on bounds stop before."""
    objective, x, prior = fit.objective, fit.x, fit.pixel_prior(fit.offsets)
    fitted(objective, x, prior)
    _, slope, sum_sq = objective.problem.normal_equations(
        objective.for_core(x), all_pixels(objective)
    )
    values, c = taken(objective, x, slice(None)), objective.channels
    if prior is not None:
        slope[:, c:] += prior.precision * (values[:, c:] - prior.mean)
    held = ((values <= 0) & (slope > 0)) | ((values >= 1) & (slope < 0))
    at_best = np.abs(np.where(held, 0, slope)).max(axis=1) < 1e-5
    assert np.mean(at_best) > 0.9
    chosen = np.flatnonzero(at_best).astype(np.uint64)
    few, part, prior = objective.restricted(chosen), objective.part_of(x, chosen), fit.prior
    if prior is not None:
        cluster = None if prior.cluster is None else prior.cluster[chosen]
        blocks = few.layout.roughness_metallic
        prior = GaussianPrior(prior.mean[chosen], prior.precision[chosen], cluster, blocks)
    found = JointFit(few, part, sum_sq[at_best], fit.shared, prior)
    found.offsets = fit.offsets
    return found


def moved(fit: JointFit, by: Array) -> float:
    """The sum when what is shared moves, and materials stay."""
    end = fit.lights.mean.size
    x, offsets = fit.x.copy(), fit.offsets
    x[fit.objective.layout.lighting] += as_in_x(by[:end], fit.objective.layout)
    if offsets is not None:
        offsets = offsets + by[end:].reshape(offsets.shape)
    return fit.total(x, sum_sq_at(fit.objective, x), offsets)


def gradient_of(fit: JointFit) -> Array:
    """What the solver of the step is given."""
    system = known(fit._system())
    return system[0]


@each_prior
@each_kind
def test_where_pixels_are_at_their_best_the_gradient_is_that_of_the_sum(
    noisy: Scene, kind: str, priors: str
) -> None:
    """The sum is quadratic in lights and offsets, so differences are exact."""
    fit = settled(joint_fit(objective_of(noisy, kind), priors))
    found = gradient_of(fit)
    rng = np.random.default_rng(4)
    for block in (slice(0, fit.lights.mean.size), slice(fit.lights.mean.size, len(found))):
        for _ in range(3 * (block.stop > block.start)):
            direction = np.zeros(len(found))
            direction[block] = rng.normal(size=block.stop - block.start)
            slope = (moved(fit, direction) - moved(fit, -direction)) / 4
            size = float(np.linalg.norm(found[block]) * np.linalg.norm(direction))
            assert found @ direction == pytest.approx(slope, abs=1e-4 * size)


@each_prior
@each_kind
def test_conjugate_gradients_solve_the_dense_system(
    noisy: Scene, kind: str, priors: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a preconditioner of few pixels."""
    monkeypatch.setattr(settings, "COARSE_PIXELS", 200)
    monkeypatch.setattr(settings, "CG_ITERATIONS_MAX", 1000)
    monkeypatch.setattr(settings, "CG_ERROR_RATIO", 1e-9)
    fit = joint_fit(objective_of(noisy, kind), priors)
    fit.damping = 1e-3
    everything = all_pixels(fit.objective)
    options = fit.options(fit.objective, fit.x, everything, everything)
    matrix, _ = fit.objective.problem.schur_complement(
        fit.objective.for_core(fit.x), everything, **options
    )
    end = fit.lights.mean.size
    matrix[:end, :end] += fit.lights.matrix()
    if fit.offsets is not None:
        own = settings.OFFSET_PRECISION_SHARE * known(fit.prior).cluster_precision
        np.einsum("ii->i", matrix)[end:] += own.ravel()
    gradient = gradient_of(fit)
    expected = -np.linalg.solve(matrix, gradient)
    moves, predicted = fit.shared_moves(0.0)
    error = moves - expected
    assert error @ matrix @ error < 1e-8 * (expected @ matrix @ expected)
    assert predicted == pytest.approx(-(gradient @ expected), rel=1e-6)


@each_prior
@each_kind
def test_each_step_lowers_the_sum(noisy: Scene, kind: str, priors: str) -> None:
    fit = joint_fit(objective_of(noisy, kind), priors)
    totals = [fit.total(fit.x, fit.sum_sq, fit.offsets)]

    def visit(x: Array, sum_sq: Array) -> bool:
        maps = x[fit.objective.layout.maps]
        assert maps.min() >= 0
        assert maps.max() <= 1
        np.testing.assert_allclose(sum_sq, sum_sq_at(fit.objective, x), rtol=1e-6)
        totals.append(fit.total(x, sum_sq, fit.offsets))
        return len(totals) > 4

    assert minimize(fit, 10, settings.GAIN_MIN, visit) == len(totals) - 1 > 1
    assert (np.diff(totals) < 0).all()


def test_planted_lights_are_found(room: Scene) -> None:
    """But for a scale of each channel, which pictures do not tell."""
    objective = Objective(room)
    true, rng = at_truth(objective, room), np.random.default_rng(6)
    x, lights = true.copy(), objective.layout.lighting
    assert lights is not None
    x[lights] *= rng.uniform(0.9, 1.1, x[lights].shape)
    shared = SharedFit(LightPrior.around(objective, x))
    fit = JointFit(objective, x, fitted(objective, x), shared)
    minimize(fit, 60, 0.0)
    assert fit.sum_sq.sum() <= EXACT**2 * objective.total_weight
    found, planted = (of[lights].reshape(8, 16, 3) for of in (x, true))
    scale = (found * planted).sum(axis=(0, 1)) / (found**2).sum(axis=(0, 1))
    np.testing.assert_allclose(found * scale, planted, rtol=0, atol=1e-5 * np.abs(planted).max())


def test_a_pixel_in_a_wrong_minimum_is_freed(room: Scene) -> None:
    objective = Objective(room)
    x = at_truth(objective, room)
    caught = np.random.default_rng(4).permutation(objective.pixels)[:30].astype(np.uint64)
    wrong = taken(objective, x, caught)
    wrong[:, 3:] = 1 - np.round(wrong[:, 3:])  # rough for smooth, metal for none
    place(objective, x, caught, wrong)
    sum_sq = known(fit_all(objective, x, starts=0))
    still = caught[sum_sq[caught] > EXACT**2 * 36]
    assert len(still) >= 5  # a descent alone does not free all
    searched = np.isin(np.arange(objective.pixels), still[::2])
    place(objective, x, caught, wrong)
    sum_sq = known(fit_all(objective, x, starts=searched))
    np.testing.assert_array_equal(sum_sq[still] <= EXACT**2 * 36, searched[still])
    retry_outliers(objective, x, sum_sq)
    assert sum_sq[still].max() <= EXACT**2 * 36
    np.testing.assert_allclose(x, at_truth(objective, room), atol=1e-4)


@pytest.mark.parametrize("normals", ["off", "on"])
def test_progress_is_told_of_every_joint_step(room: Scene, normals: Literal["off", "on"]) -> None:
    seen: list[pbrfit.Progress] = []
    states: list[tuple[pbrfit.Materials, Array]] = []

    def progress(now: pbrfit.Progress) -> None:
        seen.append(now)
        states.append(now.state())

    options: dict[str, Any] = {"priors": None, "light": "sh", "robust": "none"}
    result = pbrfit.decompose(room, refine_normals=normals, progress=progress, **options)
    told = [now.iteration for now in seen]
    steps = told.count(0)  # of some pixels, and the start
    assert steps > 3
    assert told == [0] * (steps - 1) + list(range(result.history.iterations + 1))
    assert seen[-1].recon_rmse < 1e-3 * seen[0].recon_rmse
    assert all(np.diff([now.elapsed_s for now in seen]) >= 0)
    for materials, lighting in states:
        assert np.isfinite(materials.albedo).all()
        assert np.isfinite(lighting).all()
    np.testing.assert_array_equal(states[-1][0].roughness, result.roughness)
