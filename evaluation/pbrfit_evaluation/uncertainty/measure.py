"""One scene, fitted with the defaults: its posterior beside the true errors.

Shares and sums are over values: of albedo each channel of each pixel.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.decompose import decompose
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS, deserved
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.everyday.disturbances import Floats, Kind
from pbrfit_evaluation.everyday.measure import CHANNELS
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.recipes import constant_guess
from pbrfit_evaluation.uncertainty.conditions import CONDITIONS, Name, made

Array = NDArray[np.float64]

DEVIATION_EDGES = np.logspace(-4, 0, 13)
"""Edges of the bins of deviations; smaller ones are in the first bin."""

RATIO_EDGES = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, np.inf])
"""Edges of the bins of errors in deviations."""

EXACT = 1e-6
"""Error that counts as none: pictures without noise in float32 leave some 1e-7, which is rounding
and which no deviation is of."""


@dataclass(frozen=True)
class Case:
    """One scene of a condition."""

    condition: Name
    kind: Kind
    seed: int
    size: int
    model: Model

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.condition}_{self.kind}_{self.seed}"


def run(case: Case, threads: int) -> Values:
    """What the posterior of a scene says, beside what is true.

    Returns
    -------
    `maps`: by name, see `calibration`, with `guess`, the RMSE of the constant guess, and the
    verdict. `scale`: by channel, see `scale_errors`. `seconds`: of the fit, `fit`, and of what
    comes after it, `after`: the uncertainty and the final errors; empty where lamps were found,
    whose fit has its uncertainty in it.
    """
    scene = made(case.condition, case.kind, case.seed, case.size, case.model, threads)
    importlib.import_module("scipy.optimize")  # loading it is no part of a fit
    began = time.perf_counter()
    result = decompose(
        scene,
        model=case.model,
        threads=threads,
        refine_normals="auto",
        **CONDITIONS[case.condition].options,
    )
    wall = time.perf_counter() - began
    seconds = {"fit": result.seconds, "after": wall - result.seconds}
    return {**compared(result, scene), "seconds": {} if result.lamps is not None else seconds}


def compared(result: Result, scene: Scene) -> dict[str, Any]:
    """`maps` and `scale` of a result with an uncertainty and a scene with ground truth."""
    known, truth = result.uncertainty, scene.truth
    assert known is not None
    assert truth is not None
    valid, guess = scene.valid, constant_guess(scene)
    maps: dict[str, Any] = {}
    for name in PARAMETERS:

        def values(of: Materials, name: str = name) -> Array:
            return np.asarray(getattr(of, name)[valid], np.float64).ravel()

        true = values(truth.materials)
        found = calibration(
            *(values(result.materials), true),
            *(values(known.deviation), values(known.low), values(known.high)),
        )
        verdict = known.verdicts[name]
        maps[name] = {
            **found,
            "guess": _rms(values(guess) - true),
            "said": verdict.level,
            "expected_error": verdict.expected_error,
            "cause": verdict.cause,
            "deserved": deserved(name, found["rmse"]),
        }
    albedo, true_albedo = result.materials.albedo[valid], truth.materials.albedo[valid]
    return {"maps": maps, "scale": scale_errors(albedo, true_albedo, known.albedo_scale)}


def calibration(found: Array, true: Array, deviation: Array, low: Array, high: Array) -> Values:
    """Errors of the values (Q,) of a map beside what is said of them.

    Returns
    -------
    `rmse`. `deviation`: the median. `within_1`, `within_2`: share of the errors within so many
    deviations. `in_interval`: share of the true values within the quantiles. `on_bound`: how many
    of the values are 0 or 1, and of how many of them the true ones are `inside` the quantiles.
    `ratios`: counts of errors in deviations, by `RATIO_EDGES`. `reliability`: by `DEVIATION_EDGES`
    counts, sums of squared deviations and sums of squared errors.
    """
    error = np.abs(found - true)
    error[error <= EXACT] = 0.0
    inside = (true >= low - EXACT) & (true <= high + EXACT)
    bound = (found <= 0) | (found >= 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(error > 0, error / deviation, 0.0)
    last = len(RATIO_EDGES) - 2
    by_ratio = np.searchsorted(RATIO_EDGES[1:], ratios).clip(max=last)  # an edge is of the lower
    bins = np.searchsorted(DEVIATION_EDGES[1:-1], deviation)

    def sums(of: Array | None = None) -> list[float]:
        return list(map(float, np.bincount(bins, of, len(DEVIATION_EDGES) - 1)))

    return {
        "rmse": _rms(error),
        "deviation": float(np.median(deviation)),
        "within_1": float(np.mean(ratios <= 1)),
        "within_2": float(np.mean(ratios <= 2)),
        "in_interval": float(np.mean(inside)),
        "on_bound": {"count": int(bound.sum()), "inside": int(inside[bound].sum())},
        "ratios": np.bincount(by_ratio, minlength=last + 1).tolist(),
        "reliability": {
            "count": sums(),
            "deviation": sums(deviation**2),
            "error": sums(error**2),
        },
    }


def scale_errors(
    found: Floats, true: Floats, deviations: Sequence[float]
) -> dict[str, dict[str, float]]:
    """By channel the `error` of the scale of albedos (P, 3), and its `deviation`.

    The error is |ln s|, where s times the true albedo is nearest to the found one.
    """
    scales = (found * true).sum(axis=0) / np.square(true).sum(axis=0)
    errors = np.abs(np.log(np.maximum(scales, np.finfo(np.float64).tiny)))
    return {
        channel: {"error": float(error), "deviation": float(deviation)}
        for channel, error, deviation in zip(CHANNELS, errors, deviations, strict=True)
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
