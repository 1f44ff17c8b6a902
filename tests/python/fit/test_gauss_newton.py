"""The stages of Gauss-Newton: lights from some pixels, all pixels, joint steps, priors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit import Objective, Scene
from pbrfit.fit import settings
from pbrfit.fit.gauss_newton import (
    LightEstimate,
    find_lights,
    fit_materials,
    fit_with_prior,
    global_gauss_newton,
)
from pbrfit.fit.gauss_newton.normal_equations import Cholesky
from pbrfit.fit.gauss_newton.pixels import fit_all, put, retry_outliers, taken
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.material import fit_prior
from pbrfit.model.reflection import MODELS, Model
from pbrfit.synthetic import make_scene
from scene_kinds import (
    FREE_LIGHTS,
    all_pixels,
    at_truth,
    known_lights,
    objective_of,
    of_kind,
    sum_sq_at,
)

Array = NDArray[np.float64]
Pixels = NDArray[np.uint64]

EXACT = 1e-7
"""Root mean square of residuals where pictures are rounded to float32, at mean radiance 0.4."""


class Watch:
    """Counts, and stops after so many visits, or calls that ask about time."""

    def __init__(self, visits: float = np.inf, asked: float = np.inf) -> None:
        self.visits, self.asked = visits, asked
        self.shares: list[float] = []
        self.sum_sq: list[float] = []
        self.materials: list[Array] = []
        self.lights: list[Array] = []

    def stop(self) -> bool:
        self.asked -= 1
        return self.asked < 0

    def _done(self) -> bool:
        return len(self.shares) + len(self.sum_sq) >= self.visits

    def visit_few(self, pixels: Pixels, materials: Array, lights: Array, share: float) -> bool:
        assert len(pixels) == len(materials)
        self.shares.append(share)
        self.materials.append(materials)
        self.lights.append(lights)
        return self._done()

    def visit(self, x: Array, sum_sq: Array) -> bool:
        assert ((x[:1] >= 0) & (x[:1] <= 1)).all()
        self.sum_sq.append(float(sum_sq.sum()))
        return self._done()


@pytest.fixture(scope="module")
def room() -> Scene:
    return make_scene("room", size=32, lights=12, seed=2000, held_out=2)


@pytest.fixture(scope="module")
def noisy() -> Scene:
    return make_scene("room", size=24, lights=8, noise=0.01, seed=2001, held_out=2)


def lights_of(objective: Objective, watch: Watch | None = None, seed: int = 0) -> LightEstimate:
    """Lights from some pixels."""
    return find_lights(objective, objective.start(), watch or Watch(), seed)


def fitted(objective: Objective, watch: Watch | None = None) -> tuple[Array, Array]:
    """X of a fit of the squares, and the pixels' sums of them."""
    x = lights_of(objective, watch).x
    sum_sq = fit_materials(objective, x, watch or Watch())
    assert sum_sq is not None
    return x, sum_sq


def fitted_pixels(objective: Objective, x: Array, starts: int) -> Array:
    """Sums of squares when all pixels of x have their best materials."""
    sum_sq = fit_all(objective, x, starts=starts)
    assert sum_sq is not None
    return sum_sq


# --- Some pixels stand for all ---


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("free_normals", [False, True])
@pytest.mark.parametrize("kind", FREE_LIGHTS)
def test_the_objective_of_some_pixels_is_a_part_of_the_whole_one(
    noisy: Scene, kind: str, free_normals: bool, model: Model
) -> None:
    scene, options = of_kind(noisy, kind)
    objective = Objective(scene, **options, free_normals=free_normals, model=model)
    rng = np.random.default_rng(1)
    chosen = np.sort(rng.permutation(objective.pixels)[:100]).astype(np.uint64)
    x = objective.start()
    x[objective.layout.maps] = rng.uniform(0, 1, objective.layout.maps.stop)
    few, part = objective.restricted(chosen), objective.part_of(x, chosen)
    assert few.size == len(part)
    assert (few.pixels, few.model) == (100, model)
    np.testing.assert_array_equal(taken(few, part, slice(None)), taken(objective, x, chosen))
    np.testing.assert_array_equal(part[few.layout.lighting], x[objective.layout.lighting])
    np.testing.assert_array_equal(few.normals(part), objective.normals(x)[chosen.astype(int)])
    for one, other in zip(
        few.problem.normal_equations(few.for_core(part), all_pixels(few)),
        objective.problem.normal_equations(objective.for_core(x), chosen),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())
    # The same units: a mean over pixels whose weights are a share of all.
    loss = few.data_value_and_grad(part)[0]
    assert few.total_weight == pytest.approx(objective.total_weight * 100 / objective.pixels)
    if objective.weights is None:
        total = sum_sq_at(objective, x)[chosen].sum()
        assert loss == pytest.approx(total / few.total_weight, rel=1e-5)
    again = objective.start()
    objective.put_part(again, chosen, part)
    np.testing.assert_array_equal(taken(objective, again, chosen), taken(objective, x, chosen))
    objective.robust = objective.robust_around(x, "cauchy")
    assert objective.reweighted(x).model == model


