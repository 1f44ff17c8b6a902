"""The learnt material prior: which roughness and metallic a segment is made of, found by EM.

Pictures with noise leave roughness of a single pixel uncertain by 0.1, and all pixels of an object
together know it to 0.01. A penalty on differences helps only where segments are right and of one
material. Here each pixel keeps its whole likelihood over a grid of roughness and metallic, and each
segment (the whole picture if there are none) has a discrete distribution on that grid, learnt from
its pixels: one node if it is one material, two if two were merged, many if roughness varies. Pixels
are then pulled to their posterior mean, the harder the surer it is. This is nonparametric
empirical Bayes (H. Robbins, "An empirical Bayes approach to statistics", 1956; EM for the discrete
mixture as in N. Laird, J. Am. Stat. Assoc. 73, 1978).

With noise s², lights known and nodes k,

    l_ik = min over albedo of Σ ω (I − T)² / 2s²          A_ik = exp(−η_i (l_ik − min_k l_ik))
    p_k ← p_k mean_i [A_ik / Σ_j A_ij p_j]                 posterior_ik ∝ A_ik p_k
    pull of pixel i: s² a_i (v_i − c_i − δ)²              a_i = 1 / (floor² + V_i)

with c and V mean and variance of the posterior. η = σ²/(σ² + spacing²) widens likelihoods that are
too sharp for the grid. The offset δ is common to the pixels of a segment that fell to the same
group of neighbouring nodes, and free: so the pull gathers pixels without holding on to where they
were gathered while lights were still wrong.

Lights and prior depend on each other. They are found together on a few pixels, in rounds of EM and
joint Gauss-Newton steps (`pulled_steps`), and then applied to all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.misfit import NEIGHBOUR_CORRELATION_MAX, NeighbourPairs
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors import map_gauss_newton as pulled_steps
from pbrfit.fit.priors.map_gauss_newton import OFFSET_PULL, Pull
from pbrfit.fit.robust import FEWEST_DEGREES
from pbrfit.fit.sampling import spread_over
from pbrfit.lazy import lazy

Array = NDArray[np.float64]
Labels = NDArray[np.intp]

ROUGHNESS_NODES = np.linspace(0.03, 1.0, 33)
METALLIC_NODES = np.linspace(0.0, 1.0, 7)
NODE_DISTANCE = float(ROUGHNESS_NODES[1] - ROUGHNESS_NODES[0])

SPACING = 0.03
"""Of the roughness nodes; likelihoods are widened to it."""

FLOORS = (0.05, 0.02, 0.01, 0.01)
"""Smallest standard deviation of the pull, by round: wide at first, while lights are wrong."""

STEPS = 3
"""Gauss-Newton steps a round."""

LEARNING_PIXELS = 1024
"""Pixels that find lights and prior together. The dense system makes each step cost the square of
the lights' number for each of them."""

LEARNING_PIXELS_GIVEN_LIGHTS = 16384
"""Pixels that the final distributions are learnt from."""

EM_STEPS = 100

OWN_PIXELS = 16
"""A segment with fewer has the distribution of the whole picture."""

PICTURE_PIXELS = 10.0
"""How many pixels the distribution of the whole picture counts for in that of a segment."""

RAREST = 1e-30
"""Probability of a node at least. Pixels that nothing was learnt from may have a likelihood of 0,
to the last bit, wherever else something was found; their likelihood alone decides then."""

SAME_GROUP = 0.02
"""Of the largest probability: neighbouring nodes above this are one group."""

MUCH_LESS = 0.5
"""Of the squares: better lights, whatever is left. On twelve synthetic rooms noise and slow
convergence left 0.004 to 0.92 of the squares, wrong normals, field of view and SH order 0.8 to
1.02."""

NOT_MORE = 1.05
"""Of the squares, where all that is left is noise: lights from few pixels have more noise of their
own than lights from all, which the fit that follows will take out."""

