"""Band weights and their slopes against exact values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.reflection import ggx_band_weights
from pbrfit.report import notation
from pbrfit.report.notation import scientific
from pbrfit_evaluation.stability.checks import BAND_BOUND, BRANCH, SLOPE_BOUND, Array, Check
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.exact_bands import ExactBands, exact_bands, paper_rule

SLOPE_RELATIVE_BOUND = 1e-14


@dataclass(frozen=True, eq=False)
class BandErrors:
    """Largest error over the four bands at every r, (M,), by three rules; NaN where one fails."""

    checks: tuple[Check, ...]
    r: Array
    value: dict[str, Array]
    slope: dict[str, Array]


RULES = ("pbrfit", "paper's rule, float64", "paper's rule, float32")


def measure_bands(effort: Effort) -> BandErrors:
    """h_l(r) and dh_l/dr over [0, 1] against 150-digit arithmetic."""
    exact = exact_bands(_roughness_grid(effort.band_points))
    r = exact.r
    found = {
        RULES[0]: ggx_band_weights(r),
        RULES[1]: paper_rule(r, np.float64),
        RULES[2]: paper_rule(r, np.float32),
    }
    value, slope = {}, {}
    checks = []
    for rule, (h, dh) in found.items():
        value[rule] = np.abs(exact.weight_errors(h))
        slope[rule] = np.abs(exact.slope_errors(dh))
    for key, errors, bound, why in (
        (
            "value",
            value,
            BAND_BOUND,
            "Weights are at most 4, whose float64 spacing is 9·10⁻¹⁶: a dozen roundings.",
        ),
        (
            "slope",
            slope,
            SLOPE_BOUND,
            "Slopes reach 10, and 25 terms of a series with its roundings make a few 10⁻¹⁴.",
        ),
    ):
        name = "h" if key == "value" else "dh/dr"
        ours = errors[RULES[0]]
        worst, where = _worst_band(r, np.where(np.isnan(ours), np.inf, ours))
        checks.append(Check(f"{key}_error", f"{name}, absolute error", worst, bound, why, where))
    checks.append(_relative_slope(exact, found[RULES[0]][1]))
    for key, name, errors in (("value", "h", value), ("slope", "dh/dr", slope)):
        for rule, short in zip(RULES[1:], ("paper_float64", "paper_float32"), strict=True):
            worst, where = _worst_band(r, errors[rule])
            checks.append(
                Check(
                    f"{short}_{key}_error",
                    f"for comparison, {rule}: {name}",
                    worst,
                    None,
                    "What the package would do if it took that rule.",
                    where + _failures(r, errors[rule]),
                )
            )
    return BandErrors(
        tuple(checks),
        r,
        {rule: errors.max(axis=-1) for rule, errors in value.items()},
        {rule: errors.max(axis=-1) for rule, errors in slope.items()},
    )


def _roughness_grid(count: int) -> Array:
    """All of [0, 1], denser towards 0, 0.4, 1 and the paper's switch."""
    part = count // 5
    steps = np.arange(-16, 17)
    near = 10.0 ** np.linspace(-17, -2, part // 2)
    switch = (1 - 1e-3) ** 0.25
    return np.unique(
        np.clip(
            np.concatenate(
                [
                    np.linspace(0, 1, 2 * part),
                    10.0 ** np.linspace(-12, -1, part),
                    10.0 ** np.linspace(-90, -12, part // 2),
                    10.0 ** np.linspace(-323, -90, part // 8),
                    [0, 5e-324, 2.2250738585072014e-308, 1e-300, 1e-81, 1e-80, 1.0],
                    BRANCH + near,
                    BRANCH - near,
                    BRANCH + np.spacing(BRANCH) * steps,
                    1 - 10.0 ** np.linspace(-17, -1, part),
                    1 - np.spacing(0.5) * np.abs(steps),
                    switch + 0.1 * near,
                    switch - 0.1 * near,
                ]
            ),
            0,
            1,
        )
    )


def _worst_band(r: Array, errors: Array) -> tuple[float, str]:
    """Largest error, of those that are numbers, and where."""
    numbers = np.where(np.isnan(errors), -1.0, errors)
    point, band = np.unravel_index(np.argmax(numbers), errors.shape)
    return float(errors[point, band]), f"{notation.band(int(band))} at r = {r[point]:.6g}"


def _failures(r: Array, errors: Array) -> str:
    failed = r[np.isnan(errors).any(axis=-1)]
    return f"; no number up to r = {scientific(failed.max())}" if failed.size else ""


def _relative_slope(exact: ExactBands, dh: NDArray[np.floating[Any]]) -> Check:
    """Near r = 0 slopes fall like r³, so that an absolute bound says nothing."""
    below = (exact.r < BRANCH) & (np.abs(exact.slope).min(axis=-1) > 1e-300)
    relative = np.abs(exact.slope_errors(dh)[below] / exact.slope[below])
    point, band = np.unravel_index(np.argmax(relative), relative.shape)
    return Check(
        "slope_relative_error",
        "dh/dr for r < 0.4, relative error",
        float(relative[point, band]),
        SLOPE_RELATIVE_BOUND,
        "Terms hardly cancel here: some dozens of roundings of 10⁻¹⁶ each, though slopes fall "
        "like r³.",
        f"{notation.band(int(band))} at r = {exact.r[below][point]:.6g}",
    )
