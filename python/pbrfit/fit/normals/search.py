"""Lights and normals from the pixels of a lattice, from given normals that are wrong.

With wrong normals held, lights bend to them, and materials to both; a fit that starts there stays
there. So normals are free from the beginning, but alike nearby, and metallic is drawn to 0 in the
first rounds: metal with a broad lobe and normals turned half way to the camera shows what a
dielectric shows, and where both are free most pixels would choose wrongly together. Later rounds
draw roughness and metallic to what their segment has been found to be made of instead. Without
that, the many numbers of each pixel take up noise in a way that does not cancel out over pixels,
and lights end up beside the true ones however many there are.

A round tries all finishes for each pixel by itself, and then takes joint steps. Pixels that are in
a wrong minimum have little weight in these: a bounded loss ρ(c) = τ c / (τ + c), with τ from the
pixels' own squares, has w = ρ' = (τ / (τ + c))².
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.pixels import place, start_nodes, taken
from pbrfit.fit.normals import joint_step
from pbrfit.fit.normals.joint_step import State
from pbrfit.fit.normals.noise import (
    mean_over_median,
    noise_variance,
    pixel_squares,
    uncertain_tilts,
)
from pbrfit.fit.normals.offset_prior import TiltPrior
from pbrfit.fit.normals.strided_subset import Neighbourhood, lattice
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.material import prior_at
from pbrfit.fit.settings import MEAN_RADIANCE, OFFSET_PRECISION_SHARE

Array = NDArray[np.float64]

PIXELS = 1024
"""Of the lattice, at most."""

DIELECTRIC_ROUNDS = 3
DIELECTRIC = 0.2
"""Rounds in which metallic is drawn to 0, and the standard deviation of that."""

ROUNDS = 12
"""At most."""

STARTS = (1.0, 2.0, 1.4)
"""Factors on the lights that the search starts from, the next only where the one before has not
ended well: which of several ways lights and normals go is decided in the first rounds."""

WELL = 1.25
"""Mean of the pixels' squares over their median, beside that of noise, up to which a search has."""

PERFECT = 2e-3
"""Or a deviation of the better half of the pixels of this share of the mean radiance. Without noise
that half ends exact and what is wrong elsewhere is never noise, but lights are right by then."""

FLOORS = (0.1, 0.06, 0.036, 0.02)
"""Smallest deviation of the pull to what was learnt, by round."""

PURE_ROUNDS = 8
HELD = 1e3
"""From this round on clusters have no offset in metallic: what it is drawn to is 0 or 1. Before,
they are free to move together, which lights need to find their scale."""

FLIP_ROUNDS = (5, 8)
FLIPPED = 12
FEWEST = 8
FLIP_STEPS = 2
"""After these rounds segments that are neither dielectric nor metal are tried as dielectrics, each
as a whole: at most so many, of so many pixels at least, with so many joint steps each. They stay so
if all is explained better for it. What is in between has been bent there by wrong normals, and its
own way back is uphill."""

BETWEEN = (0.04, 0.96)
"""Mean metallic of what is neither."""

SCALES = (1.2, 1 / 1.2, 1.05, 1 / 1.05)
"""Factors on all lights that are tried after each round, with albedo divided by them."""

PURE = np.array([0.0, 1.0])
"""Metallic of the nodes that materials are learnt on: there is hardly anything between dielectrics
and metals, and with normals free the pictures alone do not say so."""

STEPS = 4
"""Joint steps of a round."""

NODES = 2
"""From which a pixel starts in every other round."""

OUTLYING = 4.0
QUANTILE = 0.8
"""τ is so many times this quantile of the pixels' squares."""

FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9
FAILURES = 4
SHARES = (1.0, 0.4)

STALLED = 1e-4
"""A step that lowers the sum by less than this share is the last of its round."""

SETTLED = 1e-3
"""A round that does is the last."""


@dataclass(frozen=True, eq=False)
class Found:
    """What the lattice knows.

    Attributes
    ----------
    few
        Its objective, with free normals.
    pixels
        Which of the whole's pixels it has.
    x
        Of `few`.
    prior
        Of its tilts.
    """

    few: Objective
    pixels: NDArray[np.uint64]
    x: Array
    prior: TiltPrior