FLATTEST = 1e-6
"""Curvature between nodes at least; a likelihood may be flat."""

LEAST_VARIANCE = 1e-20
"""Of the noise: pictures may be explained perfectly."""

APPLIED_AT_ONCE = 8192
"""Pixels whose likelihoods are held at a time."""


class MaterialPull:
    """The learnt prior as a penalty; the best offsets are inserted, so x alone decides.

    With tot = Σ a over a cluster and d = v − c, the best offset is δ = Σ a d / ((1 + s) tot), and
    the derivative by it vanishes there, so that ∂/∂v = 2 a (d − δ).
    """

    name = "material"

    def __init__(self, pull: Pull, blocks: tuple[slice, ...], factor: float) -> None:
        self._pull = pull
        self._blocks = blocks
        self._factor = factor
        self._totals = pull.offset_precision()

    def shifted(self, x: Array) -> Array:
        """Where pixels are pulled, with the best offsets for x: c + δ, (P, F)."""
        return np.asarray(self._pull.centre + self.offsets(x)[self._pull.cluster])

    def offsets(self, x: Array) -> Array:
        """The best offsets for x, δ: (clusters, F)."""
        pull = self._pull
        off = np.stack([x[block] for block in self._blocks], axis=-1) - pull.centre
        return pull.sums(pull.precision * off) / ((1 + OFFSET_PULL) * self._totals)

    @property
    def precision(self) -> Array:
        """Of the pull: a, (P, F), in units of squared residuals."""
        return self._pull.precision

    def value_and_grad(self, x: Array, gradient: Array) -> float:
        """See `Penalty`."""
        pull, total = self._pull, 0.0
        for f, block in enumerate(self._blocks):
            precision, totals = pull.precision[:, f], self._totals[:, f]
            off = x[block] - pull.centre[:, f]
            sums = np.bincount(pull.cluster, weights=precision * off, minlength=pull.clusters)
            offsets = sums / ((1 + OFFSET_PULL) * totals)
            off -= offsets[pull.cluster]
            total += float((precision * off**2).sum())
            total += OFFSET_PULL * float((totals * offsets**2).sum())
            gradient[block] += 2 * self._factor * precision * off
        return self._factor * total


class HeldPull:
    """A pull of every pixel towards a place of its own, Σ a (v − c)², that nothing moves.

    Parameters
    ----------
    centre, precision
        (P, F): c, and a in units of squared residuals.
    blocks, factor
        Where v lies in x, and what the sum is multiplied by.
    name
        Of the prior that it belongs to.
    """

    def __init__(
        self,
        centre: Array,
        precision: Array,
        blocks: tuple[slice, ...],
        factor: float,
        name: str = "material",
    ) -> None:
        self.name = name
        self._centre, self._blocks, self._factor = centre, blocks, factor
        self.precision = precision

    def shifted(self, _: Array) -> Array:
        """Where pixels are pulled, (P, F)."""
        return self._centre

    def value_and_grad(self, x: Array, gradient: Array) -> float:
        """See `Penalty`."""
        total = 0.0
        for f, block in enumerate(self._blocks):
            off = x[block] - self._centre[:, f]
            pulled = self.precision[:, f] * off
            total += float((pulled * off).sum())
            gradient[block] += 2 * self._factor * pulled
        return self._factor * total


