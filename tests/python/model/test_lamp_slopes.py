"""Radiance of pixels under lamps of their own, and its derivatives."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from finite_differences import ridders
from pbrfit import _core
from pbrfit.model.reflection import MODELS
from reference import unit

Array = NDArray[np.floating[Any]]

every_model = pytest.mark.parametrize("model", MODELS)


def pixels(count: int, lamps: int, seed: int) -> dict[str, Any]:
    """Pixels that see lamps at more than a grazing angle."""
    rng = np.random.default_rng(seed)
    forward = np.array([0.0, 0.0, 1.0])
    return {
        "normals": unit(forward + 0.3 * rng.normal(size=(count, 3))),
        "views": unit(forward + 0.1 * rng.normal(size=(count, 3))),
        "albedo": rng.uniform(0.05, 0.95, (count, 3)),
        "roughness": rng.uniform(0.1, 0.95, count),
        "metallic": rng.uniform(0.05, 0.95, count),
        "directions": unit(forward + 0.4 * rng.normal(size=(count, lamps, 3))),
    }


@every_model
def test_lamps_beside_each_other_do_not_matter(model: str) -> None:
    given = pixels(50, 11, 0)
    radiance = _core.lamp_radiance(**given, threads=1, model=model)
    assert radiance.shape == (50, 11, 3)
    for k in range(11):
        alone = given | {"directions": given["directions"][:, k : k + 1].copy()}
        one = _core.lamp_radiance(**alone, threads=1, model=model)
        np.testing.assert_array_equal(radiance[:, k], one[:, 0])


@every_model
def test_slopes_come_with_the_radiance_and_do_not_depend_on_threads(model: str) -> None:
    given = pixels(3000, 2, 1)
    radiance = _core.lamp_radiance(**given, threads=1, model=model)
    one, two = (_core.lamp_slopes(**given, threads=t, model=model) for t in (1, 2))
    np.testing.assert_array_equal(one[..., 0], radiance)
    np.testing.assert_array_equal(one, two)
    assert one.shape == (3000, 2, 3, 10)


@every_model
def test_slopes_are_those_of_the_values(model: str) -> None:
    given = pixels(200, 3, 2)
    given["directions"][np.einsum("px,pkx->pk", given["normals"], given["directions"]) < 0.05] = (
        given["normals"][0]
    )
    n, directions = given["normals"], given["directions"]
    over = np.einsum("px,pkx->pk", n, directions) > 0.05
    width = 0.02 * given["roughness"] ** 2

    steps = width[:, None, None]

    def radiance(name: str, value: Array) -> Array:
        return _core.lamp_radiance(**(given | {name: value}), threads=1, model=model)

    def turned(name: str, along: Array, t: float) -> Array:
        return radiance(name, unit(given[name] + t * along))

    def changed(name: str, t: float) -> Array:
        return radiance(name, given[name] + t)

    slopes = _core.lamp_slopes(**given, threads=1, model=model)
    value, by_normal, by_direction = slopes[..., 0], slopes[..., 1:4], slopes[..., 4:7]
    scale = np.maximum(value, 1e-3)

    def agrees(found: Array, expected: Array, error: Array, unit_of_x: Array | float) -> None:
        near = np.abs(found - expected) <= 1e-6 * (np.abs(expected) + scale / unit_of_x) + error
        assert near[over].all()

    for tangent in reference.tangents(n):
        along = width[:, None] * tangent
        slope, error = ridders(partial(turned, "normals", along), 1.0)
        found = np.einsum("pkcx,px->pkc", by_normal, tangent)
        agrees(found, slope / steps, error / steps, steps)
    for tangent in reference.tangents(directions.reshape(-1, 3)):
        tangent = tangent.reshape(directions.shape)
        slope, error = ridders(partial(turned, "directions", steps * tangent), 1.0)
        found = np.einsum("pkcx,pkx->pkc", by_direction, tangent)
        agrees(found, slope / steps, error / steps, steps)
    for name, found in zip(
        ("albedo", "roughness", "metallic"), np.moveaxis(slopes[..., 7:], -1, 0), strict=True
    ):
        agrees(found, *ridders(partial(changed, name), 0.02), 1.0)


@every_model
def test_below_the_horizon_all_is_zero(model: str) -> None:
    given = pixels(40, 2, 3)
    given["directions"] = np.tile(-given["normals"][:, None], (1, 2, 1))
    assert (_core.lamp_slopes(**given, threads=1, model=model) == 0).all()