# --- The system of the lights ---


def test_a_damped_system_is_solved() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(20, 20))
    matrix = root @ root.T
    diagonal, right = np.diag(matrix).copy(), rng.normal(size=20)
    solver = Cholesky(matrix.copy(), 0.1)
    np.testing.assert_array_equal(solver.diagonal, diagonal)
    expected = np.linalg.solve(matrix + 0.1 * np.diag(diagonal), right)
    np.testing.assert_allclose(solver.solve(right), expected, rtol=1e-8)


def test_lights_that_no_pixel_sees_stay() -> None:
    matrix = np.diag([1.0, 0.0, 2.0])
    found = Cholesky(matrix, 0.0).solve(np.array([1.0, 0.0, 2.0]))
    np.testing.assert_allclose(found, [1, 0, 1], atol=1e-9)
    assert (Cholesky(np.zeros((2, 2)), 0.0).solve(np.zeros(2)) == 0).all()
    with pytest.raises(np.linalg.LinAlgError):
        Cholesky(np.diag([1.0, -1.0]), 0.0)


# --- Lights from some pixels ---


def test_some_pixels_find_the_lights_of_a_room_without_noise(room: Scene) -> None:
    objective, watch = Objective(room), Watch()
    lights = lights_of(objective, watch)
    assert lights.fits
    share = len(lights.validation_pixels) / objective.pixels
    assert lights.sum_sq_residuals <= EXACT**2 * objective.total_weight * share
    assert "pixels" in lights.note
    # Those of the truth but for a scale of each channel, which pictures do not tell.
    found = lights.x[objective.layout.lighting].reshape(12, 16, 3)
    true = at_truth(objective, room)[objective.layout.lighting].reshape(12, 16, 3)
    scale = (found * true).sum(axis=(0, 1)) / (found**2).sum(axis=(0, 1))
    np.testing.assert_allclose(found * scale, true, rtol=0, atol=1e-5 * np.abs(true).max())
    assert len(watch.shares) > 2
    assert watch.sum_sq == []
    assert watch.shares[-1] <= EXACT**2
    assert all(np.isfinite(materials).all() for materials in watch.materials)
    # Pixels that had no part are as they were.
    before, after = (taken(objective, x, slice(None)) for x in (objective.start(), lights.x))
    same = (before == after).all(axis=1)
    assert np.count_nonzero(~same) > 0
    assert (~same)[lights.validation_pixels].all()