@dataclass(frozen=True, eq=False)
class FittedPrior:
    """What was learnt on some pixels, to be held for others of the same segments and lights.

    Attributes
    ----------
    learnt
        The distributions.
    variance
        s², of samples of weight 1, in units of x.
    strength
        `Priors.material`.
    clusters, offsets
        Numbers of the clusters, in order, and how far each was moved, (clusters, F).
    """

    learnt: _Learnt
    variance: float
    strength: float
    clusters: Labels
    offsets: Array

    def moved(self, penalty: MaterialPull, x: Array) -> FittedPrior:
        """With the offsets that the penalty, made by this lesson, has at x."""
        return replace(self, offsets=penalty.offsets(x))

    def applied(
        self, objective: Objective, x: Array, out_of_time: Callable[[], bool]
    ) -> tuple[Array, HeldPull] | None:
        """X with all pixels where they are pulled, each with its best albedo; and the penalty.

        None if time ran out before all pixels had theirs.
        """
        layout = objective.layout
        labels = np.zeros(layout.pixels, np.intp) if layout.segments is None else layout.segments
        grid = _Grid(objective, x, np.empty(0, np.uint64), self.variance)
        posterior = self.learnt.of_all(grid, labels, out_of_time)
        if posterior is None:
            return None
        variance = self.strength * self.variance
        centre, precision = _drawn(posterior, FLOORS[-1], variance, len(layout.roughness_metallic))
        # Clusters that nobody has met stay where they are.
        found = np.searchsorted(self.clusters, posterior.cluster)
        found[found == len(self.clusters)] = 0
        met = self.clusters[found] == posterior.cluster
        centre += np.where(met[:, None], self.offsets[found], 0.0)
        np.clip(centre, 0.0, 1.0, out=centre)
        x = x.copy()
        everything = np.arange(layout.pixels, dtype=np.uint64)
        _put(objective, x, everything, centre)
        objective.put_best_albedo(x, everything)
        return x, HeldPull(centre, precision, layout.roughness_metallic, 1 / objective.total_weight)


def learn(
    objective: Objective,
    x: Array,
    strength: float,
    out_of_time: Callable[[], bool] = lambda: False,
) -> tuple[Array, MaterialPull, FittedPrior] | None:
    """Learn the prior around x.

    Returned are x for all pixels with the lights found, the penalty, and what was learnt.

    None if time ran out before all pixels had theirs.

    Parameters
    ----------
    objective
        The problem.
    x
        A fit of the data.
    strength
        `Priors.material`: 1 is Bayes' rule.
    out_of_time
        Asked between rounds, and then between pieces of the pixels.
    """
    # One BLAS thread: sums split over threads would round differently on a machine with another
    # number of processors.
    from threadpoolctl import threadpool_limits

    layout = objective.layout
    labels = np.zeros(layout.pixels, np.intp) if layout.segments is None else layout.segments
    few = spread_over(labels, LEARNING_PIXELS)
    with threadpool_limits(1, user_api="blas"):
        if layout.lighting is not None:
            moved = _with_lights(objective, x, few, labels[few], strength, out_of_time)
            x = moved if _explains_more(objective, x, moved) else x.copy()
            del moved  # of the size of x, which counts
        else:
            x = x.copy()

        grid = _Grid(objective, x, few)
        everything = np.arange(layout.pixels, dtype=np.uint64)
        learnt = _learnt(grid, labels)
        posterior = learnt.of_all(grid, labels, out_of_time)
        if posterior is None:
            return None
        variance = strength * grid.variance
        pull, clusters = _pull(posterior, FLOORS[-1], variance, len(layout.roughness_metallic))
        _put(objective, x, everything, pull.centre)
        objective.put_best_albedo(x, everything)
    lesson = FittedPrior(learnt, grid.variance, strength, clusters, np.zeros_like(pull.centre[:0]))
    return x, MaterialPull(pull, layout.roughness_metallic, 1 / objective.total_weight), lesson


def pull_at(objective: Objective, x: Array, floor: float, variance: float, metallic: Array) -> Pull:
    """The pull of all pixels at x, learnt from an even share of them; lights stay.

    Parameters
    ----------
    floor
        Smallest standard deviation of the pull.
    variance
        s², of samples of weight 1, in units of x.
    metallic
        Of the nodes; not read where it is known.
    """
    layout = objective.layout
    labels = np.zeros(layout.pixels, np.intp) if layout.segments is None else layout.segments
    grid = _Grid(objective, x, np.empty(0, np.uint64), variance, metallic)
    posterior = _learnt(grid, labels).of_all(grid, labels)
    assert posterior is not None
    return _pull(posterior, floor, variance, len(layout.roughness_metallic))[0]


