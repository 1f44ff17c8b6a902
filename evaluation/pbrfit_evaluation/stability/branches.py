"""Points where formulas change: jumps, slopes, and the noise that float32 adds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from pbrfit.model.reflection import ggx_band_weights, shade_vjp
from pbrfit.report.notation import scientific
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.double_precision import MODEL, Case, Pixels, evaluate
from pbrfit_evaluation.stability.exact_bands import exact_bands
from pbrfit_evaluation.stability.extreme_pixels import random_case
from pbrfit_evaluation.stability.measure import BRANCH, Array, Effort, Figure, ratio, worst

CLAMP = 1e-4
AT_CLAMP = "n·v = 10⁻⁴"

STEPS = 10.0 ** np.arange(-15.0, -5.5, 0.5)
SCAN_STEPS = (1e-9, 1e-8, 1e-7, 1e-6)
DRAWN_STEP = 1e-8
DIFFERENCE_STEP = 1e-4


def measure(effort: Effort, rng: Generator, threads: int) -> Values:
    """Sweeps across r = 0, 0.4 and 1, and across the clamp of n·v at 10⁻⁴.

    `jumps`, by what jumps: unexplained change for each of `STEPS`. `scans`, by branch point: the
    float32 noise of the objective while all pixels cross it in steps of `DRAWN_STEP`.
    """
    sweeps = _sweeps(effort.branch_pixels, rng)
    jumps = _band_jumps() | _shading_jumps(sweeps, rng)
    by_roughness = {
        name: jump.max()
        for name, jump in jumps.items()
        if name.startswith("weights") and AT_CLAMP not in name
    }
    exact, fast = _differences(sweeps, threads)
    figures: dict[str, Figure] = {
        "band_jump": _worst_step(jumps["h at r = 0.4"]),
        "band_slope_jump": _worst_step(jumps["dh/dr at r = 0.4"]),
        "weight_jump": worst(by_roughness),
        "clamp_jump": (float(jumps[f"weights at {AT_CLAMP}"][0]), f"step {scientific(STEPS[0])}"),
        "slope_against_difference": worst(exact),
        "fast_slope_against_difference": worst(fast),
    }
    scans = {
        (sweep.branch, step): _scan(sweep, step, effort.scan_points, threads)
        for sweep in sweeps
        for step in SCAN_STEPS
    }
    for i, key in ((1, "loss"), (2, "gradient")):
        noise = {
            f"{branch}, steps of {scientific(step)}": scan[i]
            for (branch, step), scan in scans.items()
        }
        figures[f"fast_{key}_noise"] = worst({n: np.abs(v).max() for n, v in noise.items()})
        figures[f"fast_{key}_jump"] = worst({n: np.abs(np.diff(v)).max() for n, v in noise.items()})
    return {
        "figures": figures,
        "jumps": {name: jump.tolist() for name, jump in jumps.items()},
        "scans": {
            branch: dict(
                zip(("offset", "loss", "gradient"), (v.tolist() for v in scan), strict=True)
            )
            for (branch, step), scan in scans.items()
            if step == DRAWN_STEP
        },
    }


def _worst_step(jumps: Array) -> Figure:
    return worst({f"step {scientific(s)}": j for s, j in zip(STEPS, jumps, strict=True)})


@dataclass(frozen=True, eq=False)
class _Sweep:
    """Pixels that cross a branch point together; offsets outside [low, high] leave the model."""

    branch: str
    case: Case
    at: Callable[[float], Pixels]
    low: float
    high: float
    in_roughness: bool

    def moved(self, offset: float) -> Case:
        return replace(self.case, pixels=self.at(offset))

    def center(self, reach: float) -> float:
        """The offset nearest the branch point with room for `reach` on both sides."""
        return min(max(0.0, self.low + reach), self.high - reach)


def _sweeps(count: int, rng: Generator) -> list[_Sweep]:
    case = random_case(rng, count, 4)
    pixels = case.pixels

    def at_roughness(branch: float) -> Callable[[float], Pixels]:
        return lambda offset: replace(pixels, roughness=np.full(count, branch + offset))

    across = np.cross(pixels.views, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)

    def at_cosine(offset: float) -> Pixels:
        cosine = CLAMP + offset
        return replace(
            pixels, normals=cosine * pixels.views + math.sqrt(1 - cosine * cosine) * across
        )

    return [
        *(
            _Sweep(f"r = {branch:g}", case, at_roughness(branch), -branch, 1 - branch, True)
            for branch in (0.0, BRANCH, 1.0)
        ),
        _Sweep(AT_CLAMP, case, at_cosine, -1.0, 1 - CLAMP, False),
    ]


def _band_jumps() -> dict[str, Array]:
    """Jump of the bands' error across 0.4: what they jump beyond what they should."""
    above, below = exact_bands(BRANCH + STEPS), exact_bands(BRANCH - STEPS)
    (h_above, dh_above), (h_below, dh_below) = (ggx_band_weights(b.r) for b in (above, below))
    value = np.abs(above.weight_errors(h_above) - below.weight_errors(h_below)).max(axis=-1)
    slope = np.abs(above.slope_errors(dh_above) - below.slope_errors(dh_below)).max(axis=-1)
    return {"h at r = 0.4": value, "dh/dr at r = 0.4": slope}


