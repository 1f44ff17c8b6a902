"""Sums over millions of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit_evaluation.stability.checks import (
    ENTRY_BOUND,
    LOSS_BOUND,
    ONE_SIGN,
    RANDOM,
    ROUNDING,
    Array,
    Check,
    worst_entry,
)
from pbrfit_evaluation.stability.double_precision import Case, sums
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.extreme_pixels import random_lights, random_pixels, random_targets


@dataclass(frozen=True, eq=False)
class Accumulation:
    """Errors of the sums over all samples against their number, by form of the residuals.

    Attributes
    ----------
    samples
        Pixels times pictures.
    loss
        Relative error of the loss.
    lights
        Worst error of the gradient by the lights, relative to the sum of its terms' sizes.
    naive
        Relative error of the loss when all squares are added up one by one in float32.
    """

    checks: tuple[Check, ...]
    samples: NDArray[np.int64]
    loss: dict[str, Array]
    lights: dict[str, Array]
    naive: dict[str, Array]


ALIKE = "one sign, all pixels alike"
FORMS = (RANDOM, ONE_SIGN, ALIKE)

EQUAL_TERMS_BOUND = 256 * ROUNDING

FEW_PIXELS = 1024
MANY = 256
"""Pixels and pictures of the problems in which equal terms are looked for a bad value."""


def measure_accumulation(effort: Effort, rng: Generator, threads: int) -> Accumulation:
    """Loss and light gradients of up to 16 million samples against float64 sums."""
    samples = np.array([pixels * effort.summed_pictures for pixels in effort.summed_pixels])
    loss: dict[str, list[float]] = {form: [] for form in FORMS}
    lights: dict[str, list[float]] = {form: [] for form in FORMS}
    naive: dict[str, list[float]] = {form: [] for form in FORMS}
    for form in FORMS:
        for pixels in effort.summed_pixels:
            case = _summed_case(form, pixels, effort.summed_pictures, rng, threads)
            of_loss, of_lights, truth = _sum_errors(case, threads)
            loss[form].append(of_loss)
            lights[form].append(of_lights)
            naive[form].append(_naive_error(case, truth, threads))
    bounds = {
        ("loss", RANDOM): (LOSS_BOUND, "8 u, as for few samples: float64 takes over early."),
        ("loss", ONE_SIGN): (
            ENTRY_BOUND,
            "34 u; residuals are 3/10 of the signal here, and the rounding of a light is the same "
            "in all pixels: a few u of the signal are three times as many of the residual, and "
            "twice that in its square.",
        ),
        ("lights", RANDOM): (ENTRY_BOUND, "34 u, as for the entries of the gradient."),
        ("lights", ONE_SIGN): (ENTRY_BOUND, "34 u, as for the entries of the gradient."),
    }
    checks = []
    for quantity, what, figures in (
        ("loss", "loss, relative error", loss),
        ("lights", "gradient by lights: worst entry over its terms", lights),
    ):
        for form, short in ((RANDOM, "random"), (ONE_SIGN, "one_sign")):
            worst = int(np.argmax(figures[form]))
            bound, why = bounds[quantity, form]
            checks.append(
                Check(
                    f"{quantity}_error_{short}",
                    f"{what}, {form}",
                    figures[form][worst],
                    bound,
                    why,
                    f"{samples[worst]:,} samples",
                )
            )
    checks += _equal_terms(effort, rng, threads, loss[ALIKE], lights[ALIKE])
    pixels, pictures = effort.summed_many
    errors = _sum_errors(_summed_case(RANDOM, pixels, pictures, rng, threads), threads)
    checks.append(
        Check(
            "error_many_pictures",
            f"loss and lights, {RANDOM}, {pictures} pictures of {pixels:,} pixels",
            float(np.max(errors[:2])),
            ENTRY_BOUND,
            "34 u, however samples are divided into pixels and pictures.",
            "loss" if errors[0] > errors[1] else "lights",
        )
    )
    return Accumulation(
        tuple(checks),
        samples,
        {form: np.array(values) for form, values in loss.items()},
        {form: np.array(values) for form, values in lights.items()},
        {form: np.array(values) for form, values in naive.items()},
    )


def _equal_terms(
    effort: Effort, rng: Generator, threads: int, of_loss: list[float], of_lights: list[float]
) -> list[Check]:
    """The worst of many values for terms that are all equal, and of the errors given."""
    few, lights = list(of_loss), list(of_lights)
    many: list[float] = []
    for _ in range(effort.draws):
        for found, pictures in ((few, effort.summed_pictures), (many, MANY)):
            case = _summed_case(ALIKE, FEW_PIXELS, pictures, rng, threads)
            loss_error, lights_error, _ = _sum_errors(case, threads)
            found.append(loss_error)
            lights.append(lights_error)
    why = (
        "256 u; equal terms round equally. A float32 sum of n equal terms is off by up to n/4 u, "
        "and blocks hold up to a thousand."
    )
    where = f"{effort.draws} draws"
    return [
        Check(
            "loss_error_equal",
            f"loss, relative error, {ALIKE}, {effort.summed_pictures} pictures",
            float(np.max(few)),
            EQUAL_TERMS_BOUND,
            why,
            where,
        ),
        Check(
            "loss_error_equal_many",
            f"loss, relative error, {ALIKE}, {MANY} pictures",
            float(np.max(many)),
            EQUAL_TERMS_BOUND,
            "The same: pictures are no reason to sum for longer.",
            where,
        ),
        Check(
            "lights_error_equal",
            f"gradient by lights: worst entry over its terms, {ALIKE}",
            float(np.max(lights)),
            EQUAL_TERMS_BOUND,
            why,
            where,
        ),
    ]


def _sum_errors(case: Case, threads: int) -> tuple[float, float, float]:
    """Error of the loss, of the gradient by lights, and the true loss."""
    found, gradient = case.problem(threads).value_and_grad(case.x)
    truth = sums(case)
    errors = gradient[case.blocks()["lights"]] - truth.by_lights
    return (
        abs(found - truth.loss) / truth.loss,
        worst_entry(errors, truth.by_lights_scale),
        truth.loss,
    )


def _summed_case(form: str, count: int, pictures: int, rng: Generator, threads: int) -> Case:
    pixels = random_pixels(rng, count)
    lighting = random_lights(rng, pictures, variation=0.5 if form == RANDOM else 0.1)
    if form == RANDOM:
        return Case(pixels, lighting, random_targets(rng, pictures, count))
    if form == ALIKE:
        pixels = pixels[np.zeros(count, dtype=np.intp)]
        lighting = np.repeat(lighting[:1], pictures, axis=0)
    images = np.empty((pictures, count, 3), dtype=np.float32)
    step = 16384
    for start in range(0, count, step):
        rows = slice(start, start + step)
        images[:, rows] = 0.7 * pixels[rows].render(lighting, threads)
    return Case(pixels, lighting, images)


def _naive_error(case: Case, loss: float, threads: int) -> float:
    """Error of a float32 running sum of the squared residuals."""
    total = np.float32(0)
    step = 65536
    for start in range(0, len(case.pixels), step):
        rows = slice(start, start + step)
        residual = case.pixels[rows].render(case.lighting, threads) - case.images[:, rows]
        squares = np.square(residual.astype(np.float32)).ravel()
        # numpy's sums are pairwise, its running sums are not.
        total = np.cumsum(np.concatenate([[total], squares]), dtype=np.float32)[-1]
    return abs(float(total) / case.images.size - loss) / loss