def _learnt(grid: _Grid, labels: Labels) -> _Learnt:
    """From an even share of the pixels, `labels` (P,)."""
    many = spread_over(labels, LEARNING_PIXELS_GIVEN_LIGHTS)
    return _Learnt.of(grid.likelihood(many), labels[many], grid)


def _with_lights(
    objective: Objective,
    x: Array,
    pixels: NDArray[np.uint64],
    labels: Labels,
    strength: float,
    out_of_time: Callable[[], bool],
) -> Array:
    """X with the lights, and materials of some pixels, that were found with their prior."""
    x = x.copy()
    for floor in FLOORS:
        grid = _Grid(objective, x, pixels)
        likelihood = grid.likelihood(pixels)
        posterior = _Learnt.of(likelihood, labels, grid).posterior(likelihood, labels)
        pull, _ = _pull(
            posterior, floor, strength * grid.variance, len(objective.layout.roughness_metallic)
        )
        _put(objective, x, pixels, pull.centre)
        del grid  # which holds x
        x, _ = pulled_steps.minimize(objective, x, pixels, pull, STEPS)
        if out_of_time():
            break
    return x


def _explains_more(objective: Objective, before: Array, after: Array) -> bool:
    """Whether the lights of `after` are to be preferred, judged by pixels and their neighbours.

    Where the model is right, better lights leave only noise, which neighbours do not share, or
    much less than before. Where it is wrong (normals, shadows, field of view) residuals stay, and
    neighbours share them; lights that lower such residuals by a little bend the materials to the
    error, and are worse ones.
    """
    neighbours = NeighbourPairs(objective)
    pixels = neighbours.pixels
    if not pixels.size:
        return False
    squares, best = [], np.empty_like(before)
    for x in (before, after):
        best[:] = x
        _put(objective, best, pixels, _Grid(objective, x, pixels).best(pixels))
        squares.append(float(objective.put_best_albedo(best, pixels).sum()))
    if squares[1] <= MUCH_LESS * squares[0]:
        return True
    return (
        squares[1] <= NOT_MORE * squares[0]
        and neighbours.residual_correlation(best) <= NEIGHBOUR_CORRELATION_MAX
    )


def _pieces(count: int) -> list[slice]:
    return [slice(first, first + APPLIED_AT_ONCE) for first in range(0, count, APPLIED_AT_ONCE)]


def _put(objective: Objective, x: Array, pixels: NDArray[np.uint64], values: Array) -> None:
    """Give some pixels of x these roughness and metallic (Q, F)."""
    for block, of_block in zip(objective.layout.roughness_metallic, values.T, strict=True):
        x[block][pixels] = of_block


