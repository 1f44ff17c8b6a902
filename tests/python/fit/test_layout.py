"""What x holds for every kind of problem, and the way there and back."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

from pbrfit import Objective, Scene
from pbrfit.synthetic import make_scene
from scene_kinds import ALL_KINDS, of_kind

SIZE, PICTURES = 12, 5

every_kind = pytest.mark.parametrize("kind", ALL_KINDS)


@functools.cache
def made(sh_order: int) -> Scene:
    return make_scene("textured", size=SIZE, lights=PICTURES, held_out=1, sh_order=sh_order)


def scene_of(kind: str) -> tuple[Scene, dict[str, Any]]:
    return of_kind(made(2 if kind == "known lights" else 3), kind)


@every_kind
def test_pack_and_unpack_are_inverse(kind: str) -> None:
    scene, options = scene_of(kind)
    objective = Objective(scene, **options)
    x = np.random.default_rng(3).random(objective.size)
    materials, lighting = objective.unpack(x)
    assert materials.albedo.shape == (SIZE, SIZE, 3)
    assert lighting.shape == (PICTURES, 16, 3)
    np.testing.assert_array_equal(np.isnan(materials.roughness), ~scene.valid)
    if "metallic" in options:
        assert (materials.metallic[scene.valid] == options["metallic"]).all()
    if "grey" in kind:
        assert (materials.albedo == materials.albedo[..., :1])[scene.valid].all()
    if "grey" in kind or "mono" in kind:
        assert (lighting == lighting[..., :1]).all()
    if "order 2" in kind:
        assert not lighting[:, 9:].any()
    maps = materials.roughness, materials.metallic
    back = objective.pack(materials.albedo, *maps, lighting)
    np.testing.assert_allclose(back, x, rtol=1e-15)
    # Of channels that differ the mean is packed.
    tint = np.array([0.5, 1.0, 1.5])
    if objective.channels == 1:
        back = objective.pack(materials.albedo * tint, *maps, lighting)
        np.testing.assert_allclose(back, x, rtol=1e-14)
    if "grey" in kind or "mono" in kind:
        back = objective.pack(materials.albedo, *maps, lighting * tint)
        np.testing.assert_allclose(back, x, rtol=1e-14)


@every_kind
def test_the_start_has_the_best_lights(kind: str) -> None:
    scene, options = scene_of(kind)
    objective = Objective(scene, **options)
    x = objective.start()
    assert x.shape == (objective.size,)
    assert np.isfinite(x).all()
    if objective.lighting is None:
        return
    loss, gradient = objective.value_and_grad(x)
    rng = np.random.default_rng(4)
    for _ in range(5):
        other = x.copy()
        other[objective.lighting] *= rng.uniform(0.95, 1.05, x[objective.lighting].size)
        other_loss, other_gradient = objective.value_and_grad(other)
        assert other_loss > loss
        by_lights = np.linalg.norm(gradient[objective.lighting])
        assert by_lights < 1e-2 * np.linalg.norm(other_gradient[objective.lighting])
