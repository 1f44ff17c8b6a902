"""Radiance of pixels under lamps of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pbrfit import _core
from pbrfit.model.reflection import MODELS
from reference import unit

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
def test_below_the_horizon_all_is_zero(model: str) -> None:
    given = pixels(40, 2, 3)
    normals = given["normals"][:, None]
    height = np.abs((given["directions"] * normals).sum(axis=-1, keepdims=True))
    given["directions"] = unit(given["directions"] - (2 * height + 0.01) * normals)
    assert (_core.lamp_radiance(**given, threads=1, model=model) == 0).all()