class _Grid:
    """Likelihoods over the grid of nodes, (roughness, metallic) row by row, with the lights of x.

    Attributes
    ----------
    roughness, metallic
        Of the nodes, (nodes,).
    """

    def __init__(
        self,
        objective: Objective,
        x: Array,
        pixels: NDArray[np.uint64],
        variance: float | None = None,
        metallic: Array = METALLIC_NODES,
    ) -> None:
        layout = objective.layout
        self._known_variance = variance
        self._planes = len(layout.roughness_metallic)
        self._problem = objective.problem
        self._given, self._x = x, objective.for_core(x)
        known = objective.known_metallic
        self._metallic = metallic if known is None else np.array([known])
        roughness, metallic = np.meshgrid(ROUGHNESS_NODES, self._metallic, indexing="ij")
        self.roughness, self.metallic = roughness.ravel(), metallic.ravel()
        self._objective, self._noise_pixels = objective, pixels

    @lazy
    def variance(self) -> float:
        """s², of samples of weight 1, in units of x.

        From the residuals that are left at the given pixels and their degrees of freedom.
        """
        if self._known_variance is not None:
            return self._known_variance
        objective, layout, pixels = self._objective, self._objective.layout, self._noise_pixels
        _, squares = objective.with_best_albedo(self._given, pixels)
        samples = objective.samples * len(pixels) / layout.pixels
        lights = 0 if layout.lighting is None else layout.lighting.stop - layout.lighting.start
        unknowns = len(pixels) * layout.maps.stop / layout.pixels + lights
        degrees = max(samples - unknowns, FEWEST_DEGREES * samples)
        variance: float = max(float(squares.sum()) / degrees, LEAST_VARIANCE)
        return variance

    def likelihood(self, pixels: NDArray[np.uint64]) -> NDArray[np.float32]:
        """A, (Q, nodes); 1 at the best node of each pixel."""
        parts = [self._of_piece(pixels[chunk]) for chunk in _pieces(len(pixels))]
        return np.concatenate(parts)

    def best(self, pixels: NDArray[np.uint64]) -> Array:
        """Roughness and metallic, if it is free, of each pixel's best node: (Q, F)."""
        nodes = np.stack([self.roughness, self.metallic], axis=-1)[:, : self._planes]
        chunks = [pixels[chunk] for chunk in _pieces(len(pixels))]
        return np.concatenate([nodes[self._squares(c).argmin(axis=1)] for c in chunks])

    def _squares(self, pixels: NDArray[np.uint64]) -> NDArray[np.float32]:
        """Least Σ ω (I − T)² of each node, (Q, nodes)."""
        squares = self._problem.material_grid(self._x, pixels, ROUGHNESS_NODES, self._metallic)
        return squares.reshape(len(pixels), -1)

    def _of_piece(self, pixels: NDArray[np.uint64]) -> NDArray[np.float32]:
        excess = self._squares(pixels)
        excess -= excess.min(axis=1, keepdims=True)
        excess /= np.float32(2 * self.variance)
        # σ of roughness, from the curvature of its profile at the best node.
        profile = excess.reshape(len(pixels), len(ROUGHNESS_NODES), -1).min(axis=2)
        best = np.clip(profile.argmin(axis=1), 1, len(ROUGHNESS_NODES) - 2)[:, None]
        below, at, above = (np.take_along_axis(profile, best + i, axis=1) for i in (-1, 0, 1))
        curvature = np.maximum(below - 2 * at + above, FLATTEST) / NODE_DISTANCE**2
        share = 1 / (1 + SPACING**2 * curvature)  # η
        likelihood: NDArray[np.float32] = np.exp(-share * excess)
        return likelihood


@dataclass(frozen=True, eq=False)
class _Posterior:
    """Mean and variance of roughness and metallic, (Q, 2), and the cluster, (Q,)."""

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    cluster: Labels

    @classmethod
    def joined(cls, parts: list[_Posterior]) -> _Posterior:
        return cls(
            np.concatenate([part.mean for part in parts]),
            np.concatenate([part.variance for part in parts]),
            np.concatenate([part.cluster for part in parts]),
        )