def _shading_jumps(sweeps: list[_Sweep], rng: Generator) -> dict[str, Array]:
    """Jumps of a random combination of the weights, pixel by pixel, relative to its terms."""
    jumps = {}
    cotangent = rng.normal(size=(len(sweeps[0].case.pixels), 3, 16))
    for sweep in sweeps:
        rows = []
        for step in STEPS:
            center = sweep.center(step)
            before, after = (sweep.at(center - step), sweep.at(center + step))
            low, high = before.shade(), after.shade()
            change = np.sum(cotangent * (high - low), axis=(-2, -1))
            if sweep.in_roughness:
                # A smooth function changes by the mean of its slopes times the way, up to step³.
                change -= step * (_slope(before, cotangent) + _slope(after, cotangent))
            rows.append(np.max(np.abs(change) / np.sum(np.abs(cotangent * high), axis=(-2, -1))))
        jumps[f"weights at {sweep.branch}"] = np.array(rows)
    return jumps


def _slope(pixels: Pixels, cotangent: Array) -> Array:
    return shade_vjp(*pixels.arrays, cotangent, model=MODEL)[1]


def _differences(sweeps: list[_Sweep], threads: int) -> tuple[dict[str, float], dict[str, float]]:
    """Slope of the objective by all roughnesses at once against central differences in float64.

    Of the float64 path and of the fast objective, by branch point.
    """
    exact, fast = {}, {}
    for sweep in sweeps:
        if not sweep.in_roughness:
            continue
        h = DIFFERENCE_STEP
        center = sweep.center(2 * h)
        losses = [evaluate(sweep.moved(center + k * h)).loss for k in (-2, -1, 1, 2)]
        difference = (losses[0] - 8 * losses[1] + 8 * losses[2] - losses[3]) / (12 * h)
        case = sweep.moved(center)
        block = case.blocks()["roughness"]
        true = evaluate(case)
        gradient = case.problem(threads).value_and_grad(case.x)[1]
        size = true.loss + float(np.sum(true.gradient_scale[block]))
        exact[sweep.branch] = abs(float(true.gradient[block].sum()) - difference) / size
        fast[sweep.branch] = abs(float(gradient[block].sum()) - difference) / size
    return exact, fast


def _scan(sweep: _Sweep, step: float, points: int, threads: int) -> tuple[Array, Array, Array]:
    """Offsets, and fast less float64 path there.

    Of the loss, relative to it, and of its slope by roughness, relative to its natural scale.
    """
    half = points // 2
    offsets: Array = sweep.center(half * step) + step * np.arange(-half, half + 1.0)
    loss, gradient = [], []
    problem = sweep.case.problem(threads)
    block = sweep.case.blocks()["roughness"]
    for offset in offsets:
        case = sweep.moved(float(np.clip(offset, sweep.low, sweep.high)))
        if not sweep.in_roughness:
            problem = case.problem(threads)
        found, slope = problem.value_and_grad(case.x)
        true = evaluate(case)
        loss.append((found - true.loss) / true.loss)
        scale = float(true.gradient_scale[block].sum())
        error = float(slope[block].sum() - true.gradient[block].sum())
        gradient.append(math.copysign(ratio(abs(error), scale), error))
    return offsets, np.array(loss), np.array(gradient)