def test_the_same_seed_gives_the_same_bits_and_another_the_same_lights(noisy: Scene) -> None:
    objective = Objective(noisy)
    one, two, other = (lights_of(objective, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one.x, two.x)
    assert one.note == two.note
    assert not np.array_equal(one.x, other.x)
    fits = [fit_materials(objective, lights.x, Watch()) for lights in (one, other)]
    assert fits[0] is not None
    assert fits[1] is not None
    assert fits[1].sum() == pytest.approx(fits[0].sum(), rel=0.01)


def test_known_lights_are_not_sought(room: Scene) -> None:
    objective, watch = Objective(known_lights(room)), Watch()
    start = objective.start()
    lights = find_lights(objective, start, watch, seed=0)
    np.testing.assert_array_equal(lights.x, start)
    assert lights.x is not start  # it changes from there on
    assert lights.fits
    assert lights.note == "lights known"
    sum_sq = fit_materials(objective, lights.x, watch)
    assert sum_sq is not None
    assert watch.shares == []
    assert len(watch.sum_sq) == 1
    assert sum_sq.sum() <= EXACT**2 * objective.total_weight


# --- All pixels ---


def test_all_pixels_of_a_room_without_noise_are_found(room: Scene) -> None:
    objective, watch = Objective(room), Watch()
    found, sum_sq = fitted(objective, watch)
    np.testing.assert_allclose(sum_sq.sum(), sum_sq_at(objective, found).sum(), rtol=1e-6)
    assert sum_sq.sum() <= EXACT**2 * objective.total_weight
    assert watch.sum_sq[-1] == sum_sq.sum()
    true = at_truth(objective, room)
    for block in (objective.roughness, objective.metallic):
        assert block is not None
        assert np.sqrt(np.mean((found[block] - true[block]) ** 2)) < 1e-5


def test_time_may_run_out_before_all_pixels_have_lights(room: Scene) -> None:
    objective = Objective(room)
    assert fit_materials(objective, objective.start(), Watch(asked=0)) is None
    watch = Watch(visits=1)
    assert fit_materials(objective, objective.start(), watch) is not None
    assert len(watch.sum_sq) == 1


def test_a_pixel_in_a_wrong_minimum_is_freed(room: Scene) -> None:
    objective = Objective(room)
    x = at_truth(objective, room)
    rng = np.random.default_rng(4)
    caught = rng.permutation(objective.pixels)[:30].astype(np.uint64)
    wrong = taken(objective, x, caught)
    wrong[:, 3:] = 1 - np.round(wrong[:, 3:])  # rough for smooth, metal for none
    x = put(objective, x, caught, wrong)
    sum_sq = fitted_pixels(objective, x, starts=0)
    still = caught[sum_sq[caught] > EXACT**2 * 36]
    assert len(still) >= 5  # a descent alone does not free all
    retry_outliers(objective, x, sum_sq)
    assert sum_sq[still].max() <= EXACT**2 * 36
    np.testing.assert_allclose(x, at_truth(objective, room), atol=1e-4)


def test_where_nothing_stands_out_nothing_is_tried_again(noisy: Scene) -> None:
    objective = Objective(noisy)
    x = at_truth(objective, noisy)
    sum_sq = np.ones(objective.pixels)
    before = x.copy()
    retry_outliers(objective, x, sum_sq)
    np.testing.assert_array_equal(x, before)
    assert (sum_sq == 1.0).all()


# --- Joint steps ---


@pytest.mark.parametrize("kind", FREE_LIGHTS)
def test_joint_steps_of_all_pixels_lower_the_sum(noisy: Scene, kind: str) -> None:
    objective = objective_of(noisy, kind)
    x = objective.start()
    sum_sq = fitted_pixels(objective, x, starts=2)
    before = float(sum_sq.sum())
    watch = Watch()
    global_gauss_newton.minimize(objective, x, sum_sq, watch.visit, watch.stop)
    assert watch.sum_sq
    assert watch.sum_sq[0] < before
    assert (np.diff(watch.sum_sq) <= 0).all()
    assert sum_sq.sum() == watch.sum_sq[-1]
    np.testing.assert_allclose(sum_sq.sum(), sum_sq_at(objective, x).sum(), rtol=1e-6)


# --- With a prior ---


def fitted_prior(objective: Objective) -> tuple[Array, GaussianPrior]:
    found = fit_prior(objective, fitted(objective)[0], 1.0)
    assert found is not None
    return found[:2]


def total(objective: Objective, x: Array, prior: GaussianPrior) -> float:
    cost = prior.value_and_grad(x, np.zeros(objective.size))
    return float(sum_sq_at(objective, x).sum()) / objective.total_weight + cost


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in FREE_LIGHTS if kind != "order 2"])
def test_squares_and_prior_together_are_lowered(noisy: Scene, kind: str) -> None:
    objective = objective_of(noisy, kind)
    x, prior = fitted_prior(objective)
    found = x.copy()
    fit_with_prior(objective, found, prior, Watch())
    assert total(objective, found, prior) < total(objective, x, prior)
    # L-BFGS finds nothing much lower from there.
    objective.penalties = [prior]
    loss, gradient = objective.value_and_grad(found)
    assert loss == pytest.approx(total(objective, found, prior), rel=1e-4)
    maps = found[objective.layout.maps]
    inside = np.ones(objective.size, bool)
    inside[objective.layout.maps] = (maps > 1e-6) & (maps < 1 - 1e-6)
    at_start = objective.value_and_grad(x)[1]
    assert np.linalg.norm(gradient[inside]) < 0.1 * np.linalg.norm(at_start[inside])


def test_time_may_run_out_while_materials_have_a_prior(noisy: Scene) -> None:
    objective = Objective(noisy)
    x, prior = fitted_prior(objective)
    found = x.copy()
    fit_with_prior(objective, found, prior, Watch(asked=0))
    np.testing.assert_array_equal(found, x)
    fit_with_prior(objective, found, prior, Watch(visits=1))
    assert np.isfinite(found).all()
    assert (found != x).any()


# --- Whole fits ---


@pytest.mark.parametrize("solver", ["auto", "gauss-newton"])
def test_progress_is_told_of_every_joint_step(room: Scene, solver: Any) -> None:
    seen: list[pbrfit.Progress] = []
    states: list[tuple[pbrfit.Materials, Array]] = []

    def progress(now: pbrfit.Progress) -> None:
        seen.append(now)
        states.append(now.state())

    result = pbrfit.decompose(room, solver=solver, priors=None, progress=progress)
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


def test_what_is_not_kept_of_a_system_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    objective = Objective(make_scene("room", size=24, lights=4, held_out=1, seed=2))
    x = objective.start()
    fit = global_gauss_newton._JointFit(
        objective, x, np.ones(objective.pixels), None, lambda: False, damping=1e-3
    )
    v = np.random.default_rng(1).normal(size=4 * 16 * 3)
    found = []
    for kept in (settings.KEPT_SYSTEM_BYTES, 0):
        monkeypatch.setattr(settings, "KEPT_SYSTEM_BYTES", kept)
        system = fit._system()
        assert system is not None
        parts, gradient = system
        product = fit._product(parts, v)
        assert product is not None
        found.append((product, gradient))
    (rounded, one), (exact, other) = found
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(rounded, exact, rtol=0, atol=1e-5 * np.abs(exact).max())
    assert (rounded != exact).any()