@dataclass(frozen=True, eq=False)
class _Learnt:
    """Distributions over the nodes: row 0 of the whole picture, the others of large segments.

    Attributes
    ----------
    probabilities
        (rows, nodes), float32.
    groups
        (rows, nodes): which group of neighbouring nodes each belongs to, 0 = none.
    row
        By label: the row that a segment has.
    nodes
        (nodes, 2): their roughness and metallic.
    """

    probabilities: NDArray[np.float32]
    groups: Labels
    row: Labels
    nodes: NDArray[np.float32]

    @classmethod
    def of(cls, likelihood: NDArray[np.float32], labels: Labels, grid: _Grid) -> _Learnt:
        """From pixels of these labels; unclassified ones, of label 0, have the picture's."""
        from scipy.ndimage import label

        whole = _mixture(likelihood)
        rows = [whole]
        row = np.zeros(labels.max() + 1, np.intp)
        order = np.argsort(labels, kind="stable")
        found, starts = np.unique(labels[order], return_index=True)
        for segment, of_segment in zip(found, np.split(order, starts[1:]), strict=True):
            if segment and len(of_segment) >= OWN_PIXELS:
                row[segment] = len(rows)
                rows.append(_mixture(likelihood[of_segment], whole))
        probabilities = np.maximum(np.stack(rows), np.float32(RAREST))
        shape = (len(ROUGHNESS_NODES), -1)
        high = probabilities > SAME_GROUP * probabilities.max(axis=1, keepdims=True)
        groups = np.stack([label(of_row.reshape(shape))[0].ravel() for of_row in high])
        nodes = np.stack([grid.roughness, grid.metallic], axis=-1).astype(np.float32)
        return cls(probabilities, groups.astype(np.intp), row, nodes)

    def of_all(
        self, grid: _Grid, labels: Labels, stop: Callable[[], bool] = lambda: False
    ) -> _Posterior | None:
        """Of all pixels of the grid's objective, `labels` (P,).

        None if stopped before all pixels had theirs.
        """
        everything = np.arange(len(labels), dtype=np.uint64)
        parts = []
        for chunk in _pieces(len(labels)):
            if stop():
                return None
            parts.append(self.posterior(grid.likelihood(everything[chunk]), labels[chunk]))
        return _Posterior.joined(parts)

    def posterior(self, likelihood: NDArray[np.float32], labels: Labels) -> _Posterior:
        """Of pixels with these likelihoods, (Q, nodes), and labels."""
        known = labels < len(self.row)
        rows = np.where(known, self.row[np.where(known, labels, 0)], 0)
        posterior = likelihood * self.probabilities[rows]
        posterior /= posterior.sum(axis=1, keepdims=True)
        mean = posterior @ self.nodes
        variance = np.maximum(posterior @ self.nodes**2 - mean**2, 0)
        # The group that most of the posterior is in.
        group = np.zeros(len(posterior), np.intp)
        count = self.groups.max() + 1
        for of_row in np.unique(rows):
            of_groups = np.equal.outer(self.groups[of_row], np.arange(1, count))
            here = rows == of_row
            group[here] = (posterior[here] @ of_groups.astype(np.float32)).argmax(axis=1)
        cluster = labels * count + group
        return _Posterior(np.clip(mean, 0, 1), variance, cluster)


def _mixture(
    likelihood: NDArray[np.float32], whole: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Probabilities of the nodes by EM; `whole` counts as some pixels more."""
    nodes = likelihood.shape[1]
    probabilities = np.full(nodes, 1 / nodes, np.float32) if whole is None else whole
    for _ in range(EM_STEPS):
        of_pixels = likelihood @ probabilities
        probabilities = probabilities * (np.reciprocal(of_pixels) @ likelihood)
        if whole is not None:
            probabilities += np.float32(PICTURE_PIXELS) * whole
        probabilities /= probabilities.sum()
    return probabilities


def _pull(posterior: _Posterior, floor: float, variance: float, planes: int) -> tuple[Pull, Labels]:
    """The pull, and the numbers of its clusters as the posterior has them; see `_drawn`."""
    clusters, cluster = np.unique(posterior.cluster, return_inverse=True)
    centre, precision = _drawn(posterior, floor, variance, planes)
    return Pull(centre, precision, cluster, len(clusters)), clusters


def _drawn(
    posterior: _Posterior, floor: float, variance: float, planes: int
) -> tuple[Array, Array]:
    """Where the first of roughness and metallic, or both, are pulled, and how hard, each (P, F).

    `variance` is s² times the strength.
    """
    used = slice(planes)
    precision = variance / (floor**2 + posterior.variance[:, used].astype(np.float64))
    return posterior.mean[:, used].astype(np.float64), precision
