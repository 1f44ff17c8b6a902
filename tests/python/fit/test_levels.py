"""Levels: the objective of some of the pixels, and lights that are found from these."""

from __future__ import annotations

import numpy as np
import pytest

from pbrfit import Objective, Scene, decompose
from pbrfit.fit import settings
from pbrfit.fit.pixels import taken
from pbrfit.model.reflection import MODELS, Model
from pbrfit.synthetic import make_scene
from scene_kinds import FREE_LIGHTS, all_pixels, of_kind, sum_sq_at


@pytest.fixture(scope="module")
def noisy() -> Scene:
    return make_scene("room", size=24, lights=8, noise=0.01, seed=2001, held_out=2)


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


@pytest.mark.usefixtures("uncompared")
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_lights_of_a_level_serve_all_pixels(noise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted scenes stay exact, and of noisy ones hardly more is left than by those of all."""
    scene = make_scene("room", size=64, lights=6, noise=noise, seed=2001, held_out=2)
    left = []
    for few in (settings.LIGHTS_PIXELS, 1500):
        monkeypatch.setattr(settings, "LIGHTS_PIXELS", few)
        left.append(decompose(scene, priors=None, refine_normals="off").metrics["recon_rmse"])
    assert left[1] < 1.02 * left[0] + 1e-12
    assert noise or max(left) < 1e-12
