"""The mixture prior on materials: its gradient, EM, offsets, and what fits gain by it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit import Objective, Priors, Result, Scene
from pbrfit.fit.coarse import judged
from pbrfit.fit.pixels import fit_all
from pbrfit.fit.priors import posterior
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.mixture import fit_prior, with_lights
from pbrfit.fit.settings import OFFSET_PRECISION_SHARE
from pbrfit.result.options import SOLVERS, Solver
from pbrfit.synthetic import make_scene
from scene_files import known, lights_of, truth_of
from scene_kinds import KINDS, all_pixels, of_kind

Pixels = NDArray[np.uint64]


@pytest.fixture(scope="module")
def room() -> Scene:
    return make_scene("room", size=18, lights=8, noise=0.01, seed=2000, held_out=4)


def some_prior(
    objective: Objective, pixels: Pixels, rng: np.random.Generator, clusters: int = 4
) -> GaussianPrior:
    blocks = objective.layout.roughness_metallic
    mean = rng.uniform(0.2, 0.8, (len(pixels), len(blocks)))
    precision = rng.uniform(0.01, 0.05, mean.shape)
    cluster = rng.permutation(np.arange(len(pixels)) % clusters)
    return GaussianPrior(mean, precision, cluster, blocks)


def test_the_prior_has_the_right_gradient(room: Scene) -> None:
    objective = Objective(room)
    rng = np.random.default_rng(5)
    with_offsets = some_prior(objective, all_pixels(objective), rng, 7)
    x, maps = objective.start(), objective.layout.maps
    x[maps] = np.clip(x[maps] + rng.normal(0, 0.1, maps.stop), 0.02, 0.98)  # not a minimum
    for cluster in (with_offsets.cluster, None):
        prior = dataclasses.replace(with_offsets, cluster=cluster, factor=0.3)
        gradient = np.zeros(objective.size)
        assert prior.value_and_grad(x, gradient) > 0
        for _ in range(5):
            direction = rng.normal(size=objective.size)
            plus, minus = (
                prior.value_and_grad(x + h * direction, np.zeros(objective.size))
                for h in (1e-5, -1e-5)
            )
            assert gradient @ direction == pytest.approx((plus - minus) / 2e-5, rel=1e-6)


def test_the_prior_lets_a_cluster_move_as_a_whole(room: Scene) -> None:
    """Moving all pixels of a cluster alike costs only the small precision of the offsets."""
    objective = Objective(room)
    prior = some_prior(objective, all_pixels(objective), np.random.default_rng(6), clusters=3)
    x = objective.start()
    for f, block in enumerate(objective.layout.roughness_metallic):
        x[block] = prior.mean[:, f]
    at_mean = prior.value_and_grad(x, np.zeros(objective.size))
    assert at_mean == pytest.approx(0, abs=1e-20)
    x[objective.roughness][prior.cluster == 1] += 0.1
    as_whole = prior.value_and_grad(x, np.zeros(objective.size))
    stiff = 0.1**2 * prior.precision[prior.cluster == 1, 0].sum()
    share = OFFSET_PRECISION_SHARE / (1 + OFFSET_PRECISION_SHARE)
    assert as_whole == pytest.approx(share * stiff, rel=1e-6)
    alone = dataclasses.replace(prior, cluster=None)
    assert alone.value_and_grad(x, np.zeros(objective.size)) == pytest.approx(stiff, rel=1e-6)


def test_em_finds_a_planted_mixture() -> None:
    """Two materials, of which each pixel tells one with a wide likelihood."""
    rng = np.random.default_rng(7)
    nodes = np.linspace(0, 1, 41)
    true = np.where(rng.random(3000) < 0.3, 0.25, 0.7)
    seen = true + rng.normal(0, 0.15, true.shape)
    likelihood = np.exp(-((seen[:, None] - nodes) ** 2) / (2 * 0.15**2)).astype(np.float32)
    found = posterior.mixture_of(likelihood, np.full(41, 1 / 41, np.float32), 0.0)
    assert found.sum() == pytest.approx(1, abs=1e-5)
    assert found[nodes < 0.47].sum() == pytest.approx(0.3, abs=0.04)
    assert found[np.abs(nodes - 0.25) < 0.08].sum() > 0.22
    assert found[np.abs(nodes - 0.7) < 0.08].sum() > 0.55


@pytest.mark.usefixtures("uncompared")
def test_segments_that_are_a_pixel_off_bend_no_lights() -> None:
    """Pixels of none of their segment's materials take no part: with them albedo is off by 0.29."""
    scene = make_scene("room", size=32, lights=12, noise=0.01, seed=3102, held_out=1)
    moved = dataclasses.replace(scene, segments=np.roll(known(scene.segments), 1, axis=(0, 1)))
    options: dict[str, Any] = {"refine_normals": "off", "uncertainty": False}
    true, off = (pbrfit.decompose(one, **options).metrics for one in (scene, moved))
    for name in ("albedo_rmse", "roughness_rmse", "metallic_rmse"):
        assert off[name] < 1.5 * true[name] + 0.005, name


