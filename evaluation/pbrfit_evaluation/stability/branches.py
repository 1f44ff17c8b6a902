"""Points where formulas change: jumps, slopes, and the noise that float32 adds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from pbrfit.model.reflection import shade_vjp
from pbrfit.report.notation import scientific
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.double_precision import MODEL, Case, Pixels, compare
from pbrfit_evaluation.stability.extreme_pixels import random_case
from pbrfit_evaluation.stability.measure import Array, Rows, ratio

BRANCH = 0.4
"""Roughness at which band weights change from the closed form to series."""

CLAMP = 1e-4

STEPS = 10.0 ** np.arange(-15.0, -5.5, 0.5)
SCAN_STEPS = (1e-9, 1e-8, 1e-7, 1e-6)


def measure(rng: Generator, threads: int, pixels: int, points: int) -> Values:
    """Sweeps across r = 0, 0.4 and 1, and across the clamp of n·v at 10⁻⁴."""
    sweeps = _sweeps(pixels, rng)
    cotangent = rng.normal(size=(pixels, 3, 16))
    rows: Rows = {}
    for sweep in sweeps:
        jumps = [_shading_jump(sweep, step, cotangent) for step in STEPS]
        if sweep.in_roughness:
            rows[sweep.branch] = {"weight_jump": float(np.max(jumps))}
        else:  # no slope to subtract: only the smallest step says something
            rows[sweep.branch] = {"clamp_jump": jumps[0]}
        for step in SCAN_STEPS:
            name = f"{sweep.branch}, steps of {scientific(step)}"
            rows[name] = _scan(sweep, step, points, threads)
    return {"rows": rows}


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
        _Sweep("n·v = 10⁻⁴", case, at_cosine, -1.0, 1 - CLAMP, False),
    ]


def _shading_jump(sweep: _Sweep, step: float, cotangent: Array) -> float:
    """Jump of a random combination of the weights, relative to its terms, of the worst pixel."""
    center = sweep.center(step)
    before, after = sweep.at(center - step), sweep.at(center + step)
    low, high = before.shade(), after.shade()
    change = np.sum(cotangent * (high - low), axis=(-2, -1))
    if sweep.in_roughness:
        # A smooth function changes by the mean of its slopes times the way, up to step³.
        slopes = [shade_vjp(*p.arrays, cotangent, model=MODEL)[1] for p in (before, after)]
        change -= step * (slopes[0] + slopes[1])
    return float(np.max(np.abs(change) / np.sum(np.abs(cotangent * high), axis=(-2, -1))))


def _scan(sweep: _Sweep, step: float, points: int, threads: int) -> dict[str, float]:
    """Fast less float64 path at offsets about the branch point: largest, and step to step.

    Of the loss, relative to it, and of its slope by roughness, relative to its natural scale.
    """
    half = points // 2
    noise = []
    for offset in sweep.center(half * step) + step * np.arange(-half, half + 1.0):
        case = sweep.moved(float(np.clip(offset, sweep.low, sweep.high)))
        block = case.blocks()["roughness"]
        found = compare(case, threads)
        scale = float(found.true.gradient_scale[block].sum())
        error = float(found.gradient[block].sum() - found.true.gradient[block].sum())
        slope = math.copysign(ratio(abs(error), scale), error)
        noise.append(((found.loss - found.true.loss) / found.true.loss, slope))
    most = np.abs(noise).max(axis=0).tolist()
    jump = np.abs(np.diff(noise, axis=0)).max(axis=0).tolist()
    return {
        "fast_loss_noise": most[0],
        "fast_loss_jump": jump[0],
        "fast_gradient_noise": most[1],
        "fast_gradient_jump": jump[1],
    }
