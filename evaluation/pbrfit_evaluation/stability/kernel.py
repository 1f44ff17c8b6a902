"""The fast objective against float64, on random and extreme pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from pbrfit_evaluation.stability.checks import BLOCK_BOUND, ENTRY_BOUND, Check, ratio, worst_entry
from pbrfit_evaluation.stability.double_precision import Case, evaluate
from pbrfit_evaluation.stability.effort import Effort
from pbrfit_evaluation.stability.extreme_pixels import KINDS, MANY_PICTURES, make_case

LIGHT_ENTRY_BOUND = 5e-7


@dataclass(frozen=True, eq=False)
class KernelErrors:
    """Errors of loss and gradient by kind of pixel.

    `of_sum` are relative to the loss, or to the norm of a block of the gradient; `of_entry` is the
    worst entry relative to its natural scale. Both: quantity to one figure a kind.
    """

    checks: tuple[Check, ...]
    kinds: tuple[str, ...]
    pixels: int
    of_sum: dict[str, list[float]]
    of_entry: dict[str, list[float]]


QUANTITIES = ("loss", "albedo", "roughness", "metallic", "lights")


def measure_kernel(effort: Effort, rng: Generator, threads: int) -> KernelErrors:
    """Loss and gradient of random and extreme pixels against the float64 path."""
    of_sum: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    of_entry: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    pixels = 0
    for kind in (*KINDS, MANY_PICTURES):
        count, pictures = effort.pixels_of_a_kind, effort.pictures
        if kind is MANY_PICTURES:
            count, pictures = count // 32, pictures * 32
        case = make_case(rng, kind, count, pictures)
        pixels += count
        for name, whole, entry in _compare(case, threads):
            of_sum[name].append(whole)
            of_entry[name].append(entry)
    kinds = tuple(kind.name for kind in (*KINDS, MANY_PICTURES))

    def check(key: str, what: str, figures: list[float], bound: float, why: str) -> Check:
        worst = int(np.argmax(figures))
        return Check(key, what, figures[worst], bound, why, kinds[worst])

    checks = [
        check(
            "loss_error",
            "loss, relative error",
            of_sum["loss"],
            BLOCK_BOUND,
            "17 u; residuals are as large as the signal here and off by a few u of it. Where one "
            "bright picture makes the loss, the rounding of its light does not average out.",
        )
    ]
    for name in QUANTITIES[1:]:
        checks.append(
            check(
                f"{name}_block_error",
                f"gradient by {name}: error over norm of the block",
                of_sum[name],
                BLOCK_BOUND,
                "17 u; rounding of some 60 operations a number adds up at random to about √60 u, "
                "twice that where terms cancel.",
            )
        )
    for name in QUANTITIES[1:]:
        bound = LIGHT_ENTRY_BOUND if name == "lights" else ENTRY_BOUND
        why = (
            "8 u; sums over very many pixels, in which roundings average out."
            if name == "lights"
            else "34 u; the worst of millions, still below the 60 u or more that so many "
            "operations could add up to."
        )
        checks.append(
            check(
                f"{name}_entry_error",
                f"gradient by {name}: worst entry over its natural scale",
                of_entry[name],
                bound,
                why,
            )
        )
    return KernelErrors(tuple(checks), kinds, pixels, of_sum, of_entry)


def _compare(case: Case, threads: int) -> list[tuple[str, float, float]]:
    """Quantity, error relative to the whole, worst error relative to natural scale."""
    loss, gradient = case.problem(threads).value_and_grad(case.x)
    truth = evaluate(case)
    error = abs(loss - truth.loss)
    found = [("loss", ratio(error, truth.loss), ratio(error, truth.loss_scale))]
    for name, block in case.blocks().items():
        errors = gradient[block] - truth.gradient[block]
        whole = ratio(float(np.linalg.norm(errors)), float(np.linalg.norm(truth.gradient[block])))
        found.append((name, whole, worst_entry(errors, truth.gradient_scale[block])))
    return found