def find(
    objective: Objective,
    x: Array,
    given: Array,
    sigma: Array | None,
    stop: Callable[[], bool],
    *,
    rounds: int = ROUNDS,
) -> Found:
    """Lights, tilts and materials of a lattice, from the lights of x.

    Parameters
    ----------
    objective
        With free normals and unknown lights.
    x
        Where to start.
    given, sigma
        (P, 3) and (P,): the normals that tilts are from, and how sure these are.
    stop
        Whether time is up: asked after each joint step, and what is left of a round is left out.
    rounds
        At most so many from each start.
    """
    pixels, index = lattice(objective.layout, PIXELS)
    few = objective.restricted(pixels)
    chosen = pixels.astype(np.intp)
    around = Neighbourhood.of(index, given[chosen], None if sigma is None else sigma[chosen])
    x = objective.part_of(x, pixels)
    best: tuple[_Search, Array] | None = None
    for factor in STARTS:
        search = _searched(few, TiltPrior(around), _scaled(few, x, factor), stop, rounds)
        squares = pixel_squares(few, search.state.x)
        if best is None or _nearer(squares, best[1]):
            best = search, squares
        if _ended_well(few, squares) or stop():
            break
    assert best is not None
    return Found(few, pixels, best[0].state.x, best[0].prior)


def _searched(
    few: Objective, prior: TiltPrior, x: Array, stop: Callable[[], bool], rounds: int
) -> _Search:
    search = _Search(few, prior, x, stop)
    last = np.inf
    for number in range(min(ROUNDS, rounds)):
        total = search.round(number)
        settled = number > DIELECTRIC_ROUNDS + len(FLOORS) and total > (1 - SETTLED) * last
        if settled or stop():
            break
        last = total
    return search


def _scaled(few: Objective, x: Array, factor: float) -> Array:
    """X with brighter lights and darker albedo."""
    assert few.lighting is not None
    x = x.copy()
    x[few.lighting] *= factor
    x[few.albedo] = np.clip(x[few.albedo] / factor, 0, 1)
    return x


def _ended_well(few: Objective, squares: Array) -> bool:
    """Whether a search left noise, or next to nothing."""
    left = noise_variance(few, squares)
    return left <= (PERFECT * MEAN_RADIANCE) ** 2 or mean_over_median(few, squares) <= WELL


def _nearer(squares: Array, others: Array) -> bool:
    """Whether one search explains more than another, in the same bounded loss."""
    bound = min(_bound(squares), _bound(others))
    return _bounded(squares, bound) < _bounded(others, bound)


