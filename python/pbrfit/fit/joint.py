"""Levenberg–Marquardt for lights and materials together.

The problem has the structure of bundle adjustment: five unknowns a pixel, 48 a picture, and pixels
that touch the lights only. With J the derivatives of the residuals r by a pixel's own unknowns, B
those by the lights, and both with the priors' rows, pixels are solved for first, which leaves

    S = Σ_p Bᵀ (1 − J (JᵀJ)⁻¹ Jᵀ) B + Q        s = Σ_p Bᵀ (1 − J (JᵀJ)⁻¹ Jᵀ) r + Q (L − μ)

with the prior on lights Q. S δ = −s is solved by conjugate gradients. What makes them few is a
preconditioner (`pbrfit.fit.preconditioner`), which solves a system of M' unknowns by some of the
pixels. A pixel and row of J costs it M'²/2, and a product for M lights 2 M. So one of p of P pixels
is worth p M'²/(4 P M) products, and is made anew when so many have been made: at most twice of what
is needed is spent, however long it serves (the ski rental problem). After each step every
pixel descends by itself under its new lights, and those that are worse off start again.

Offsets that clusters of pixels share in a prior are shared unknowns like the lights: without them
each step would have to be won against the priors of many pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pbrfit import _core
from pbrfit.fit import settings
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.misfit import variance
from pbrfit.fit.normal_equations import as_in_x
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import fit_all, place, taken, try_from
from pbrfit.fit.preconditioner import Solve, conjugate_gradients, preconditioner
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.sampling import Pixels, evenly_spaced_over
from pbrfit.values.arrays import Array

Stop = Callable[[], bool]
Visit = Callable[[Array, Array], bool]


@dataclass(eq=False)
class SharedFit:
    """What all pixels share, handed from one joint fit to the next."""

    lights: LightPrior
    """For one pixel."""
    inverse: Solve | None = None
    """S⁻¹ v for S of one pixel, the preconditioner; None = not made yet."""
    size: int = 0
    """Of v."""
    worth: float = 0.0
    """Products with S, times the pixels of S, that cost as much as making it anew."""
    spent: int = 0
    """Those since it was made."""

    def is_stale(self, size: int) -> bool:
        """Whether it is to be made anew for so many unknowns: others, or what it cost is spent."""
        return self.size != size or self.spent >= self.worth

    def solved(self, objective: Objective, v: Array) -> Array:
        """About S⁻¹ v of an objective's pixels; for v of the lights alone, the others held."""
        assert self.inverse is not None
        return self.inverse(v) / objective.pixels


