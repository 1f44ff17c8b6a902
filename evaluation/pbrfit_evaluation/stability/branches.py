"""Points where formulas change: jumps, slopes, and the noise that float32 adds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from pbrfit.model.reflection import ggx_band_weights, shade_vjp
from pbrfit.report.notation import scientific
from pbrfit_evaluation.stability.checks import (
    BAND_BOUND,
    BRANCH,
    LOSS_BOUND,
    SLOPE_BOUND,
    Array,
    Check,
    ratio,
    worst_of,
)
from pbrfit_evaluation.stability.double_precision import MODEL, Case, Pixels, evaluate
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.exact_bands import exact_bands
from pbrfit_evaluation.stability.extreme_pixels import random_lights, random_pixels, random_targets

CLAMP = 1e-4


@dataclass(frozen=True, eq=False)
class Scan:
    """Float32 noise of the objective while all pixels cross a branch point together.

    `loss` is relative to the loss; `gradient` that of the derivative by roughness along the sweep,
    relative to its natural scale.
    """

    branch: str
    offset: Array
    loss: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class BranchPoints:
    """Jumps at branch points against the width of the step, and noise across them."""

    checks: tuple[Check, ...]
    steps: Array
    jumps: dict[str, Array]
    scans: tuple[Scan, ...]


STEPS = 10.0 ** np.arange(-15.0, -5.5, 0.5)
SCAN_STEPS = (1e-9, 1e-8, 1e-7, 1e-6)
DRAWN_STEP = 1e-8
DIFFERENCE_STEP = 1e-4


def measure_branches(effort: Effort, rng: Generator, threads: int) -> BranchPoints:
    """Sweeps across r = 0, 0.4 and 1, and across the clamp of n·v at 10⁻⁴."""
    sweeps = _sweeps(effort.branch_pixels, rng)
    checks, jumps = _band_jumps()
    more_checks, more_jumps = _shading_jumps(sweeps, rng)
    checks += more_checks
    checks += _differences(sweeps, threads)
    noise = [
        _scan(sweep, step, effort.scan_points, threads) for sweep in sweeps for step in SCAN_STEPS
    ]
    checks += _noise_checks(noise)
    drawn = tuple(scan for scan, step in noise if step == DRAWN_STEP)
    return BranchPoints(tuple(checks), STEPS, jumps | more_jumps, drawn)


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
    pixels = random_pixels(rng, count)
    case = Case(pixels, random_lights(rng, 4), random_targets(rng, 4, count))

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
        _Sweep("r = 0", case, at_roughness(0.0), 0.0, 1.0, True),
        _Sweep("r = 0.4", case, at_roughness(BRANCH), -BRANCH, 1 - BRANCH, True),
        _Sweep("r = 1", case, at_roughness(1.0), -1.0, 0.0, True),
        _Sweep("n·v = 10⁻⁴", case, at_cosine, -1.0, 1 - CLAMP, False),
    ]


def _band_jumps() -> tuple[list[Check], dict[str, Array]]:
    """Jump of the bands' error across 0.4: what they jump beyond what they should."""
    above, below = exact_bands(BRANCH + STEPS), exact_bands(BRANCH - STEPS)
    (h_above, dh_above), (h_below, dh_below) = (ggx_band_weights(b.r) for b in (above, below))
    value = np.abs(above.weight_errors(h_above) - below.weight_errors(h_below)).max(axis=-1)
    slope = np.abs(above.slope_errors(dh_above) - below.slope_errors(dh_below)).max(axis=-1)
    checks = [
        Check(
            "band_jump",
            "h across r = 0.4, jump beyond the true change",
            float(value.max()),
            2 * BAND_BOUND,
            "Twice the bound on the error, one for each side.",
            f"step {scientific(STEPS[np.argmax(value)])}",
        ),
        Check(
            "band_slope_jump",
            "dh/dr across r = 0.4, jump beyond the true change",
            float(slope.max()),
            2 * SLOPE_BOUND,
            "Twice the bound on the error, one for each side.",
            f"step {scientific(STEPS[np.argmax(slope)])}",
        ),
    ]
    return checks, {"h at r = 0.4": value, "dh/dr at r = 0.4": slope}


