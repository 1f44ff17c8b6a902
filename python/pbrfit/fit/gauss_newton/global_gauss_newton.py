"""All pixels' materials, and joint steps with the lights, whose system is never formed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.gauss_newton.normal_equations import Cholesky, as_in_x
from pbrfit.fit.gauss_newton.pixels import (
    Pixels,
    Watch,
    chunks,
    fit_all,
    pieces,
    place,
    retry_outliers,
    schur_options,
    taken,
    try_from,
)
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]
Stop = Callable[[], bool]

_Piece = Callable[[Array], Array]
"""S v of some pixels."""

Visit = Callable[[Array, Array], bool]
"""Called with x and the pixels' sums of squares after each step; whether to stop."""


@one_blas_thread()
def fit_materials(objective: Objective, x: Array, watch: Watch) -> Array | None:
    """All pixels' materials for the lights of x, then both together; x changes.

    Returns the pixels' sums of squared residuals (P,), or None if time ran out before all pixels
    had materials.
    """
    sum_sq = fit_all(objective, x, starts=1, stop=watch.stop)
    if sum_sq is None:
        return None
    retry_outliers(objective, x, sum_sq, watch.stop)
    stop = watch.visit(x, sum_sq)
    if objective.lighting is None:
        return sum_sq
    for _ in range(settings.GLOBAL_ROUNDS_MAX):
        if stop:
            break
        minimize(objective, x, sum_sq, watch.visit, watch.stop)
        before = float(sum_sq.sum())
        retry_outliers(objective, x, sum_sq, watch.stop)
        left = float(sum_sq.sum())
        if left < before:
            stop = watch.visit(x, sum_sq)
        if left >= (1 - settings.RETRY_GAIN_MIN) * before:
            break
    return sum_sq


@one_blas_thread()
def fit_with_prior(objective: Objective, x: Array, prior: GaussianPrior, watch: Watch) -> None:
    """Squares and prior together as low as they get from x, which changes.

    The prior's offsets are put to their best values in turns with all else. Where time runs out
    before all pixels have had their turn, x is as it was before it.
    """
    data = np.inf
    for turn in range(settings.PRIOR_TURNS_MAX):
        fixed = GaussianPrior(prior.prior_mean(x), prior.precision)
        starts = 1 if turn == 0 else 0
        before_turn = x.copy()
        sum_sq = fit_all(objective, x, starts=starts, prior=fixed, stop=watch.stop)
        if sum_sq is None:
            x[:] = before_turn
            break
        del before_turn  # of the size of x, which counts
        if objective.lighting is not None:
            minimize(objective, x, sum_sq, lambda *_: watch.stop(), watch.stop, fixed)
        stop = watch.visit(x, sum_sq)
        before, data = data, float(sum_sq.sum())
        if stop or abs(before - data) < settings.PRIOR_TURN_CHANGE_MIN * data:
            break


def minimize(
    objective: Objective,
    x: Array,
    sum_sq: Array,
    visit: Visit,
    stop: Stop,
    prior: GaussianPrior | None = None,
) -> None:
    """Joint steps that lower the sum of squares and prior; x and the sums of pixels (P,) change."""
    fit = _JointFit(objective, x, sum_sq, prior, stop)
    total = fit.total(x, sum_sq)
    for _ in range(settings.GLOBAL_STEPS_MAX):
        if total == 0:
            break
        worth = settings.GLOBAL_PREDICTED_GAIN_MIN * total
        moves, predicted = fit.light_moves(worth)
        if predicted < worth or stop():
            break
        lower = fit.step(moves, total)
        if lower is None:
            if fit.damping >= settings.GLOBAL_DAMPING_MAX or stop():
                break
            fit.damping = max(settings.GLOBAL_DAMPING_FACTOR * fit.damping, settings.DAMPING_START)
            continue
        fit.damping = (
            0.0
            if fit.damping <= settings.DAMPING_START
            else fit.damping / settings.GLOBAL_DAMPING_FACTOR
        )
        gain, total = 1 - lower / total, lower
        if visit(x, sum_sq) or gain < settings.GLOBAL_GAIN_MIN:
            break