@dataclass(eq=False)
class JointFit:
    """Some pixels and what they share at x, and the sums of squares (P,) that pixels have there.

    Shared unknowns are the lights, as the core has them, and then the offsets (clusters, F) of a
    prior that has clusters.
    """

    objective: Objective
    x: Array
    sum_sq: Array
    shared: SharedFit
    prior: GaussianPrior | None = None
    stop: Stop = lambda: False
    damping: float = 0.0

    def __post_init__(self) -> None:
        self.lights = self.shared.lights.of_pixels(self.objective.pixels)
        self.offsets = None
        if self.prior is not None and self.prior.cluster is not None:
            self.offsets = self.prior.offsets(self.x)

    @property
    def size(self) -> int:
        """Of the shared unknowns."""
        return self.lights.mean.size + (0 if self.offsets is None else self.offsets.size)

    def pixel_prior(self, offsets: Array | None) -> GaussianPrior | None:
        """The prior of each pixel by itself, with these offsets of the clusters."""
        prior = self.prior
        if prior is None or offsets is None:
            return prior
        return GaussianPrior(prior.mean + offsets[prior.cluster], prior.precision)

    def total(self, x: Array, sum_sq: Array, offsets: Array | None) -> float:
        """What is lowered, priors included."""
        total = float(sum_sq.sum()) + self.lights.cost(self.objective.lights_in_core(x).ravel())
        prior = self.pixel_prior(offsets)
        if prior is not None:
            total += prior.cost(taken(self.objective, x, slice(None))[:, self.objective.channels :])
        if offsets is not None:
            total += float((self._offset_precision * offsets**2).sum())
        return total

    @property
    def _offset_precision(self) -> Array:
        assert self.prior is not None
        return settings.OFFSET_PRECISION_SHARE * self.prior.cluster_precision

    def options(
        self, objective: Objective, x: Array, pixels: Pixels, of_all: Pixels
    ) -> dict[str, Any]:
        """For the core, of pixels of an objective that are `of_all` in this one."""
        layout = objective.layout
        found: dict[str, Any] = {
            "mono": layout.light_channels < layout.channels,
            "damping": self.damping,
        }
        if self.prior is not None:
            mean = self.prior.mean[of_all]
            if self.offsets is not None:
                assert self.prior.cluster is not None
                cluster = self.prior.cluster[of_all]
                mean = mean + self.offsets[cluster]
                found["cluster"] = cluster.astype(np.uint64), len(self.offsets)
            values = taken(objective, x, pixels)[:, layout.channels :]
            found |= {"precision": self.prior.precision[of_all], "deviation": values - mean}
        return found

    def kept_system(self, pixels: Pixels) -> _core.KeptSystem:
        """The gradient s and products with S, of some pixels without the priors of the lights."""
        options = self.options(self.objective, self.x, pixels, pixels)
        problem, for_core = self.objective.problem, self.objective.for_core(self.x)
        return problem.kept_system(for_core, pixels, **options)

    def renew_preconditioner(self) -> None:
        """Make it anew, from some pixels."""
        few, part, times, options = _sample(self, settings.COARSE_PIXELS)
        others = np.empty(0) if self.offsets is None else self._offset_precision.ravel()
        made, factored = preconditioner(few, part, times, self.lights, others, options)
        self.shared.inverse, self.shared.size = made, self.size
        self.shared.worth = factored**2 * few.pixels / (4 * self.size)
        self.shared.spent = 0

    def _system(self) -> tuple[Array, Callable[[Array], Array]]:
        """The gradient s, in order, and S v; the preconditioner is renewed where it is stale."""
        end, kept = self.lights.mean.size, self.kept_system(self.objective.everything)
        gradient = kept.gradient
        gradient[:end] += self.lights.half_gradient(self.objective.lights_in_core(self.x).ravel())
        if self.offsets is not None:
            gradient[end:] += (self._offset_precision * self.offsets).ravel()

        def product(v: Array) -> Array:
            found = kept.product(v)
            found[:end] += self.lights.product(v[:end])
            if self.offsets is not None:
                found[end:] += self._offset_precision.ravel() * v[end:]
            return np.asarray(found)

        if self.shared.is_stale(self.size):
            self.renew_preconditioner()
        return gradient, product

    def shared_moves(self, enough: float) -> tuple[Array, float]:
        """δ with (S + damping) δ ≈ −s by preconditioned conjugate gradients, and what it gains.

        The latter is by how much the sum falls in the quadratic model; if it cannot exceed
        `enough`, no product is made.
        """
        gradient, product = self._system()
        moves = self._conjugate_gradients(-gradient, product, enough, settings.CG_ERROR_RATIO)
        return moves, -float(gradient @ moves)

    def inverse(self) -> tuple[Array, Callable[[Array], Array]]:
        """The gradient s of all pixels, and S⁻¹ v."""
        gradient, product = self._system()
        ratio = settings.NUISANCE_ERROR_RATIO
        return gradient, lambda v: self._conjugate_gradients(v, product, 0.0, ratio)

    def _conjugate_gradients(
        self, right: Array, product: Callable[[Array], Array], enough: float, ratio: float
    ) -> Array:
        """S⁻¹ `right`, or 0 if nothing like `enough` is to be gained."""
        solved = partial(self.shared.solved, self.objective)
        moves, number = conjugate_gradients(
            right,
            product,
            solved,
            ratio=ratio,
            enough=enough,
            at_most=max(
                settings.CG_ITERATIONS_MAX, round(self.shared.worth / self.objective.pixels)
            ),
            stop=self.stop,
        )
        self.shared.spent += number * self.objective.pixels
        return moves

    def step(self, moves: Array, total: float) -> float | None:
        """The sum after the longest step of a few that lowers it, which is taken; None if none."""
        objective, trial = self.objective, np.empty_like(self.x)
        end, every = self.lights.mean.size, objective.everything
        options = self.options(objective, self.x, every, every)
        for share in settings.GLOBAL_STEP_SHARES:
            moved = share * moves
            trial[:] = self.x
            trial[objective.layout.lighting] += as_in_x(moved[:end], objective.layout)
            offsets = self.offsets
            if offsets is not None:
                offsets = offsets + moved[end:].reshape(offsets.shape)
            followed = objective.problem.back_substitute(
                objective.for_core(self.x), every, moved, **options
            )
            place(objective, trial, every, followed)
            prior = self.pixel_prior(offsets)
            steps, stop = settings.DESCENT_STEPS_AFTER_JOINT, self.stop
            left = fit_all(objective, trial, starts=0, steps=steps, prior=prior, stop=stop)
            if left is None:
                return None
            # Pixels that the step left worse off start again.
            worse = np.flatnonzero(left > settings.WORSE_RATIO * self.sum_sq).astype(np.uint64)
            rows = None if prior is None else prior.rows(worse)
            own = taken(objective, self.x, worse)
            try_from(objective, trial, left, worse, own, steps=2 * steps, starts=1, prior=rows)
            lower = self.total(trial, left, offsets)
            if lower < total:
                self.x[:], self.sum_sq[:], self.offsets = trial, left, offsets
                return lower
        return None


