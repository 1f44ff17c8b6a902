"""The gradient of the objective against finite differences of its value, for every problem."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from pbrfit import Objective, Priors, Scene
from pbrfit.fit.gradient_check import check_gradients
from pbrfit.fit.priors.penalties import Penalty
from pbrfit.model.reflection import MODELS, Model
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from scene_kinds import ALL_KINDS, of_kind

PRIORS = Priors(material=1.0, cohesion=0.7, smoothness=0.3, sparsity=0.2, monochrome=0.5)


@functools.cache
def room(model: Model) -> Scene:
    return make_scene("room", size=8, lights=4, held_out=1, noise=0.02, seed=5, model=model)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("free_normals", [False, True])
@pytest.mark.parametrize("kind", ALL_KINDS)
def test_the_gradient_agrees_with_finite_differences(
    kind: str, free_normals: bool, model: Model
) -> None:
    scene, own = of_kind(room(model), kind)
    objective = Objective(scene, priors=PRIORS, model=model, free_normals=free_normals, **own)
    checks = check_gradients(objective, seed=1)
    expected = {"albedo", "roughness"}
    expected |= {"metallic"} if objective.known_metallic is None else set()
    expected |= {"tangent_offsets"} if free_normals else set()
    expected |= {"lighting"} if objective.lighting is not None else set()
    assert {check.unknowns for check in checks if check.function == "loss"} == expected
    penalties = {penalty.name for penalty in objective.penalties}
    assert {check.function for check in checks} == {"loss", *penalties}
    assert [check for check in checks if not check.passed] == []


class Wrong:
    """A penalty whose gradient misses one part and has a sign too many in another."""

    def __init__(self, right: Penalty, part: slice, factor: float) -> None:
        self.name = right.name
        self.right, self.part, self.factor = right, part, factor

    def value_and_grad(self, x: Array, gradient: Array) -> float:
        own = np.zeros_like(gradient)
        value = self.right.value_and_grad(x, own)
        own[self.part] *= self.factor
        gradient += own
        return value


@pytest.mark.parametrize("factor", [0.0, 1.001])
def test_the_check_finds_a_wrong_gradient(factor: float) -> None:
    scene = make_scene("room", size=12, lights=3, held_out=1)
    objective = Objective(scene, priors=dataclasses.replace(Priors.none(), cohesion=1e-9))
    objective.penalties = [Wrong(objective.penalties[0], objective.roughness, factor)]
    failed = {(c.function, c.unknowns) for c in check_gradients(objective) if not c.passed}
    assert failed == {("cohesion", "roughness")}