class _Search:
    """A lattice on its way."""

    def __init__(
        self, few: Objective, prior: TiltPrior, x: Array, stop: Callable[[], bool]
    ) -> None:
        self.few, self.prior, self._stop = few, prior, stop
        self._pixels = np.arange(few.pixels, dtype=np.uint64)
        self._damping = FIRST_DAMPING
        finish = len(few.layout.roughness_metallic)
        nothing = np.zeros((few.pixels, finish))
        self._pull = GaussianPrior(nothing, nothing, np.zeros(few.pixels, np.intp))
        self._offset_pull = np.full(finish, OFFSET_PRECISION_SHARE)
        self.state = State(x, np.zeros((1, finish)))

    @property
    def variance(self) -> float:
        """Of the noise."""
        return noise_variance(self.few, self._squares(self.state.x))

    def round(self, number: int) -> float:
        """Finishes tried, and joint steps; the sum at the end, in units of the noise."""
        self._draw(number)
        if number >= PURE_ROUNDS:
            self._offset_pull[1:] = HELD
        if number % 2 == 0:
            self._try_finishes(turn=number > 0)
        if number > DIELECTRIC_ROUNDS:
            x, variance = self.state.x, self.variance
            _, precision = self._towards(self.state, x, variance)
            uncertain = uncertain_tilts(self.few, x, precision, variance)
            self.prior = self.prior.learnt(self._tilts(x), uncertain)
        for _ in range(STEPS):
            if self._stop() or not self._joint():
                break
        if number >= DIELECTRIC_ROUNDS and not self._stop():
            self._scale()
        if number in FLIP_ROUNDS:
            self._flip()
        squares = self._squares(self.state.x)
        return _bounded(self._with_pull(self.state, squares), _bound(squares)) + self.prior.cost(
            self._tilts(self.state.x), noise_variance(self.few, squares)
        )

    def _squares(self, x: Array) -> Array:
        return pixel_squares(self.few, x)

    def _tilts(self, x: Array) -> Array:
        tilts = self.few.layout.tangent_offsets
        assert tilts is not None
        return x[tilts].reshape(2, -1).T

    def _finish(self, x: Array) -> Array:
        return np.stack([x[block] for block in self.few.layout.roughness_metallic], axis=-1)

    def _draw(self, number: int) -> None:
        """What roughness and metallic are drawn to in this round."""
        finish = len(self.few.layout.roughness_metallic)
        variance = self.variance
        if number < DIELECTRIC_ROUNDS:
            centre, precision = np.zeros((2, self.few.pixels, finish))
            if finish == 2:
                precision[:, 1] = variance / DIELECTRIC**2
            clusters = np.zeros(self.few.pixels, np.intp)
            self._pull = GaussianPrior(centre, precision, clusters)
            self.state = State(self.state.x, np.zeros((1, finish)))
            return
        floor = FLOORS[min(number - DIELECTRIC_ROUNDS, len(FLOORS) - 1)]
        self._pull = prior_at(self.few, self.state.x, floor, variance, PURE)
        self.state = State(self.state.x, np.zeros((self._pull.clusters, finish)))

    def _with_pull(self, state: State, squares: Array) -> Array:
        """Squares and pull of each pixel, (P,)."""
        off = self._finish(state.x) - self._pull.mean - state.offsets[self._pull.cluster]
        return np.asarray(squares + (self._pull.precision * off**2).sum(axis=1))

    def _towards(self, state: State, x: Array, variance: float) -> tuple[Array, Array]:
        """Centres and precisions (P, F + 2) that a pixel by itself feels."""
        centre, precision = self.prior.beside_others(self._tilts(x), variance)
        shifted = self._pull.mean + state.offsets[self._pull.cluster]
        return (
            np.concatenate([shifted, centre], axis=1),
            np.concatenate([self._pull.precision, precision], axis=1),
        )

    def _fitted(
        self, state: State, x: Array, *, starts: int, steps: int, exact_steps: int, turn: bool
    ) -> tuple[Array, Array]:
        """X with each pixel's best unknowns, its tilt held unless `turn`, and their squares."""
        few = self.few
        centre, precision = self._towards(state, x, self.variance if turn else 0.0)
        if not turn:
            finish = len(few.layout.roughness_metallic)
            centre[:, finish:], precision[:, finish:] = 0.0, 0.0
        nodes = start_nodes(few) if starts else (np.empty(0), np.empty(0))
        found, squares = few.problem.fit_materials(
            few.for_core(x),
            self._pixels,
            *nodes,
            starts=starts,
            steps=steps,
            exact_steps=exact_steps,
            mean=centre,
            precision=precision,
            held_normals=not turn,
        )
        x = x.copy()
        place(few, x, self._pixels, found)
        return x, squares

    def _try_finishes(self, *, turn: bool) -> None:
        state = self.state
        x, _ = self._fitted(state, state.x, starts=NODES, steps=12, exact_steps=4, turn=False)
        if turn:
            x, _ = self._fitted(state, x, starts=NODES, steps=12, exact_steps=4, turn=True)
        self.state = State(x, state.offsets)

    def _joint(self) -> bool:
        """A joint step; whether another is worth while."""
        state = self.state
        squares = self._squares(state.x)
        variance, bound = noise_variance(self.few, squares), _bound(squares)
        costs = self._with_pull(state, squares)
        before = self._total(state, costs, bound, variance)
        weights = np.square(bound / (bound + costs))
        for _ in range(FAILURES):
            try:
                taken = joint_step.moves(
                    self.few,
                    state,
                    self._pull,
                    self.prior,
                    variance,
                    weights,
                    self._offset_pull,
                    self._damping,
                )
            except np.linalg.LinAlgError:
                self._damping = max(10 * self._damping, 1e-6)
                continue
            for share in SHARES:
                trial, costs = self._followed(state, taken(share))
                after = self._total(trial, costs, bound, variance)
                if after < before:
                    self.state = trial
                    self._damping = max(self._damping / 5, LEAST_DAMPING)
                    return after < (1 - STALLED) * before
            self._damping = max(10 * self._damping, 1e-6)
        return False

    def _flip(self) -> None:
        """Try segments that are neither dielectric nor metal as dielectrics."""
        few = self.few
        labels, metallic = few.layout.segments, few.layout.metallic
        if labels is None or metallic is None:
            return
        counts = np.bincount(labels)
        means = np.bincount(labels, self.state.x[metallic]) / np.maximum(counts, 1)
        between = (means > BETWEEN[0]) & (means < BETWEEN[1]) & (counts >= FEWEST)
        between[0] = False  # unclassified pixels have nothing in common
        candidates = np.flatnonzero(between)
        for label in candidates[np.argsort(-counts[candidates])][:FLIPPED]:
            if self._stop():
                break
            squares = self._squares(self.state.x)
            variance, bound = noise_variance(self.few, squares), _bound(squares)
            least = self._alone(self.state, squares, bound, variance)
            before = self.state, self._pull, self._damping
            if not self._as_dielectric(labels == label, bound, variance) < least:
                self.state, self._pull, self._damping = before

    def _as_dielectric(self, there: NDArray[np.bool_], bound: float, variance: float) -> float:
        """Make some pixels dielectric, and let all else follow; what `_alone` says then."""
        few, pull = self.few, self._pull
        metallic = few.layout.metallic
        assert metallic is not None
        assert pull.cluster is not None
        centre, precision = pull.mean.copy(), pull.precision.copy()
        centre[there, 1], precision[there, 1] = 0.0, variance / FLOORS[-1] ** 2
        precision[there, 0] = 0.0
        cluster = np.where(there, pull.clusters, pull.cluster)
        self._pull = GaussianPrior(centre, precision, cluster)
        offsets = np.concatenate([self.state.offsets, np.zeros((1, centre.shape[1]))])
        x = self.state.x.copy()
        x[metallic][there] = 0.0
        state = State(x, offsets)
        x, _ = self._fitted(state, x, starts=NODES, steps=12, exact_steps=6, turn=True)
        self.state = State(x, offsets)
        for _ in range(FLIP_STEPS):
            if not self._joint():
                break
        return self._alone(self.state, self._squares(self.state.x), bound, variance)

    def _alone(self, state: State, squares: Array, bound: float, variance: float) -> float:
        """The sum without what roughness and metallic are drawn to."""
        return _bounded(squares, bound) + self.prior.cost(self._tilts(state.x), variance)

    def _scale(self) -> None:
        """Try other scales between albedo and lights: the loss is flat along them, and curved."""
        few, state = self.few, self.state
        assert few.lighting is not None
        squares = self._squares(state.x)
        variance, bound = noise_variance(self.few, squares), _bound(squares)
        least = self._total(state, self._with_pull(state, squares), bound, variance)
        for factor in SCALES:
            trial = state.x.copy()
            trial[few.lighting] *= factor
            trial[few.albedo] = np.clip(trial[few.albedo] / factor, 0, 1)
            trial, squares = self._fitted(state, trial, starts=0, steps=0, exact_steps=6, turn=True)
            scaled = State(trial, state.offsets)
            total = self._total(scaled, self._with_pull(scaled, squares), bound, variance)
            if total < least:
                least, self.state = total, scaled

    def _total(self, state: State, costs: Array, bound: float, variance: float) -> float:
        tilts = self._tilts(state.x)
        held = self._offset_pull * self._pull.sums(self._pull.precision) * state.offsets**2
        return _bounded(costs, bound) + float(held.sum()) + self.prior.cost(tilts, variance)

    def _followed(self, before: State, trial: State) -> tuple[State, Array]:
        """Pixels after a step, each from where it led and from where they were; and their costs."""
        moved, squares = self._fitted(trial, trial.x, starts=0, steps=0, exact_steps=2, turn=False)
        stayed = trial.x.copy()
        materials = taken(self.few, before.x, slice(None)).copy()
        materials[:, -2:] = taken(self.few, trial.x, slice(None))[:, -2:]
        place(self.few, stayed, slice(None), materials)
        stayed, squares_then = self._fitted(
            trial, stayed, starts=0, steps=0, exact_steps=3, turn=False
        )
        states = [State(x, trial.offsets) for x in (moved, stayed)]
        costs = [
            self._with_pull(state, left)
            for state, left in zip(states, (squares, squares_then), strict=True)
        ]
        better = costs[1] < costs[0]
        chosen = np.where(
            better[:, None],
            taken(self.few, stayed, slice(None)),
            taken(self.few, moved, slice(None)),
        )
        place(self.few, moved, slice(None), chosen)
        return State(moved, trial.offsets), np.where(better, costs[1], costs[0])


def _bound(squares: Array) -> float:
    """τ."""
    typical = float(np.quantile(squares, QUANTILE))
    return max(OUTLYING * typical, float(np.finfo(np.float64).tiny))


def _bounded(costs: Array, bound: float) -> float:
    """Σ ρ(c), with τ = `bound`."""
    return float((bound * costs / (bound + costs)).sum())
