"""Subnormal numbers, and the range of exposures."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from pbrfit._core import InputError
from pbrfit.report.notation import scientific
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.stability.double_precision import Case, evaluate
from pbrfit_evaluation.stability.extreme_pixels import random_case
from pbrfit_evaluation.stability.measure import Array, Effort, count, worst

SMALLEST_NORMAL = float(np.finfo(np.float32).tiny)

EXPOSURES = 10.0 ** np.arange(-30.0, 20.5, 1.0)
"""Factors on lights and pictures."""

BOUNDED = np.abs(np.log10(EXPOSURES)) < 15.5
"""Exposures from 1e-15 to 1e15, at which the loss has to be right."""

SUBNORMAL = "radiance and lights of 10⁻⁴⁰"
DIM = "lights of 10⁻³¹⁰, black pictures"
MIRROR = "roughness of 10⁻³²³ to 10⁻³⁰⁸"
SMOOTH = "roughness of 10⁻⁴⁵ to 10⁻³⁸"
DARK = "albedo and metallic of 10⁻³²³ to 10⁻³⁰⁸"
BLACK = "no light, black pictures"
UNLIT = "no light"

MATERIALS = ("albedo", "roughness", "metallic")
MUST_BE_ZERO = {
    BLACK: (*MATERIALS, "lights"),
    UNLIT: MATERIALS,
    DIM: MATERIALS,
    MIRROR: ("roughness",),
}
"""Blocks of the gradient that are 0."""


def measure(effort: Effort, rng: Generator, threads: int) -> Values:
    """Radiance, lights, roughness, albedo and metallic in the subnormal ranges; exposures."""
    plain = random_case(rng, effort.subnormal_pixels, effort.pictures)
    cases = _tiny_cases(plain, rng)
    found = {name: case.problem(threads).value_and_grad(case.x) for name, case in cases.items()}
    not_finite = sum(
        int(np.count_nonzero(~np.isfinite(gradient))) + (not math.isfinite(loss))
        for loss, gradient in found.values()
    )
    nonzero = {
        f"{', '.join(blocks)}: {name}": sum(
            int(np.count_nonzero(found[name][1][cases[name].blocks()[block]])) for block in blocks
        )
        for name, blocks in MUST_BE_ZERO.items()
    }
    mirror = replace(plain, pixels=replace(plain.pixels, roughness=np.zeros(len(plain.pixels))))
    loss, gradient = mirror.problem(threads).value_and_grad(mirror.x)
    tiny_loss, tiny_gradient = found[MIRROR]
    differing = int(np.count_nonzero(gradient != tiny_gradient)) + (loss != tiny_loss)
    exposed = [_exposed(plain, factor, threads) for factor in EXPOSURES]
    bounded = {f"exposure {scientific(EXPOSURES[i])}": exposed[i] for i in np.flatnonzero(BOUNDED)}
    times = {name: _clocked(cases[name], plain, threads) for name in (SUBNORMAL, MIRROR)}
    return {
        "figures": {
            "not_finite": (not_finite, f"{len(cases)} cases"),
            "entry_error": worst({n: _absolute(case, *found[n]) for n, case in cases.items()}),
            "nonzero": count(nonzero, "cases"),
            "differs_from_mirror": (differing, f"{len(gradient) + 1:,} compared"),
            "exposure_error": worst(bounded),
            "time_ratio": worst(times),
        },
        "exposure_error": exposed,
    }


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
    true = evaluate(case)
    errors = np.abs(gradient - true.gradient) / (true.gradient_scale + SMALLEST_NORMAL)
    of_loss = abs(loss - true.loss) / (true.loss_scale + SMALLEST_NORMAL)
    return float(np.max([of_loss, errors.max()]))


def _exposed(case: Case, factor: float, threads: int) -> float:
    """Relative error of the loss with lights and pictures times a factor; refused: infinite."""
    few = slice(0, 512)
    images = (factor * case.images[:, few]).astype(np.float32)
    exposed = Case(case.pixels[few], factor * case.lighting, images)
    try:
        loss, _ = exposed.problem(threads).value_and_grad(exposed.x)
    except InputError:  # beyond what float32 sums of squares can hold
        return math.inf
    true = evaluate(exposed).loss
    return abs(loss - true) / true


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
