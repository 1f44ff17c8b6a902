"""One scene after one disturbance, fitted with all defaults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pbrfit.result.options import FitOptions
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.everyday.disturbances import (
    FOV_TRUE,
    FOV_WRONG,
    KINDS,
    REFERENCE,
    TITLES,
    Disturbance,
    Floats,
    disturbed,
    twin_of,
)
from pbrfit_evaluation.grid import Case, Grid, measured
from pbrfit_evaluation.recipes import known

CHANNELS = ("red", "green", "blue")

PICTURED: tuple[Disturbance, ...] = ("noise", "jpeg-90-420", "jpeg-75-420", "clipped", "shifted")
"""Disturbances whose maps are shown."""

GRID = Grid(
    TITLES,
    brings={one: (REFERENCE, twin_of(one)) for one in TITLES},
    kinds=KINDS,
    pictured=PICTURED,
    few=tuple(name for name in TITLES if "444" not in name and "75" not in name),  # JPEG once
)


def run(case: Case, _: int) -> dict[str, Any]:
    """Errors, the scale and what is said of the field of view.

    One thread, so that processor seconds compare.
    """
    scene = disturbed(case.condition, case.kind, case.seed, case.size)
    refine = FitOptions().refine_normals
    result, found = measured(case, GRID.ways[case.way], scene, 1, refine_normals=refine)
    true_fov = FOV_TRUE if case.condition.startswith("fov") else FOV_WRONG
    return {
        **found,
        "refined": result.refinement.refined,
        "scale": scales(result, scene),
        "fov": {
            "degrees": result.fov,
            "error": abs(result.fov - true_fov),
            "said": result.assumed.get("fov"),
            "contradicted": result.camera is not None and result.camera.contradicted,
        },
    }


def scales(result: Result, scene: Scene) -> dict[str, dict[str, float]]:
    """`scale_errors` of a result with an uncertainty and a scene with ground truth."""
    assert result.uncertainty is not None
    found, true = result.materials.albedo, known(scene.truth).materials.albedo
    deviations = result.uncertainty.albedo_scale
    return scale_errors(found[scene.valid], true[scene.valid], deviations)


def scale_errors(
    found: Floats, true: Floats, deviations: Sequence[float]
) -> dict[str, dict[str, float]]:
    """By channel the `error` of the scale of albedos (P, 3), and its `deviation`.

    The error is |ln s|, where s times the true albedo is nearest to the found one. To first order
    its standard deviation is `Uncertainty.albedo_scale`.
    """
    scales = (found * true).sum(axis=0) / np.square(true).sum(axis=0)
    errors = np.abs(np.log(np.maximum(scales, np.finfo(np.float64).tiny)))
    return {
        channel: {"error": float(error), "deviation": float(deviation)}
        for channel, error, deviation in zip(CHANNELS, errors, deviations, strict=True)
    }


def covered(scale: dict[str, dict[str, float]]) -> list[bool]:
    """By channel, whether the error of the scale is within two deviations.

    Pictures without noise in float32 leave an error of some 1e-7, which is rounding and which no
    deviation is of.
    """
    return [one["error"] <= max(2 * one["deviation"], 1e-6) for one in scale.values()]
