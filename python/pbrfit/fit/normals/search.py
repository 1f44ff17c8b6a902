"""Lights and normals from a strided subset of the pixels, from given normals that are wrong.

With wrong normals held, lights bend to them, and materials to both; a fit that starts there stays
there. So normals are free from the beginning, but alike nearby, and metallic has a prior around 0
in the first rounds: metal with a broad lobe and normals turned half way to the camera shows what a
dielectric shows, and where both are free most pixels would choose wrongly together. Later rounds
have a prior on roughness and metallic around what their segment has been found to be made of.
Without that, the many numbers of each pixel take up noise in a way that does not cancel out over
pixels, and lights end up beside the true ones however many there are.

A round tries all roughness and metallic for each pixel by itself, and then takes joint steps.
Pixels that are in a wrong minimum have little weight in these: a bounded loss ρ(c) = τ c / (τ + c),
with τ from the pixels' own sums of squared residuals, has w = ρ' = (τ / (τ + c))².
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.levels import strided_subset
from pbrfit.fit.normals.joint_step import SubsetState, joint_step
from pbrfit.fit.normals.noise import (
    mean_over_median,
    noise_variance,
    offset_variances,
    pixel_sums,
)
from pbrfit.fit.normals.offset_prior import Neighbourhood, TangentOffsetPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import descended, place, put, taken
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.mixture import prior_at

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SubsetFit:
    """What a strided subset found."""

    objective: Objective
    """Of the subset, with free normals."""
    pixels: NDArray[np.uint64]
    """Which of the whole's pixels it has."""
    x: Array
    prior: TangentOffsetPrior


def fit_subset(
    objective: Objective,
    x: Array,
    given: Array,
    normal_sigma: Array | None,
    stop: Callable[[], bool],
    *,
    rounds: int = settings.NORMALS_ROUNDS_MAX,
) -> SubsetFit:
    """Lights, tangent offsets and materials of a strided subset, from the lights of x.

    `given` (P, 3) are the given normals, with their uncertainty (P,) in any unit; None = all alike.
    `stop` is asked after each joint step, and what is left of a round is left out. From each start
    there are at most so many rounds.
    """
    pixels, index = strided_subset(objective.layout, settings.NORMALS_SUBSET_PIXELS_MAX)
    subset, x = objective.restricted(pixels), objective.part_of(x, pixels)
    chosen = pixels.astype(np.intp)
    sigma = None if normal_sigma is None else normal_sigma[chosen]
    prior = TangentOffsetPrior(Neighbourhood.of(index, given[chosen], sigma))
    best: tuple[NormalSearch, Array] | None = None
    for factor in settings.NORMALS_LIGHT_SCALE_STARTS:
        search = NormalSearch(subset, prior, with_scaled_lights(subset, x, factor), stop)
        search.run(rounds)
        sums = pixel_sums(subset, search.state.x)
        if best is None or explains_more(sums, best[1]):
            best = search, sums
        if ended_well(subset, sums) or stop():
            break
    assert best is not None
    return SubsetFit(subset, pixels, best[0].state.x, best[0].offset_prior)


def with_scaled_lights(objective: Objective, x: Array, factor: float) -> Array:
    """A copy of x with lights times a factor, and albedo divided by it."""
    assert objective.lighting is not None
    x = x.copy()
    x[objective.lighting] *= factor
    x[objective.albedo] = np.clip(x[objective.albedo] / factor, 0, 1)
    return x


def ended_well(objective: Objective, sums: Array) -> bool:
    """Whether a search left noise, or next to nothing, by its sums of squared residuals (P,)."""
    return (
        noise_variance(objective, sums) <= (settings.NORMALS_RMS_MAX * settings.MEAN_RADIANCE) ** 2
        or mean_over_median(objective, sums) <= settings.NORMALS_MEAN_OVER_MEDIAN_MAX
    )


def explains_more(sums: Array, others: Array) -> bool:
    """Whether sums of squared residuals (P,) are less than others, in the same bounded loss."""
    bound = min(_loss_bound(sums), _loss_bound(others))
    return _bounded_loss(sums, bound) < _bounded_loss(others, bound)


