"""Pictures with outliers: what weights of samples gain."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit.synthetic import make_scene


def room(**options: Any) -> pbrfit.Scene:
    return make_scene("room", **{"size": 24, "lights": 8, "seed": 2002, "held_out": 2} | options)


def with_shadows(scene: pbrfit.Scene, share: float = 0.05) -> pbrfit.Scene:
    """The scene with some samples at 30 % of what they were."""
    hit = np.random.default_rng(0).random(scene.images.shape[:3]) < share
    return dataclasses.replace(scene, images=np.where(hit[..., None], 0.3, 1) * scene.images)


@cache
def shadows(seed: int = 2002) -> pbrfit.Scene:
    return with_shadows(room(noise=0.004, seed=seed))


@cache
def fit(case: str, robust: Any, seed: int = 2002) -> pbrfit.Result:
    """A scene with shadows, fitted as `CASES` says."""
    options: dict[str, Any] = {"refine_normals": "off", "uncertainty": False}
    return pbrfit.decompose(shadows(seed), robust=robust, **options, **CASES[case])


SEEDS = (2002, 2003, 2004)
MAPS = ("albedo_scaled_rmse", "roughness_rmse", "metallic_rmse")
CASES: dict[str, dict[str, Any]] = {"no priors": {"priors": None}, "material prior": {}}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_outliers_do_less_harm_than_to_squares(case: str) -> None:
    """Means of three scenes: single ones of 24 x 24 pixels scatter by a fifth."""
    by_squares, robust = ([fit(case, name, seed) for seed in SEEDS] for name in ("none", "auto"))
    for name in MAPS:
        errors = [np.mean([one.metrics[name] for one in of]) for of in (robust, by_squares)]
        assert errors[0] < 0.9 * errors[1], name
    left = 0  # where they are: outliers; by default, if left-out pictures ask for it
    for one, other in zip(robust, by_squares, strict=True):
        left += one.metrics["recon_rmse"] > other.metrics["recon_rmse"]
        assert (one.options.robust, other.options.robust) == ("auto", "none")
    assert left >= 2
