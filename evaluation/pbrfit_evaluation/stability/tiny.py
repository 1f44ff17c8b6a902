"""Subnormal numbers, and the range of exposures."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from pbrfit._core import InputError
from pbrfit.report.notation import scientific
from pbrfit_evaluation.stability.checks import (
    ENTRY_BOUND,
    LOSS_BOUND,
    SMALLEST_NORMAL,
    Array,
    Check,
    worst_of,
)
from pbrfit_evaluation.stability.double_precision import Case, evaluate
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.extreme_pixels import random_lights, random_pixels, random_targets


@dataclass(frozen=True, eq=False)
class TinyNumbers:
    """Subnormal inputs, and the loss over the range of exposures.

    Attributes
    ----------
    exposure
        Factor on lights and pictures.
    loss_error
        Relative error of the loss at that exposure.
    """

    checks: tuple[Check, ...]
    exposure: Array
    loss_error: Array


EXPOSURES = 10.0 ** np.arange(-30.0, 20.5, 1.0)
BOUNDED = np.abs(np.log10(EXPOSURES)) < 15.5
"""Exposures from 1e-15 to 1e15, at which the loss has to be right."""

SUBNORMAL = "radiance and lights of 10⁻⁴⁰"
DIM = "lights of 10⁻³¹⁰, black pictures"
MIRROR = "roughness of 10⁻³²³ to 10⁻³⁰⁸"
SMOOTH = "roughness of 10⁻⁴⁵ to 10⁻³⁸"
DARK = "albedo and metallic of 10⁻³²³ to 10⁻³⁰⁸"
BLACK = "no light, black pictures"
UNLIT = "no light"


def measure_tiny(effort: Effort, rng: Generator, threads: int) -> TinyNumbers:
    """Radiance, lights, roughness, albedo and metallic in the subnormal ranges."""
    count, pictures = effort.subnormal_pixels, effort.pictures
    plain = Case(
        random_pixels(rng, count),
        random_lights(rng, pictures),
        random_targets(rng, pictures, count),
    )
    cases = _tiny_cases(plain, rng)
    results = {
        name: (case, *case.problem(threads).value_and_grad(case.x)) for name, case in cases.items()
    }
    not_finite = sum(
        int(np.count_nonzero(~np.isfinite(gradient))) + (not math.isfinite(loss))
        for _, loss, gradient in results.values()
    )
    worst_error, error = worst_of({name: _absolute(*result) for name, result in results.items()})

    def nonzero(case_name: str, *blocks: str) -> int:
        case, _, gradient = results[case_name]
        return sum(int(np.count_nonzero(gradient[case.blocks()[name]])) for name in blocks)

    materials = ("albedo", "roughness", "metallic")
    worst_zero, _ = worst_of(
        zeros := {
            f"all, {BLACK}": nonzero(BLACK, *materials, "lights"),
            f"materials, {UNLIT}": nonzero(UNLIT, *materials),
            f"materials, {DIM}": nonzero(DIM, *materials),
            f"roughness, {MIRROR}": nonzero(MIRROR, "roughness"),
        }
    )
    mirror = replace(plain, pixels=replace(plain.pixels, roughness=np.zeros(count)))
    loss, gradient = mirror.problem(threads).value_and_grad(mirror.x)
    _, tiny_loss, tiny_gradient = results[MIRROR]
    differing = int(np.count_nonzero(gradient != tiny_gradient)) + (loss != tiny_loss)
    exposure_error = np.array([_exposed(plain, factor, threads) for factor in EXPOSURES])
    worst_exposure = int(np.argmax(np.where(BOUNDED, exposure_error, -1)))
    slowest, slower = worst_of(
        {name: _clocked(cases[name], plain, threads) for name in (SUBNORMAL, MIRROR)}
    )
    checks = (
        Check(
            "not_finite",
            "results that are infinite or not a number",
            not_finite,
            0,
            "Every input is finite and small.",
            f"{len(cases)} cases",
        ),
        Check(
            "entry_error",
            "worst entry, error over natural scale + 10⁻³⁸",
            error,
            ENTRY_BOUND,
            "As for other pixels, but below 1.2·10⁻³⁸, the smallest normal float32, an error of "
            "that size times the same bound is allowed.",
            worst_error,
        ),
        Check(
            "nonzero",
            "entries of the gradient that should be 0 and are not",
            sum(zeros.values()),
            0,
            "Nothing depends on materials without light, and r³ underflows for r below 10⁻¹⁰⁸.",
            worst_zero if zeros[worst_zero] else f"{len(zeros)} cases",
        ),
        Check(
            "differs_from_mirror",
            "numbers that differ between r = 0 and subnormal r",
            differing,
            0,
            "r⁴ underflows, so the two are the same surface to the last bit.",
            f"{len(gradient) + 1:,} compared",
        ),
        Check(
            "exposure_error",
            "loss for exposures from 10⁻¹⁵ to 10¹⁵, relative error",
            float(exposure_error[worst_exposure]),
            LOSS_BOUND,
            "8 u, as at exposure 1: squares of 10⁻¹⁵ and 10¹⁵ lie well inside float32's range.",
            f"exposure {scientific(EXPOSURES[worst_exposure])}",
        ),
        Check(
            "time_ratio",
            "time of an evaluation over that with ordinary numbers",
            slower,
            None,
            "Some processors take a hundred cycles for a subnormal operand; a clock decides no "
            "verdict.",
            slowest,
        ),
    )
    return TinyNumbers(checks, EXPOSURES, exposure_error)


def _tiny_cases(plain: Case, rng: Generator) -> dict[str, Case]:
    """Ordinary pixels with one thing tiny."""
    p = plain.pixels
    tiny64, tiny32 = (10.0 ** rng.uniform(*span, len(p)) for span in ((-323, -308), (-45, -38)))
    black = np.zeros_like(plain.images)
    grey = np.stack([tiny64] * 3, axis=-1)
    return {
        SUBNORMAL: Case(p, 1e-40 * plain.lighting, (1e-40 * plain.images).astype(np.float32)),
        DIM: Case(p, 1e-310 * plain.lighting, black),
        MIRROR: replace(plain, pixels=replace(p, roughness=tiny64)),
        SMOOTH: replace(plain, pixels=replace(p, roughness=tiny32)),
        DARK: replace(plain, pixels=replace(p, albedo=grey, metallic=tiny64)),
        BLACK: Case(p, np.zeros_like(plain.lighting), black),
        UNLIT: replace(plain, lighting=np.zeros_like(plain.lighting)),
    }


def _absolute(case: Case, loss: float, gradient: Array) -> float:
    """Worst error over natural scale plus the smallest normal float32."""
    truth = evaluate(case)
    errors = np.abs(gradient - truth.gradient) / (truth.gradient_scale + SMALLEST_NORMAL)
    of_loss = abs(loss - truth.loss) / (truth.loss_scale + SMALLEST_NORMAL)
    return float(np.max([of_loss, errors.max()]))


def _exposed(case: Case, factor: float, threads: int) -> float:
    """Relative error of the loss with lights and pictures times a factor; refused: infinite."""
    few = slice(0, 512)
    exposed = Case(
        case.pixels[few],
        factor * case.lighting,
        (factor * case.images[:, few]).astype(np.float32),
    )
    try:
        loss, _ = exposed.problem(threads).value_and_grad(exposed.x)
    except InputError:  # beyond what float32 sums of squares can hold
        return math.inf
    truth = evaluate(exposed).loss
    return abs(loss - truth) / truth


def _clocked(case: Case, plain: Case, threads: int) -> float:
    """Best time of one over best time of the other, taken in turns."""
    runs = [(c.problem(threads), c.x) for c in (case, plain)]
    best = [math.inf, math.inf]
    for _ in range(7):
        for i, (problem, x) in enumerate(runs):
            start = time.perf_counter()
            problem.value_and_grad(x)
            best[i] = min(best[i], time.perf_counter() - start)
    return best[0] / best[1]