@dataclass(eq=False)
class _JointFit:
    """All pixels and the lights at x, and the sums of squares (P,) that pixels have there."""

    objective: Objective
    x: Array
    sum_sq: Array
    prior: GaussianPrior | None
    stop: Stop
    damping: float = 0.0

    def total(self, x: Array, sum_sq: Array) -> float:
        """The sum that is lowered, prior included."""
        total = float(sum_sq.sum())
        if self.prior is not None:
            materials = taken(self.objective, x, slice(None))
            total += self.prior.cost(materials[:, self.objective.channels :])
        return total

    def _rows(self, pixels: Pixels) -> GaussianPrior | None:
        return None if self.prior is None else self.prior.rows(pixels)

    def _options(self, pixels: Pixels) -> dict[str, Any]:
        return schur_options(self.objective, self.x, pixels, self.prior, self.damping)

    def _preconditioner(self) -> Cholesky:
        """The system of some pixels, scaled up to all."""
        objective = self.objective
        chosen = evenly_spaced(objective.pixels, settings.PRECONDITIONER_PIXELS)
        few = objective.restricted(chosen)
        part, pixels = objective.part_of(self.x, chosen), np.arange(len(chosen), dtype=np.uint64)
        options = schur_options(few, part, pixels, self._rows(chosen), self.damping)
        matrix, _ = few.problem.schur_complement(few.for_core(part), pixels, **options)
        matrix *= objective.pixels / len(chosen)
        return Cholesky(matrix, settings.PRECONDITIONER_DAMPING)

    def _system(self) -> tuple[list[_Piece], Array] | None:
        """All pixels' parts of S, in order, so that sums are always the same; and s.

        None if stopped.
        """
        objective, layout = self.objective, self.objective.layout
        derivatives = 3 if objective.tangent_offsets is None else 5
        of_samples = layout.pictures * (derivatives + (objective.weights is not None))
        of_pixel = 4 * objective.channels * (layout.coefficients + of_samples)
        left = settings.KEPT_SYSTEM_BYTES // of_pixel
        parts: list[_Piece] = []
        gradient = np.zeros(layout.light_channels * layout.pictures * layout.coefficients)
        for chunk in chunks(objective.pixels):
            if self.stop():
                return None
            x, options = objective.for_core(self.x), self._options(chunk)
            if len(chunk) <= left:
                kept = objective.problem.kept_system(x, chunk, **options)
                left -= len(chunk)
                parts.append(kept.product)
                gradient += kept.gradient
            else:
                parts.append(self._made_anew(x, chunk, options))
                nothing = np.zeros_like(gradient)
                gradient += objective.problem.schur_product(x, chunk, nothing, **options)[1]
        return parts, gradient

    def _made_anew(self, x: Array, pixels: Pixels, options: dict[str, Any]) -> _Piece:
        def product(v: Array) -> Array:
            return self.objective.problem.schur_product(x, pixels, v, **options)[0]

        return product

    def _product(self, parts: list[_Piece], v: Array) -> Array | None:
        """S v; None if stopped."""
        total = np.zeros_like(v)
        for part in parts:
            if self.stop():
                return None
            total += part(v)
        return total

    def light_moves(self, enough: float) -> tuple[Array, float]:
        """δ with (S + damping) δ ≈ −s by preconditioned conjugate gradients, and what it gains.

        The latter is by how much the sum falls in the quadratic model; if it cannot exceed
        `enough`, no product is made.
        """
        layout = self.objective.layout
        moves = np.zeros(layout.light_channels * layout.pictures * layout.coefficients)
        try:
            preconditioner = self._preconditioner()
        except np.linalg.LinAlgError:
            return moves, 0.0
        system = self._system()
        if system is None:
            return moves, 0.0
        parts, gradient = system
        residual = -gradient
        direction = preconditioned = preconditioner.solve(residual)
        first = size_now = float(residual @ preconditioned)
        if not first >= enough:
            return moves, 0.0
        predicted = 0.0
        for _ in range(settings.CG_ITERATIONS_MAX):
            product = self._product(parts, direction)
            if product is None:
                break
            along = (
                product
                + settings.LIGHT_DAMPING * self.damping * preconditioner.diagonal * direction
            )
            curvature = float(direction @ along)
            if not curvature > 0:
                break
            length = size_now / curvature
            moves += length * direction
            residual -= length * along
            predicted += length * size_now
            preconditioned = preconditioner.solve(residual)
            size_before, size_now = size_now, float(residual @ preconditioned)
            if size_now <= max(settings.CG_ERROR_RATIO**2 * first, settings.CG_GAIN_SHARE * enough):
                break
            direction = preconditioned + size_now / size_before * direction
        return moves, predicted

    def step(self, moves: Array, total: float) -> float | None:
        """The sum after the longest step of a few that lowers it, which is taken; None if none."""
        objective, trial = self.objective, np.empty_like(self.x)
        steps = settings.DESCENT_STEPS_AFTER_JOINT
        for share in settings.GLOBAL_STEP_SHARES:
            moved = share * moves
            trial[:] = self.x
            trial[objective.layout.lighting] += as_in_x(moved, objective.layout)
            for chunk in chunks(objective.pixels):
                if self.stop():
                    return None
                followed = objective.problem.back_substitute(
                    objective.for_core(self.x), chunk, moved, **self._options(chunk)
                )
                place(objective, trial, chunk, followed)
            left = fit_all(
                objective, trial, starts=0, steps=steps, prior=self.prior, stop=self.stop
            )
            if left is None:
                return None
            self._restart_worse(trial, left)
            lower = self.total(trial, left)
            if lower < total:
                self.x[:], self.sum_sq[:] = trial, left
                return lower
        return None

    def _restart_worse(self, trial: Array, left: Array) -> None:
        """Let pixels that a step to `trial` left worse off start again; it and the sums change.

        From where they were, and from the best node: one that falls into another minimum costs more
        than many others gain. Those that are left when it is stopped stay worse off.
        """
        worse = np.flatnonzero(left > settings.WORSE_RATIO * self.sum_sq).astype(np.uint64)
        steps = 2 * settings.DESCENT_STEPS_AFTER_JOINT
        objective = self.objective
        for chunk in pieces(worse):
            if self.stop():
                return
            own, rows = taken(objective, self.x, chunk), self._rows(chunk)
            try_from(objective, trial, left, chunk, own, steps=steps, starts=1, prior=rows)
