"""Many pictures have the system of a few sums of them, and that is its preconditioner."""

from __future__ import annotations

import numpy as np
import pytest

from pbrfit import Objective, Scene
from pbrfit.fit import discrepancy, uncertainty
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.pixels import fit_all
from pbrfit.fit.preconditioner import preconditioner
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from scene_files import known
from scene_kinds import all_pixels

PICTURES = 20
each_light = pytest.mark.parametrize("mono", [False, True])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("room", size=24, lights=PICTURES, noise=0.01, seed=7, held_out=1)


def objective_of(scene: Scene, mono: bool) -> Objective:
    """With nine coefficients, so that there are more than twice as many pictures."""
    return Objective(scene, sh_order=2, mono_light=mono)


def fitted(objective: Objective) -> Array:
    x = objective.start()
    assert fit_all(objective, x, starts=1) is not None
    return x


@each_light
def test_of_all_pixels_it_is_the_inverse(scene: Scene, mono: bool) -> None:
    objective = objective_of(scene, mono)
    x, everything = fitted(objective), all_pixels(objective)
    lights = LightPrior.around(objective, x).of_pixels(objective.pixels)
    found = preconditioner(objective, x, 1.0, lights, np.empty(0), {"mono": mono})[0]
    matrix = objective.problem.schur_complement(objective.for_core(x), everything, mono=mono)[0]
    assert known(objective.light_basis(x)).shape == (1 if mono else 3, PICTURES, 9)
    rng = np.random.default_rng(1)
    for _ in range(3):
        v = rng.normal(size=len(matrix))
        off = found(matrix @ v) / objective.pixels - v
        assert off @ matrix @ off < 1e-6 * (v @ matrix @ v)


def spread(objective: Objective, x: Array) -> Array:
    """Variances of all unknowns of pixels."""
    found = uncertainty.spread(objective, x, discrepancy.find(objective, x), None)
    return np.asarray(found.variance, np.float64)


@each_light
def test_uncertainty_of_many_pictures_is_that_of_all_lights(
    scene: Scene, mono: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    objective = objective_of(scene, mono)
    x = fitted(objective)
    found = spread(objective, x)
    monkeypatch.setattr(Objective, "light_basis", lambda *_: None)
    expected = spread(objective, x)
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(expected), rtol=2e-3)
