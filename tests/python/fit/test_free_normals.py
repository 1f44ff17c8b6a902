"""Normals as unknowns: where they lie in x, and that the right ones explain."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import pbrfit
import reference
from pbrfit import InputError
from pbrfit.fit.objective import Objective
from pbrfit.synthetic import make_scene
from scene_files import truth_of

OPTIONS: list[dict[str, Any]] = [{}, {"metallic": 0.0}, {"sh_order": 2, "mono_light": True}]


def room(**options: Any) -> pbrfit.Scene:
    return make_scene("room", size=24, lights=6, **options)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_the_start_has_the_given_normals(options: dict[str, Any]) -> None:
    scene = room()
    known, free = (Objective(scene, **options, free_normals=f) for f in (False, True))
    x, start = known.start(), free.start()
    np.testing.assert_allclose(np.delete(start, np.r_[free.tangent_offsets]), x, rtol=0, atol=1e-6)
    assert not start[free.tangent_offsets].any()
    given = np.asarray(scene.normals, dtype=np.float64)[scene.valid]
    np.testing.assert_array_equal(known.normals(x), given)
    np.testing.assert_allclose(free.normals(start), given, rtol=0, atol=1e-6)
    assert free.value_and_grad(start)[0] == pytest.approx(known.value_and_grad(x)[0], rel=1e-5)
    lighting = truth_of(scene).lighting
    materials = truth_of(scene).materials
    packed = free.pack(materials.albedo, materials.roughness, materials.metallic, lighting)
    assert packed.shape == (free.size,)
    assert not packed[free.tangent_offsets].any()
    found, _ = free.unpack(packed)
    np.testing.assert_allclose(found.roughness, materials.roughness, rtol=0, atol=1e-12)


def test_the_tangent_offsets_to_the_true_normals_explain_the_pictures() -> None:
    scene = room()
    rng = np.random.default_rng(1)
    normals = np.array(scene.normals, dtype=np.float64)
    true = normals[scene.valid]
    normals[scene.valid] = reference.turned(true, 0.2 * rng.normal(size=(2, len(true))))
    disturbed = dataclasses.replace(scene, normals=normals)
    objective = Objective(disturbed, free_normals=True)
    materials = truth_of(scene).materials
    x = objective.pack(
        materials.albedo, materials.roughness, materials.metallic, truth_of(scene).lighting
    )
    wrong, gradient = objective.value_and_grad(x)
    # Tangent offsets are the true normals' parts along the tangents over that along n₀.
    given = np.asarray(disturbed.normals, dtype=np.float64)[scene.valid]
    parts = [np.sum(true * axis, axis=-1) for axis in reference.tangents(given)]
    x[objective.tangent_offsets] = np.ravel(parts / np.sum(true * given, axis=-1))
    right, _ = objective.value_and_grad(x)
    assert right < 1e-9 < 1e-4 < wrong
    assert np.abs(gradient[objective.tangent_offsets]).max() > 0
    # The best lights at these normals are the true ones.
    again = objective.with_best_lights(x)
    np.testing.assert_allclose(again[objective.lighting], x[objective.lighting], atol=1e-3)


def test_refused_tangent_offsets_are_named() -> None:
    objective = Objective(room(), free_normals=True)
    x = objective.start()
    for value, reason in ((np.nan, "finite numbers"), (1001.0, "numbers up to 1e3 in size")):
        x[objective.layout.materials.stop + 3] = value
        expected = rf"^x \(tangent offset\): expected {reason}, found \S+ at 3$"
        with pytest.raises(InputError, match=expected):
            objective.value_and_grad(x)
        with pytest.raises(InputError, match=r"^maps \(tangent offset\): expected"):
            objective.normals(x)