def _shading_jumps(sweeps: list[_Sweep], rng: Generator) -> tuple[list[Check], dict[str, Array]]:
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
    by_roughness = [f"weights at {sweep.branch}" for sweep in sweeps if sweep.in_roughness]
    worst, jump = worst_of({name: float(jumps[name].max()) for name in by_roughness})
    (at_clamp,) = (jumps[name] for name in jumps if name not in by_roughness)
    checks = [
        Check(
            "weight_jump",
            "float64 weights across r = 0, 0.4, 1: change less slope times step",
            jump,
            BAND_BOUND,
            "No jump beyond the bands' own errors, relative to the sum of the terms' sizes.",
            worst,
        ),
        Check(
            "clamp_jump",
            f"float64 weights across n·v = 10⁻⁴, {scientific(STEPS[0])} to both sides",
            float(at_clamp[0]),
            2e-11,
            "Weights may go with the clamped cosine, of which the step is 10⁻¹¹ and the rounding "
            "of n·v some 10⁻¹²; a jump would stay as the step shrinks.",
            "relative to the sum of the terms' sizes",
        ),
    ]
    return checks, jumps


def _slope(pixels: Pixels, cotangent: Array) -> Array:
    p = pixels
    return shade_vjp(
        *(p.normals, p.views, p.albedo, p.roughness, p.metallic, cotangent), model=MODEL
    )[1]


def _differences(sweeps: list[_Sweep], threads: int) -> list[Check]:
    """Slope of the objective by all roughnesses at once against central differences in float64."""
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
        truth = evaluate(case)
        gradient = case.problem(threads).value_and_grad(case.x)[1]
        size = truth.loss + float(np.sum(truth.gradient_scale[block]))
        exact[sweep.branch] = abs(float(truth.gradient[block].sum()) - difference) / size
        fast[sweep.branch] = abs(float(gradient[block].sum()) - difference) / size
    (worst_exact, exact_error), (worst_fast, fast_error) = worst_of(exact), worst_of(fast)
    return [
        Check(
            "slope_against_difference",
            "analytic slope, float64, against a central difference",
            exact_error,
            1e-11,
            "Fourth-order difference with step 10⁻⁴: truncation and rounding both stay near "
            "10⁻¹², relative to the loss and the natural scale of the slope.",
            worst_exact,
        ),
        Check(
            "fast_slope_against_difference",
            "analytic slope, fast objective, against the same difference",
            fast_error,
            LOSS_BOUND,
            "8 u, as for the loss.",
            worst_fast,
        ),
    ]


def _scan(sweep: _Sweep, step: float, points: int, threads: int) -> tuple[Scan, float]:
    """Fast minus float64 along a sweep of equal steps."""
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
        truth = evaluate(case)
        loss.append((found - truth.loss) / truth.loss)
        scale = float(truth.gradient_scale[block].sum())
        error = float(slope[block].sum() - truth.gradient[block].sum())
        gradient.append(math.copysign(ratio(abs(error), scale), error))
    return Scan(sweep.branch, offsets, np.array(loss), np.array(gradient)), step


def _noise_checks(noise: list[tuple[Scan, float]]) -> list[Check]:
    checks = []
    for key, what, series in (
        ("loss", "noise of the loss, relative", [scan.loss for scan, _ in noise]),
        (
            "gradient",
            "noise of the slope by roughness, of its natural scale",
            [scan.gradient for scan, _ in noise],
        ),
    ):
        level = [float(np.max(np.abs(values))) for values in series]
        jump = [float(np.max(np.abs(np.diff(values)))) for values in series]
        for name, figures, text in (
            ("noise", level, f"fast objective, {what}"),
            ("jump", jump, f"fast objective, {what}: largest change from step to step"),
        ):
            worst = int(np.argmax(figures))
            scan, step = noise[worst]
            checks.append(
                Check(
                    f"fast_{key}_{name}",
                    text,
                    figures[worst],
                    LOSS_BOUND,
                    "8 u, as away from branch points; float32 makes the objective a staircase "
                    "whose steps no smaller change of x can resolve.",
                    f"{scan.branch}, steps of {scientific(step)}",
                )
            )
    return checks