class NormalSearch:
    """The search of a subset from one start."""

    def __init__(
        self, subset: Objective, prior: TangentOffsetPrior, x: Array, stop: Callable[[], bool]
    ) -> None:
        self.subset, self.offset_prior, self._stop = subset, prior, stop
        self._pixels = np.arange(subset.pixels, dtype=np.uint64)
        self._damping = settings.DAMPING_START
        f_count = len(subset.layout.roughness_metallic)
        self._cluster_offset_precision = np.full(f_count, settings.OFFSET_PRECISION_SHARE)
        self.state = SubsetState(x, np.zeros((1, f_count)))
        self._material_prior = self._prior_of_first_rounds(0.0)

    def run(self, rounds: int) -> None:
        """Rounds until they settle, or so many."""
        last = np.inf
        fitted = settings.NORMALS_DIELECTRIC_ROUNDS + len(settings.NORMALS_MATERIAL_SIGMAS_MIN)
        for number in range(min(settings.NORMALS_ROUNDS_MAX, rounds)):
            total = self._round(number)
            settled = number > fitted and total > (1 - settings.NORMALS_ROUND_DECREASE_MIN) * last
            if settled or self._stop():
                break
            last = total

    def _round(self, number: int) -> float:
        """Materials tried, and joint steps; the sum at the end, in units of the noise."""
        self._set_material_prior(number)
        if number >= settings.NORMALS_METALLIC_BINARY_ROUND:
            self._cluster_offset_precision[1:] = settings.NORMALS_METALLIC_OFFSET_PRECISION
        if number % 2 == 0:
            self._try_materials(free_normals=number > 0)
        if number > settings.NORMALS_DIELECTRIC_ROUNDS:
            x, variance = self.state.x, self._variance
            _, precision = self._pixel_prior(self.state, x, variance)
            variances = offset_variances(self.subset, x, precision, variance)
            self.offset_prior = self.offset_prior.fitted(self._offsets(x), variances)
        for _ in range(settings.NORMALS_STEPS_PER_ROUND):
            if self._stop() or not self._joint_step():
                break
        if number >= settings.NORMALS_DIELECTRIC_ROUNDS and not self._stop():
            self._try_light_scales()
        if number in settings.NORMALS_DIELECTRIC_TRIAL_ROUNDS:
            self._try_dielectrics()
        sums = pixel_sums(self.subset, self.state.x)
        costs = self._with_material_prior(self.state, sums)
        variance = noise_variance(self.subset, sums)
        return _bounded_loss(costs, _loss_bound(sums)) + self._offset_cost(self.state, variance)

    @property
    def _variance(self) -> float:
        """Of the noise."""
        return noise_variance(self.subset, pixel_sums(self.subset, self.state.x))

    def _offsets(self, x: Array) -> Array:
        """Tangent offsets (P, 2)."""
        tangent_offsets = self.subset.layout.tangent_offsets
        assert tangent_offsets is not None
        return x[tangent_offsets].reshape(2, -1).T

    def _offset_cost(self, state: SubsetState, variance: float) -> float:
        return self.offset_prior.cost(self._offsets(state.x), variance)

    def _prior_of_first_rounds(self, variance: float) -> GaussianPrior:
        shape = self.subset.pixels, len(self.subset.layout.roughness_metallic)
        precision = np.zeros(shape)
        precision[:, 1:] = variance / settings.NORMALS_DIELECTRIC_SIGMA**2
        return GaussianPrior(np.zeros(shape), precision, np.zeros(self.subset.pixels, np.intp))

    def _set_material_prior(self, number: int) -> None:
        """The prior on roughness and metallic of this round."""
        later = number - settings.NORMALS_DIELECTRIC_ROUNDS
        if later < 0:
            self._material_prior = self._prior_of_first_rounds(self._variance)
        else:
            sigmas = settings.NORMALS_MATERIAL_SIGMAS_MIN
            self._material_prior = prior_at(
                self.subset,
                self.state.x,
                sigmas[min(later, len(sigmas) - 1)],
                self._variance,
                np.array(settings.NORMALS_METALLIC_NODES),
            )
        f_count = self._material_prior.precision.shape[1]
        self.state = SubsetState(self.state.x, np.zeros((self._material_prior.clusters, f_count)))

    def _with_material_prior(self, state: SubsetState, sums: Array) -> Array:
        """Summed squared residuals and the prior's penalty of each pixel, (P,)."""
        prior = self._material_prior
        layout = self.subset.layout
        values = np.stack([state.x[block] for block in layout.roughness_metallic], axis=-1)
        deviation = prior.deviation(values, state.cluster_offsets)
        return np.asarray(sums + (prior.precision * deviation**2).sum(axis=1))

    def _pixel_prior(self, state: SubsetState, x: Array, variance: float) -> tuple[Array, Array]:
        """Means and precisions (P, F + 2) of a pixel's unknowns while all others stay."""
        prior = self._material_prior
        mean, precision = self.offset_prior.conditional(self._offsets(x), variance)
        material_mean = prior.mean + state.cluster_offsets[prior.cluster]
        return (
            np.concatenate([material_mean, mean], axis=1),
            np.concatenate([prior.precision, precision], axis=1),
        )

    def _fit_pixels(
        self, state: SubsetState, x: Array, *, starts: int, exact_steps: int, free_normals: bool
    ) -> tuple[Array, Array]:
        """X with each pixel's best unknowns, and their sums of squared residuals (P,)."""
        subset = self.subset
        mean, precision = self._pixel_prior(state, x, self._variance if free_normals else 0.0)
        if not free_normals:
            mean[:, -2:], precision[:, -2:] = 0.0, 0.0
        found, sums = descended(
            subset,
            x,
            self._pixels,
            steps=settings.NORMALS_PIXEL_STEPS if starts else 0,
            exact_steps=exact_steps,
            starts=starts,
            prior=GaussianPrior(mean, precision),
            held_normals=not free_normals,
        )
        return put(subset, x, self._pixels, found), sums

    def _try_materials(self, *, free_normals: bool) -> None:
        """Start each pixel by itself from nodes: normals held, then free where they may be."""
        state, x = self.state, self.state.x
        for free in (False, True) if free_normals else (False,):
            x, _ = self._fit_pixels(
                state, x, starts=settings.NORMALS_STARTS, exact_steps=4, free_normals=free
            )
        self.state = replace(state, x=x)

    def _joint_step(self) -> bool:
        """A joint step; whether another is worth while."""
        state = self.state
        sums = pixel_sums(self.subset, state.x)
        variance, bound = noise_variance(self.subset, sums), _loss_bound(sums)
        costs = self._with_material_prior(state, sums)
        before = self._total(state, costs, bound, variance)
        weights = np.square(bound / (bound + costs))
        for _ in range(settings.NORMALS_FAILED_STEPS_MAX):
            try:
                step = joint_step(
                    self.subset,
                    state,
                    self._material_prior,
                    self.offset_prior,
                    variance,
                    weights,
                    self._cluster_offset_precision,
                    self._damping,
                )
            except np.linalg.LinAlgError:
                step = None
            for share in settings.NORMALS_STEP_SHARES if step else ():
                assert step is not None
                trial, costs = self._refit_materials(state, step(share))
                after = self._total(trial, costs, bound, variance)
                if after < before:
                    self.state = trial
                    self._damping = max(
                        self._damping / settings.DAMPING_DECAY, settings.SUBSET_DAMPING_MIN
                    )
                    return after < (1 - settings.SUBSET_GAIN_MIN) * before
            self._damping = max(
                settings.DAMPING_GROWTH * self._damping, settings.NORMALS_FAILED_DAMPING_MIN
            )
        return False

    def _refit_materials(
        self, before: SubsetState, trial: SubsetState
    ) -> tuple[SubsetState, Array]:
        """Pixels after a step, each from where it led and from where they were; and their costs."""
        subset, everything = self.subset, slice(None)
        stayed = taken(subset, before.x, everything).copy()
        stayed[:, -2:] = taken(subset, trial.x, everything)[:, -2:]
        ends = []
        for start, exact_steps in ((taken(subset, trial.x, everything), 2), (stayed, 3)):
            x = trial.x.copy()
            place(subset, x, everything, start)
            x, sums = self._fit_pixels(
                trial, x, starts=0, exact_steps=exact_steps, free_normals=False
            )
            ends.append((x, self._with_material_prior(replace(trial, x=x), sums)))
        (moved, costs), (other, other_costs) = ends
        better = other_costs < costs
        planes = taken(subset, moved, everything), taken(subset, other, everything)
        place(subset, moved, everything, np.where(better[:, None], planes[1], planes[0]))
        return replace(trial, x=moved), np.where(better, other_costs, costs)

    def _try_dielectrics(self) -> None:
        """Try segments that are neither dielectric nor metal as dielectrics."""
        layout = self.subset.layout
        labels, metallic = layout.segments, layout.metallic
        if labels is None or metallic is None:
            return
        low, high = settings.NORMALS_MIXED_METALLIC
        counts = np.bincount(labels)
        means = np.bincount(labels, self.state.x[metallic]) / np.maximum(counts, 1)
        enough = counts >= settings.NORMALS_DIELECTRIC_TRIAL_PIXELS_MIN
        mixed = (means > low) & (means < high) & enough
        mixed[0] = False  # unclassified pixels have nothing in common
        candidates = np.flatnonzero(mixed)
        largest_first = candidates[np.argsort(-counts[candidates])]
        for label in largest_first[: settings.NORMALS_DIELECTRIC_TRIALS_MAX]:
            if self._stop():
                break
            sums = pixel_sums(self.subset, self.state.x)
            variance, bound = noise_variance(self.subset, sums), _loss_bound(sums)
            before = self.state, self._material_prior, self._damping
            total = _bounded_loss(sums, bound) + self._offset_cost(self.state, variance)
            self._make_dielectric(labels == label, variance)
            sums = pixel_sums(self.subset, self.state.x)
            if not _bounded_loss(sums, bound) + self._offset_cost(self.state, variance) < total:
                self.state, self._material_prior, self._damping = before

    def _make_dielectric(self, there: NDArray[np.bool_], variance: float) -> None:
        """Make some pixels dielectric, as a cluster of their own, and let all else follow."""
        prior, layout = self._material_prior, self.subset.layout
        assert layout.metallic is not None
        assert prior.cluster is not None
        mean, precision = prior.mean.copy(), prior.precision.copy()
        mean[there, 1], precision[there, 1] = (
            0.0,
            variance / settings.NORMALS_MATERIAL_SIGMAS_MIN[-1] ** 2,
        )
        precision[there, 0] = 0.0
        cluster = np.where(there, prior.clusters, prior.cluster)
        self._material_prior = GaussianPrior(mean, precision, cluster)
        x = self.state.x.copy()
        x[layout.metallic][there] = 0.0
        none = np.zeros((1, mean.shape[1]))
        state = SubsetState(x, np.concatenate([self.state.cluster_offsets, none]))
        x, _ = self._fit_pixels(
            state, x, starts=settings.NORMALS_STARTS, exact_steps=6, free_normals=True
        )
        self.state = replace(state, x=x)
        for _ in range(settings.NORMALS_DIELECTRIC_TRIAL_STEPS):
            if not self._joint_step():
                break

    def _try_light_scales(self) -> None:
        """Try other scales between albedo and lights: the loss is flat along them, and curved."""
        subset, state = self.subset, self.state
        sums = pixel_sums(subset, state.x)
        variance, bound = noise_variance(subset, sums), _loss_bound(sums)
        least = self._total(state, self._with_material_prior(state, sums), bound, variance)
        for factor in settings.LIGHT_SCALE_TRIALS:
            x, sums = self._fit_pixels(
                state,
                with_scaled_lights(subset, state.x, factor),
                starts=0,
                exact_steps=6,
                free_normals=True,
            )
            trial = replace(state, x=x)
            total = self._total(trial, self._with_material_prior(trial, sums), bound, variance)
            if total < least:
                least, self.state = total, trial

    def _total(self, state: SubsetState, costs: Array, bound: float, variance: float) -> float:
        """What is lowered: bounded losses of the pixels' `costs` (P,), and priors of offsets."""
        prior = self._material_prior
        of_clusters = self._cluster_offset_precision * prior.sums(prior.precision)
        held = of_clusters * state.cluster_offsets**2
        return _bounded_loss(costs, bound) + float(held.sum()) + self._offset_cost(state, variance)


def _loss_bound(sums: Array) -> float:
    """τ."""
    typical = float(np.quantile(sums, settings.NORMALS_LOSS_BOUND_QUANTILE))
    return max(settings.NORMALS_LOSS_BOUND * typical, float(np.finfo(np.float64).tiny))


def _bounded_loss(costs: Array, bound: float) -> float:
    """Σ ρ(c), with τ = `bound`."""
    return float((bound * costs / (bound + costs)).sum())