@pytest.mark.parametrize("looks", [0, 2, 4, 5])
def test_time_may_run_out_before_all_pixels_have_a_prior(room: Scene, looks: int) -> None:
    objective = Objective(room)
    x = objective.start()
    fit_all(objective, x, starts=2)
    lights = judged(objective, x)
    before, left = x.copy(), iter([False] * looks)
    stop = lambda: next(left, True)  # noqa: E731
    alone = lights.misfit.of_likelihood
    lit = with_lights(objective, x, 1.0, alone, known(lights.shared), stop)
    assert fit_prior(objective, lit, 1.0, alone, stop, counted_once=False) is None
    np.testing.assert_array_equal(x, before)


def fitted(scene: Scene, solver: Solver, **options: Any) -> Result:
    return pbrfit.decompose(
        scene,
        solver=solver,
        light="sh",
        iterations=120,
        refine_normals="off",
        uncertainty=False,
        **options,
    )


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize("solver", ["gauss-newton", pytest.param("lbfgsb", marks=pytest.mark.slow)])
def test_the_prior_halves_the_error_of_roughness(solver: Solver) -> None:
    scene = make_scene("room", size=32, lights=12, noise=0.01, seed=2002, held_out=4)
    without, default = fitted(scene, solver, priors=None), fitted(scene, solver)
    assert default.metrics["roughness_rmse"] < 0.5 * without.metrics["roughness_rmse"]
    assert default.metrics["metallic_rmse"] < without.metrics["metallic_rmse"]
    assert default.metrics["albedo_rmse"] < without.metrics["albedo_rmse"]


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_problem_has_a_mixture_prior(room: Scene, kind: str, solver: Solver) -> None:
    scene, options = of_kind(room, kind)
    options = options | {"priors": Priors(material=1), "iterations": 60, "refine_normals": "off"}
    result = pbrfit.decompose(scene, solver=solver, **options)
    assert "material prior" in [stage.name for stage in result.stages]
    valid = result.mask
    for values in (result.albedo, result.roughness, result.metallic):
        assert np.isfinite(values[valid]).all()
        assert ((values[valid] >= 0) & (values[valid] <= 1)).all()
    assert np.isfinite(result.lighting).all()


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9)])
def test_tiny_pictures(shape: tuple[int, int], solver: Solver) -> None:
    rng = np.random.default_rng(8)
    normals = np.zeros((*shape, 3))
    normals[..., 2] = 1
    images = rng.uniform(0.1, 1, (4, *shape, 3)).astype(np.float32)
    scene = pbrfit.Scene(images=images, normals=normals)
    result = pbrfit.decompose(scene, solver=solver, iterations=10)
    assert np.isfinite(result.roughness).all()


@pytest.mark.parametrize("solver", SOLVERS)
def test_perfect_pictures_have_no_use_for_a_prior(room: Scene, solver: Solver) -> None:
    """Where the fit leaves no residual there is no noise, and the prior has nothing to say."""
    images = pbrfit.kernel.render(truth_of(room).materials, room.normals, lights_of(room), room.fov)
    scene = dataclasses.replace(room, images=images)
    truth = truth_of(room).materials, lights_of(room)
    result = pbrfit.decompose(scene, solver=solver, iterations=10, start=truth)
    assert result.metrics["roughness_rmse"] < 0.02
    assert result.metrics["recon_rmse"] < 1e-3
