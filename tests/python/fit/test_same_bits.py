"""What a problem says has the same bits at any number of threads and beside any other pixels."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from among import Among, Surroundings
from pbrfit import Priors, decompose
from pbrfit.model.reflection import MODELS, Model
from pbrfit.result.options import Solver
from pbrfit.synthetic import make_scene
from random_pixels import Example, Kind, Pixels
from scene_files import known

both_models = pytest.mark.parametrize("model", MODELS)

KINDS = (
    Kind(),
    Kind(mono=True, weights=2, metallic=0.3),
    Kind(channels=1, sh_order=2, known_lights=True),
    Kind(free_normals=True),
    Kind(free_normals=True, metallic=0.3, weights=3),
)


@both_models
@pytest.mark.parametrize("kind", [*KINDS, Surroundings(weights=3)], ids=str)
def test_of_a_problem(kind: Kind, model: Model) -> None:
    count = 700
    if isinstance(kind, Surroundings):
        kind = dataclasses.replace(kind, model=model)
    make = Among if isinstance(kind, Surroundings) else Example
    example = make(kind, count, 5, noise=0.02)
    rng = np.random.default_rng(4)
    x = example.x(np.clip(example.truth + rng.normal(0, 0.1, example.truth.shape), 0, 1))
    maps = x[: kind.unknowns * count]
    shape = count, kind.unknowns - kind.channels
    prior = {"mean": rng.uniform(0, 1, shape), "precision": rng.uniform(0, 0.1, shape)}
    channels = 1 if kind.mono else kind.channels
    tied: dict[str, Any] = {
        "precision": prior["precision"],
        "deviation": rng.normal(size=shape),
        "cluster": (rng.integers(4, size=count).astype(np.uint64), 4),
    }
    moves = 0.05 * rng.normal(size=channels * 5 * kind.coefficients + 4 * shape[1])
    modes = rng.normal(size=(2, *example.lights.shape))
    covariances = rng.normal(size=(count, kind.unknowns, kind.unknowns))
    nodes = np.linspace(0.05, 1, 6), np.linspace(0, 1, 4)
    lights: dict[str, Any] = {"damping": 1e-3, "mono": kind.mono}

    def of_pixels(threads: int, pixels: Pixels) -> list[Any]:
        problem = example.problem(threads, model=model)
        own: dict[str, Any] = {name: values[pixels] for name, values in prior.items()}
        of_clusters = {name: tied[name][pixels] for name in ("precision", "deviation")}
        of_clusters["cluster"] = tied["cluster"][0][pixels], 4
        return [
            *problem.fit_materials(x, pixels, *nodes, starts=2, exact_steps=3, **own),
            *problem.normal_equations(x, pixels),
            *problem.derivatives(x, pixels),
            problem.material_grid(x, pixels, *nodes),
            *problem.moves_with_lights(x, pixels, covariances[pixels], modes),
            problem.back_substitute(x, pixels, moves, **lights, **of_clusters),
        ]

    def of_all(threads: int) -> list[Any]:
        problem = example.problem(threads, model=model)
        kept = problem.kept_system(x, example.everything, **lights, **tied)
        return [
            *problem.value_and_grad(x),
            *problem.light_equations(maps),
            problem.residuals(x, example.everything),
            *problem.schur_complement(x, example.everything, **lights, **tied),
            kept.gradient,
            kept.product(moves),
        ]

    pixels, whole = of_pixels(1, example.everything), of_all(1)
    for threads in (2, 5):
        again = [*of_pixels(threads, example.everything), *of_all(threads)]
        for one, other in zip(again, [*pixels, *whole], strict=True):
            np.testing.assert_array_equal(one, other)
    order = rng.permutation(count).astype(np.uint64)
    for chosen in (order, order[:37], order[:1], np.repeat(order[:2], 200)):
        for one, other in zip(of_pixels(2, chosen), pixels, strict=True):
            np.testing.assert_array_equal(one, other[chosen])


@pytest.mark.parametrize("model", ["paper", pytest.param("principled", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("solver", "priors"),
    [
        ("gauss-newton", Priors(monochrome=1e-3)),
        ("lbfgsb", Priors(cohesion=1e-3, smoothness=1e-3, sparsity=1e-4, monochrome=1e-3)),
    ],
)
def test_of_a_fit_with_all_priors_and_its_uncertainty(
    model: Model, solver: Solver, priors: Priors
) -> None:
    scene = make_scene("room", size=28, lights=3, held_out=1, seed=3, model=model, noise=0.01)
    one, other = (
        decompose(
            scene,
            solver=solver,
            iterations=5,
            priors=priors,
            refine_normals="off",
            threads=threads,
        )
        for threads in (1, 2)
    )
    for name in ("albedo", "roughness", "metallic", "lighting"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert known(one.uncertainty).summary() == known(other.uncertainty).summary()
    for name, layer in known(one.uncertainty).layers().items():
        np.testing.assert_array_equal(layer, known(other.uncertainty).layers()[name], err_msg=name)


def of_blas() -> list[int]:
    """Threads of each BLAS that is loaded."""
    return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]


def test_of_fits_at_the_same_time_after_which_blas_has_its_threads_again() -> None:
    scene = make_scene("room", size=16, lights=3, held_out=1, seed=3, noise=0.01)
    with threadpool_limits(2, user_api="blas"):
        alone = decompose(scene).albedo
        with ThreadPoolExecutor(2) as pool:
            for found in pool.map(lambda _: decompose(scene), range(2)):
                np.testing.assert_array_equal(found.albedo, alone)
        assert set(of_blas()) == {2}
