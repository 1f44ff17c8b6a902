"""One scene, fitted with the defaults: its posterior beside the true errors.

Shares and sums are over values: of albedo each channel of each pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS, deserved
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.grid import Case, Grid, measured
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.recipes import constant_guess, known
from pbrfit_evaluation.uncertainty.conditions import CONDITIONS, made

Array = NDArray[np.float64]

EXACT = 1e-6
"""Error that counts as none: pictures without noise in float32 leave some 1e-7, which is rounding
and which no deviation is of."""

GRID = Grid(
    {name: condition.title for name, condition in CONDITIONS.items()},
    few=("clean", "noise", "fov-90"),
)


def run(case: Case, threads: int) -> Values:
    """What the posterior of a scene says, beside what is true.

    Returns
    -------
    `scores`, and `said`: by name, see `calibration`, with `guess`, the RMSE of the constant guess,
    and the verdict.
    """
    assert case.model is not None
    scene = made(case.condition, case.kind, case.seed, case.size, case.model, threads)
    options = {"refine_normals": "auto", **CONDITIONS[case.condition].options}
    result, found = measured(case, GRID.ways[case.way], scene, threads, **options)
    return {**found, "said": said(result, scene)}


def said(result: Result, scene: Scene) -> dict[str, Any]:
    """`calibration` of each map of a result, with the constant guess and the verdict."""
    told, true, guess = (
        known(result.uncertainty),
        known(scene.truth).materials,
        constant_guess(scene),
    )
    found: dict[str, Any] = {}
    for name in PARAMETERS:
        maps = (result.materials, true, told.deviation, told.low, told.high, guess)
        values = [np.asarray(getattr(of, name)[scene.valid], np.float64).ravel() for of in maps]
        of_map, verdict = calibration(*values[:5]), told.verdicts[name]
        found[name] = {
            **of_map,
            "guess": _rms(values[5] - values[1]),
            "said": verdict.level,
            "expected_error": verdict.expected_error,
            "cause": verdict.cause,
            "deserved": deserved(name, of_map["rmse"]),
        }
    return found


def calibration(
    found: Array, true: Array, deviation: Array, low: Array, high: Array
) -> dict[str, float]:
    """Errors of the values (Q,) of a map beside what is said of them.

    Returns
    -------
    `rmse`. `deviation`: the median. `within_1`, `within_2`: share of the errors within so many
    deviations. `in_interval`: share of the true values within the quantiles.
    """
    error = np.abs(found - true)
    error[error <= EXACT] = 0.0
    inside = (true >= low - EXACT) & (true <= high + EXACT)
    return {
        "rmse": _rms(error),
        "deviation": float(np.median(deviation)),
        "within_1": float(np.mean(error <= deviation)),
        "within_2": float(np.mean(error <= 2 * deviation)),
        "in_interval": float(np.mean(inside)),
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
