"""Pictures with outliers: what weights of samples gain."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit.synthetic import make_scene


@cache
def shadows(seed: int) -> pbrfit.Scene:
    """A room in which a twentieth of the samples is at 30 % of what it was."""
    scene = make_scene("room", size=24, lights=8, noise=0.004, seed=seed, held_out=2)
    hit = np.random.default_rng(0).random(scene.images.shape[:3]) < 0.05
    return dataclasses.replace(scene, images=np.where(hit[..., None], 0.3, 1) * scene.images)


SEEDS = (2002, 2003, 2004)
MAPS = ("albedo_scaled_rmse", "roughness_rmse", "metallic_rmse")


@pytest.mark.slow
@pytest.mark.parametrize("priors", [None, pbrfit.Priors()], ids=["no priors", "material prior"])
def test_outliers_do_less_harm_than_to_squares(priors: pbrfit.Priors | None) -> None:
    """Means of three scenes: single ones of 24 x 24 pixels scatter by a fifth."""
    options: dict[str, Any] = {"refine_normals": "off", "uncertainty": False, "priors": priors}
    by_squares, robust = (
        [pbrfit.decompose(shadows(seed), robust=name, **options) for seed in SEEDS]
        for name in ("none", "auto")
    )
    for name in MAPS:
        errors = [np.mean([one.metrics[name] for one in of]) for of in (robust, by_squares)]
        assert errors[0] < 0.9 * errors[1], name
    left = 0  # where they are: outliers; by default, if left-out pictures ask for it
    for one, other in zip(robust, by_squares, strict=True):
        left += one.metrics["recon_rmse"] > other.metrics["recon_rmse"]
        assert (one.options.robust, other.options.robust) == ("auto", "none")
    assert left >= 2
