"""The fast objective near a perfect fit, where residuals are differences of equal numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from pbrfit_evaluation.stability.checks import ONE_SIGN, RANDOM, Array, Check, worst_of
from pbrfit_evaluation.stability.double_precision import Case, evaluate
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.extreme_pixels import random_lights, random_pixels


@dataclass(frozen=True, eq=False)
class Cancellation:
    """Fast objective near a perfect fit.

    Attributes
    ----------
    residual
        True root mean square residual relative to that of the signal, by form of the residuals.
    reported
        What the fast loss says it is.
    gradient_error
        Error of the whole gradient over its norm, materials and lights apart.
    """

    checks: tuple[Check, ...]
    residual: dict[str, Array]
    reported: dict[str, Array]
    gradient_error: dict[str, Array]


RESIDUALS = 10.0 ** -np.arange(1.0, 9.25, 0.5)
MEANINGFUL = 0.1
"""The loss means something while it is off by less than this fraction."""


def measure_cancellation(effort: Effort, rng: Generator, threads: int) -> Cancellation:
    """Pictures that differ from the rendered ones by 10⁻¹ to 10⁻⁹ of the signal."""
    pixels = random_pixels(rng, effort.residual_pixels)
    lighting = random_lights(rng, effort.pictures)
    signal = pixels.render(lighting, threads)
    size = math.sqrt(float(np.mean(signal**2)))
    residual: dict[str, Array] = {}
    reported: dict[str, Array] = {}
    gradient_error: dict[str, Array] = {}
    for form, noise in (
        (RANDOM, rng.normal(size=signal.shape)),
        (ONE_SIGN, np.ones(signal.shape)),
    ):
        true, found = [], []
        errors: dict[str, list[float]] = {"materials": [], "lights": []}
        for level in RESIDUALS:
            case = Case(pixels, lighting, (signal * (1 + level * noise)).astype(np.float32))
            loss, gradient = case.problem(threads).value_and_grad(case.x)
            truth = evaluate(case)
            true.append(math.sqrt(truth.loss) / size)
            found.append(math.sqrt(loss) / size)
            lights = case.blocks()["lights"]
            for name, block in (("materials", slice(lights.start)), ("lights", lights)):
                error = np.linalg.norm(gradient[block] - truth.gradient[block])
                errors[name].append(float(error / np.linalg.norm(truth.gradient[block])))
        residual[form], reported[form] = np.array(true), np.array(found)
        for name, values in errors.items():
            gradient_error[f"{name}, {form}"] = np.array(values)
    checks = _cancellation_checks(residual, reported, gradient_error)
    return Cancellation(tuple(checks), residual, reported, gradient_error)


def _cancellation_checks(
    residual: dict[str, Array],
    reported: dict[str, Array],
    gradient_error: dict[str, Array],
) -> list[Check]:
    gaps = {form: float(np.max(np.abs(reported[form] - residual[form]))) for form in residual}
    relative = {form: np.abs((reported[form] / residual[form]) ** 2 - 1) for form in residual}
    lost = {
        form: float(np.max(residual[form], where=~(relative[form] <= MEANINGFUL), initial=0.0))
        for form in residual
    }
    gradient = {name: float(values[_at(1e-3)]) for name, values in gradient_error.items()}
    averaged = gradient.pop(f"lights, {RANDOM}")
    widest, gap = worst_of(gaps)
    off_most, off = worst_of({form: float(values[_at(1e-5)]) for form, values in relative.items()})
    last, lost_at = worst_of(lost)
    highest, high = worst_of({form: float(values[_at(1e-7)]) for form, values in reported.items()})
    worst_gradient, gradient_off = worst_of(gradient)
    return [
        Check(
            "residual_floor",
            "reported less true residual, as RMS over the signal's RMS",
            gap,
            5e-7,
            "8 u: rounding adds to the residuals a few u of the terms, and the triangle "
            "inequality turns that into this.",
            widest,
        ),
        Check(
            "loss_error_at_1e-5",
            "loss at residuals of 10⁻⁵, relative error",
            off,
            0.02,
            "Residuals of 10⁻⁵ are off by some 10⁻⁷, one part in a hundred; the loss by twice that "
            "if all are off the same way.",
            off_most,
        ),
        Check(
            "loss_lost_at",
            "largest residual tried at which the loss is off by more than 10 %",
            lost_at,
            2e-6,
            "An error δ of a residual d that has one sign everywhere changes the loss by 2δ/d, "
            "which is 10 % at 20 δ; δ is one or two u.",
            last,
        ),
        Check(
            "reported_at_1e-7",
            "residual reported at a true one of 10⁻⁷",
            high,
            6e-7,
            "The residual itself and the floor.",
            highest,
        ),
        Check(
            "gradient_error_at_1e-3",
            "gradient at residuals of 10⁻³, error over norm of the block",
            gradient_off,
            1e-3,
            "Residuals of 10⁻³ carry an error of about 10⁻⁷, 10⁻⁴ of them; terms cancel in the "
            "sum over pictures, which may cost another factor of ten.",
            worst_gradient,
        ),
        Check(
            "lights_gradient_error_random_at_1e-3",
            f"gradient by lights at residuals of 10⁻³ with {RANDOM}",
            averaged,
            None,
            "No bound: random residuals average out over the pixels, the rounding of a light, "
            "which is the same in all of them, does not. So it grows with the root of their "
            "number.",
        ),
    ]


def _at(level: float) -> int:
    """Index of the residual nearest to a level."""
    return int(np.argmin(np.abs(np.log(RESIDUALS / level))))