def _sample(fit: JointFit, at_most: int) -> tuple[Objective, Array, float, dict[str, Any]]:
    """At most so many pixels, some of each cluster, whose system stands for that of all.

    Their objective, in which samples weigh by how many pixels theirs stands for, over the most;
    their x; that most; and the options for the core.
    """
    whole = fit.objective
    if whole.pixels <= at_most:
        every = whole.everything
        return whole, fit.x, 1.0, fit.options(whole, fit.x, every, every)
    cluster = np.zeros(whole.pixels, np.intp)
    if fit.prior is not None and fit.prior.cluster is not None:
        cluster = fit.prior.cluster
    pixels = evenly_spaced_over(cluster, at_most)
    counts, of_few = np.bincount(cluster), np.bincount(cluster[pixels])
    standing_for = counts[cluster[pixels]] / of_few[cluster[pixels]]
    times = float(standing_for.max())
    shares = standing_for / times
    few, part = whole.restricted(pixels, shares), whole.part_of(fit.x, pixels)
    options = fit.options(few, part, few.everything, pixels)
    if "precision" in options:
        options["precision"] = options["precision"] * shares[:, None]
    return few, part, times, options


def minimize(fit: JointFit, steps: int, gain: float, visit: Visit | None = None) -> int:
    """At most so many joint steps from x, which changes; returns how many.

    Until one promises to lower the sum by less than `gain` times the residuals' variance. `visit`
    is called after each step, with x and the pixels' sums, and says whether to stop.
    """
    done, total = 0, fit.total(fit.x, fit.sum_sq, fit.offsets)
    while done < steps and total > 0:
        worth = gain * variance(fit.objective, fit.sum_sq)
        moves, predicted = fit.shared_moves(worth)
        if not predicted >= worth or fit.stop():
            break
        lower = fit.step(moves, total)
        if lower is None:
            if fit.damping >= settings.GLOBAL_DAMPING_MAX or fit.stop():
                break
            fit.damping = max(settings.GLOBAL_DAMPING_FACTOR * fit.damping, settings.DAMPING_START)
            continue
        fit.damping /= settings.GLOBAL_DAMPING_FACTOR
        if fit.damping < settings.DAMPING_START:
            fit.damping = 0.0
        done, total = done + 1, lower
        if visit is not None and visit(fit.x, fit.sum_sq):
            break
    return done
