"""Lights from a subset of the pixels, at a cost that does not depend on the picture's size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.gauss_newton.normal_equations import Cholesky, as_in_x
from pbrfit.fit.gauss_newton.pixels import Watch, descended, place, put, schur_options, taken
from pbrfit.fit.misfit import NeighbourPairs
from pbrfit.fit.objective import Objective
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]

Visit = Callable[[Array, float], bool]
"""Called with x and its sum of squares after each joint step; whether to stop."""


@dataclass(frozen=True, eq=False)
class LightEstimate:
    """x with lights, and with the materials of the pixels that found and judged them."""

    x: Array
    """All other pixels are as they were."""
    fits: bool
    """Whether only noise is left of the validation pixels."""
    validation_pixels: NDArray[np.uint64]
    sum_sq_residuals: float
    """The pixels that judge the lights, and the sum of their squared residuals."""
    note: str
    """What was done, in words."""


@one_blas_thread()
def find_lights(objective: Objective, x: Array, watch: Watch, seed: int) -> LightEstimate:
    """Lights that explain some pixels, from those of x; where they are known, they are left.

    Few pixels may lead into a wrong valley. So where their lights leave more than noise of the
    validation pixels, others try from x. If all leave about the same, it is the model that does not
    fit; else more pixels go on from the lights that leave least.
    """
    validation = NeighbourPairs(objective)
    if objective.lighting is None:
        return LightEstimate(x.copy(), True, validation.pixels, 0.0, "lights known")
    subsets = _Subsets(objective, validation, watch, np.random.default_rng(seed))
    best = subsets.lights(settings.LIGHT_PIXELS, x)
    most = best.sum_sq_residuals
    for _ in range(settings.LIGHT_PIXELS_TRIES - 1):
        if subsets.stopped or best.fits:
            break
        found = subsets.lights(settings.LIGHT_PIXELS, x)
        most = max(most, found.sum_sq_residuals)
        best = _better(best, found)
    if best.fits or best.sum_sq_residuals <= settings.SAME_MINIMUM_RATIO * most:
        for size in settings.LIGHT_PIXELS_MORE:
            done = best.fits and (size < settings.LIGHT_PIXELS_MORE[-1] or subsets.is_exact(best))
            if not (subsets.stopped or done):
                best = _better(best, subsets.lights(size, best.x))
    counts = ", ".join(map(str, subsets.used))
    return replace(best, note=f"lights from {counts} pixels")


def _better(before: LightEstimate, found: LightEstimate) -> LightEstimate:
    return found if found.sum_sq_residuals < before.sum_sq_residuals else before


class _Subsets:
    """Subsets of the pixels, one after the other, that look for lights.

    `used` are their sizes; `stopped`, whether the watch has had enough.
    """

    def __init__(
        self,
        objective: Objective,
        validation: NeighbourPairs,
        watch: Watch,
        rng: np.random.Generator,
    ) -> None:
        self._objective, self._validation = objective, validation
        self._watch, self._rng = watch, rng
        self.used: list[int] = []
        self.stopped = False

    def lights(self, size: int, x: Array) -> LightEstimate:
        """Lights that so many pixels find from x, judged by the validation pixels."""
        objective, validation = self._objective, self._validation.pixels
        layout = objective.layout
        lights = layout.light_channels * layout.pictures * layout.coefficients
        count = min(objective.pixels, max(size, lights // settings.LIGHT_UNKNOWNS_PER_PIXEL_MAX))
        self.used.append(count)
        drawn = np.sort(self._rng.choice(objective.pixels, count, replace=False))
        chosen = drawn.astype(np.uint64)
        few = objective.restricted(chosen)

        def visit(of_few: Array, sum_sq: float) -> bool:
            materials, lights = taken(few, of_few, slice(None)), of_few[few.layout.lighting]
            share = sum_sq / few.total_weight
            self.stopped = self._watch.visit_few(chosen, materials, lights, share)
            return self.stopped

        self.stopped = False
        of_few, _ = minimize(few, objective.part_of(x, chosen), visit)
        x = x.copy()
        objective.put_part(x, chosen, of_few)
        found, sum_sq = descended(
            objective, x, validation, steps=settings.DESCENT_STEPS, starts=settings.SUBSET_STARTS
        )
        place(objective, x, validation, found)
        fits = self._validation.are_noise(x)
        return LightEstimate(x, fits, validation, float(sum_sq.sum()), "")

    def is_exact(self, lights: LightEstimate) -> bool:
        """Whether nothing is left of the validation pixels."""
        share = len(lights.validation_pixels) / self._objective.pixels
        bound = settings.SUBSET_EXACT_RMSE**2 * self._objective.total_weight * share
        return lights.sum_sq_residuals <= bound


def minimize(few: Objective, x: Array, visit: Visit) -> tuple[Array, float]:
    """Lights, and materials of these pixels, with their sum of squares, from x.

    `few` is the objective of the pixels, with unknown lights.
    """
    pixels = np.arange(few.pixels, dtype=np.uint64)
    damping, last = settings.DAMPING_START, np.inf
    total = np.inf
    for _ in range(settings.SUBSET_ROUNDS_MAX):
        found, sum_sq = descended(
            few,
            x,
            pixels,
            steps=2 * settings.DESCENT_STEPS_AFTER_JOINT,
            starts=settings.SUBSET_STARTS,
        )
        x = put(few, x, pixels, found)
        x, total, damping, stop = _joint(few, x, float(sum_sq.sum()), damping, visit)
        if not stop and total > (1 - settings.SUBSET_ROUND_GAIN_MIN) * last:
            # The loss is flat along the scale between albedo and light, and curved: look further.
            x, total, scaled = _scaled(few, x, total)
            stop = not scaled
        if stop:
            break
        last = total
    return x, total


def _joint(
    few: Objective, x: Array, total: float, damping: float, visit: Visit
) -> tuple[Array, float, float, bool]:
    """Joint steps; x, its sum of squares, the damping, and whether to stop altogether."""
    pixels = np.arange(few.pixels, dtype=np.uint64)
    done = failed = 0
    while done < settings.SUBSET_STEPS_MAX and failed < settings.SUBSET_FAILED_STEPS_MAX:
        options = schur_options(few, x, pixels, None, damping)
        matrix, gradient = few.problem.schur_complement(few.for_core(x), pixels, **options)
        try:
            moves = -Cholesky(matrix, settings.LIGHT_DAMPING * damping).solve(gradient)
        except np.linalg.LinAlgError:
            damping, failed = settings.DAMPING_GROWTH * damping, failed + 1
            continue
        if -float(gradient @ moves) < settings.SUBSET_GAIN_MIN * total:
            break
        before = total
        for share in settings.SUBSET_STEP_SHARES:
            followed = few.problem.back_substitute(
                few.for_core(x), pixels, share * moves, **options
            )
            trial = put(few, x, pixels, followed)
            trial[few.layout.lighting] += share * as_in_x(moves, few.layout)
            found, sum_sq = descended(few, trial, pixels, steps=settings.DESCENT_STEPS_AFTER_JOINT)
            if sum_sq.sum() < total:
                x, total = put(few, trial, pixels, found), float(sum_sq.sum())
                break
        done += 1
        if total < before:
            damping, failed = max(damping / settings.DAMPING_DECAY, settings.SUBSET_DAMPING_MIN), 0
        else:
            damping, failed = settings.DAMPING_GROWTH * damping, failed + 1
        if visit(x, total):
            return x, total, damping, True
        if 0 < before - total < settings.SUBSET_GAIN_MIN * before:
            break
    damping = min(max(damping, settings.SUBSET_ROUND_DAMPING_MIN), settings.DAMPING_START)
    return x, total, damping, False


def _scaled(few: Objective, x: Array, total: float) -> tuple[Array, float, bool]:
    """X with the lights of all channels or of one scaled, if that lowers the sum; whether."""
    layout = few.layout
    pixels = np.arange(few.pixels, dtype=np.uint64)
    before = total
    channels = [slice(None)]
    if layout.light_channels > 1:
        channels += [slice(c, c + 1) for c in range(layout.light_channels)]
    for channel in channels:
        for factor in settings.LIGHT_SCALE_TRIALS:
            trial = x.copy()
            trial[layout.lighting].reshape(-1, layout.light_channels)[:, channel] *= factor
            albedo = trial[layout.albedo].reshape(layout.channels, -1)
            albedo[channel] = np.clip(albedo[channel] / factor, 0, 1)
            found, sum_sq = descended(
                few,
                trial,
                pixels,
                steps=2 * settings.DESCENT_STEPS_AFTER_JOINT,
                starts=settings.SUBSET_STARTS,
            )
            if sum_sq.sum() < (1 - settings.SUBSET_GAIN_MIN) * total:
                x, total = put(few, trial, pixels, found), float(sum_sq.sum())
    return x, total, total < before
