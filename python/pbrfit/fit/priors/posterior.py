"""What pixels say about roughness and metallic, and what they are with a prior: on a grid of nodes.

With noise s², lights known and nodes k,

    l_ik = min over albedo of Σ ω (I − T)² / 2s²          A_ik = exp(−η_i (l_ik − min_k l_ik))
    p_k ← [w Σ_i A_ik p_k / Σ_j A_ij p_j + n q_k] / sum over k
    posterior_ik ∝ A_ik p_k

with q the prior that p begins from, which counts for n pixels: of a segment the distribution of the
picture, of the picture the population of all surfaces (`population`). η = σ²/(σ² + spacing²) widens
likelihoods that are too sharp for the grid. What is left of them, 1 − η, is for the fit after.

**Pixels that share an error.** That of the lights is common to all, and P pixels whose variance by
lights is φ times that by their own samples tell no more than 1/φ of them. And pixels of a segment
share what makes samples more uncertain than their residuals show: the ratio of these variances is
how many say as much as one. So n is `POPULATION_PIXELS` (1 + φ P) times that ratio
(`Pooling`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.estimates import evidence
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.population import population
from pbrfit.fit.sampling import Labels, Pixels, slices
from pbrfit.lazy import lazy
from pbrfit.threads import in_pieces
from pbrfit.values.arrays import Array, Floats

Stop = Callable[[], bool]

ROUGHNESS_NODES = np.linspace(*settings.PRIOR_ROUGHNESS_NODES)
METALLIC_NODES = np.linspace(*settings.PRIOR_METALLIC_NODES)
PURE_NODES = np.array([0.0, 1.0])
"""Among surroundings, of which something is always left that is none of a material: as large as a
dielectric's lobe, so that metallic between both would take it up."""
INTERVAL = 0.95
"""Probability between the quantiles of a posterior."""

LOG_LIKELIHOOD_MIN = np.float32(np.log(settings.NODE_PROBABILITY_MIN))
NODE_DISTANCE = float(ROUGHNESS_NODES[1] - ROUGHNESS_NODES[0])


@dataclass(frozen=True)
class Pooling:
    """How much pixels of one material tell together."""

    light_share: float = 0.0
    """φ: variance of a pixel's roughness and metallic by the lights, over that by its samples."""
    tempering: float = 1.0
    """Variance in a pixel's likelihood over that of its residuals, 1 or more."""
    channels: int = 3
    """Of the pictures: grey pixels tell a third, so that a prior counts for more of them."""

    def prior_pixels(self, pixels: int) -> float:
        """How many pixels the prior of so many counts for."""
        shared = 1 + self.light_share * pixels
        own = settings.POPULATION_PIXELS * 3 / self.channels
        return own * shared * self.tempering


def labels_of(objective: Objective) -> Labels:
    """The pixels' segments (P,), 0 = unclassified."""
    layout = objective.layout
    return np.zeros(layout.pixels, np.intp) if layout.segments is None else layout.segments


class Grid:
    """Likelihoods over the nodes, (roughness, metallic) row by row, with the lights of x."""

    def __init__(
        self, objective: Objective, x: Array, variance: float, metallic: Array | None = None
    ) -> None:
        self._problem, self._x = objective.problem, objective.for_core(x)
        self.objective, self._variance = objective, variance
        known = objective.known_metallic
        if metallic is None:
            metallic = METALLIC_NODES if objective.transfer is None else PURE_NODES
        self._metallic = metallic if known is None else np.array([known])
        nodes = np.meshgrid(ROUGHNESS_NODES, self._metallic, indexing="ij")
        self.nodes = np.stack(nodes, axis=-1).reshape(-1, 2)

    def likelihood(self, pixels: Pixels) -> Likelihood:
        """Of some pixels."""
        pieces = slices(len(pixels), settings.GRID_PIXELS_AT_ONCE)
        threads = self.objective.threads
        parts = in_pieces(threads, lambda piece: self.of_piece(pixels[piece]), pieces)
        return Likelihood(*map(np.concatenate, zip(*parts, strict=True)))

    def of_piece(self, pixels: Pixels) -> Likelihood:
        """The same of few enough pixels."""
        of_core = self._problem.material_grid(self._x, pixels, ROUGHNESS_NODES, self._metallic)
        excess = of_core.reshape(len(pixels), -1)  # least Σ ω (I − T)² of each node
        excess -= excess.min(axis=1, keepdims=True)
        excess /= np.float32(2 * self._variance)
        # σ of roughness, from the curvature of its profile at the best node.
        profile = _least(excess.reshape(len(pixels), len(ROUGHNESS_NODES), -1))
        best = np.clip(profile.argmin(axis=1), 1, len(ROUGHNESS_NODES) - 2)[:, None]
        below, at, above = (np.take_along_axis(profile, best + i, axis=1) for i in (-1, 0, 1))
        bend = np.maximum(below - 2 * at + above, settings.LIKELIHOOD_CURVATURE_MIN)
        sharpness = settings.PRIOR_NODE_SPACING**2 * (bend / NODE_DISTANCE**2)  # spacing²/σ²
        share = 1 / (1 + sharpness)  # η
        excess *= -share
        np.maximum(excess, LOG_LIKELIHOOD_MIN, out=excess)
        np.exp(excess, out=excess)
        return Likelihood(
            excess, (sharpness * share)[:, 0], evidence(self.objective, pixels, self.nodes)
        )


def _least(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Over the last axis, which is short: numpy's own minimum is for long ones."""
    found = values[..., 0].copy()
    for i in range(1, values.shape[-1]):
        np.minimum(found, values[..., i], out=found)
    return found


class Likelihood(NamedTuple):
    """What pixels' samples say about the nodes."""

    values: NDArray[np.float32]
    """A, (Q, nodes); 1 at the best node of each pixel."""
    unused: NDArray[np.float32]
    """1 − η, (Q,)."""
    evidence: NDArray[np.float32]
    """E, (Q, nodes): what estimates say, which is no part of the values; (Q, 1) where nothing."""


class Posterior(NamedTuple):
    """What pixels are, by their samples and their prior; the first of two is roughness."""

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    """(Q, 2)."""
    covariance: NDArray[np.float32]
    """(Q,): of roughness and metallic."""
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    """(Q, 2): quantiles, `INTERVAL` of the probability between them."""
    cluster: Labels
    """(Q,): the group of nodes that most of it is in."""
    unused: NDArray[np.float32]
    """(Q,): 1 − η."""

    def part(self, pixels: slice | Pixels) -> Posterior:
        """Of some pixels."""
        return Posterior(*(of_all[pixels] for of_all in self))  # type: ignore[arg-type]

    def prior(self, sigma_min: float, variance: float, objective: Objective) -> GaussianPrior:
        """On the unknown ones of roughness and metallic; `variance` is s² times the strength."""
        _, cluster = np.unique(self.cluster, return_inverse=True)
        blocks, factor = objective.layout.roughness_metallic, 1 / objective.total_weight
        mean, own = (of[:, : len(blocks)].astype(np.float64) for of in (self.mean, self.variance))
        return GaussianPrior(mean, variance / (sigma_min**2 + own), cluster, blocks, factor)


@dataclass(frozen=True, eq=False)
class Distributions:
    """Distributions over the nodes: row 0 of the whole picture, the others of large segments."""

    probabilities: NDArray[np.float32]
    """(rows, nodes), float32."""
    groups: Labels
    """(rows, nodes): which group of neighbouring nodes each belongs to, 0 = none."""
    row: Labels
    """By label: the row that a segment has."""
    nodes: NDArray[np.float32]
    """(nodes, 2): their roughness and metallic."""

    @classmethod
    def of(
        cls, found: Likelihood, labels: Labels, grid: Grid, pooling: Pooling | None = None
    ) -> Distributions:
        """From pixels of these labels; unclassified ones, of label 0, have the picture's.

        Without pooling the likeliest ones: where lights are to follow, a prior would pull at them.
        """
        from scipy.ndimage import label

        likelihood = found.values
        base = np.full(likelihood.shape[1], 1 / likelihood.shape[1], np.float32)
        if pooling is not None:
            base = population(*grid.nodes.T)
        more = 0.0 if pooling is None else pooling.prior_pixels(len(likelihood))
        whole = mixture_of(likelihood, with_evidence(base, found.evidence), more)
        order = np.argsort(labels, kind="stable")
        segments, starts = np.unique(labels[order], return_index=True)
        large = [
            of_segment
            for segment, of_segment in zip(segments, np.split(order, starts[1:]), strict=True)
            if segment and len(of_segment) >= settings.SEGMENT_PIXELS_MIN
        ]

        def of_pixels(pixels: Labels) -> NDArray[np.float32]:
            more = settings.PICTURE_PSEUDO_PIXELS
            if pooling is not None:
                more = pooling.prior_pixels(len(pixels))
            return mixture_of(
                likelihood[pixels], with_evidence(whole, found.evidence[pixels]), more
            )

        rows = [whole, *map(of_pixels, large)]
        row = np.zeros(labels.max() + 1, np.intp)
        row[[labels[pixels[0]] for pixels in large]] = np.arange(1, len(rows))
        probabilities = np.stack(rows)
        shape = (len(ROUGHNESS_NODES), -1)
        largest = probabilities.max(axis=1, keepdims=True)
        high = probabilities > settings.GROUP_PROBABILITY_SHARE * largest
        groups = np.stack([label(of_row.reshape(shape))[0].ravel() for of_row in high])
        return cls(probabilities, groups.astype(np.intp), row, grid.nodes.astype(np.float32))

    @classmethod
    def flat(cls, grid: Grid) -> Distributions:
        """All nodes alike: no prior."""
        count, nodes = len(grid.nodes), grid.nodes.astype(np.float32)
        probabilities = np.full((1, count), 1 / count, np.float32)
        return cls(probabilities, np.ones((1, count), np.intp), np.zeros(1, np.intp), nodes)

    @lazy
    def _functions(self) -> NDArray[np.float32]:
        """(nodes, 6 + levels): 1, r, m, r², m², r m, and 1 where it has a roughness, a metallic.

        A posterior's sums of these over the nodes are all that is asked of it.
        """
        roughness, metallic = self.nodes.T
        levels = [np.equal.outer(of, np.unique(of)) for of in (roughness, metallic)]
        powers = [np.ones_like(roughness), *self.nodes.T, *(self.nodes.T**2), roughness * metallic]
        return np.column_stack([*powers, *levels]).astype(np.float32)

    def of_all(self, grid: Grid, stop: Stop = lambda: False) -> Posterior | None:
        """The posterior of all pixels of the grid's objective; None if stopped before."""
        labels, everything = labels_of(grid.objective), grid.objective.everything

        def of_piece(chunk: slice) -> Posterior | None:
            if stop():
                return None
            return self.posterior(grid.of_piece(everything[chunk]), labels[chunk])

        pieces = slices(len(labels), settings.GRID_PIXELS_AT_ONCE)
        parts = in_pieces(grid.objective.threads, of_piece, pieces)
        found = [part for part in parts if part is not None]
        if len(found) < len(parts):
            return None
        return Posterior(*map(np.concatenate, zip(*found, strict=True)))

    def without_data(self, posterior: Posterior, labels: Labels) -> Posterior:
        """Means and variances of the groups of nodes that pixels fell to.

        Where the mean metallic is nearest to 0 or 1, these hold exactly: surfaces are dielectrics
        or metals, and whatever a dielectric has of a metal changes its highlight, and so the scale
        of lights, many times as much.
        """
        rows, count = self.rows(labels), self.groups.max() + 1
        kinds, kind = np.unique(rows * count + posterior.cluster % count, return_inverse=True)
        row, group = np.divmod(kinds, count)
        share = self.probabilities[row] * (self.groups[row] == group[:, None] + 1)
        share /= np.maximum(share.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
        mean = share @ self.nodes
        variance = np.maximum(share @ self.nodes**2 - mean**2, 0)
        nearest = np.round(mean[:, 1])
        levels = np.unique(self.nodes[:, 1])
        half = np.diff(levels).min(initial=1.0) / 2
        pure = np.abs(mean[:, 1] - nearest) < half
        mean[pure, 1], variance[pure, 1] = nearest[pure], 0
        return posterior._replace(mean=np.clip(mean[kind], 0, 1), variance=variance[kind])

    def rows(self, labels: Labels) -> Labels:
        """Of pixels with these labels."""
        known = labels < len(self.row)
        return np.where(known, self.row[np.where(known, labels, 0)], 0)

    def share_in_groups(self, likelihood: Likelihood, labels: Labels) -> NDArray[np.float32]:
        """(Q,): how much of pixels' posteriors is at nodes of any group."""
        rows = self.rows(labels)
        shares = self.probabilities[rows] * likelihood.values
        return np.asarray((shares * (self.groups[rows] > 0)).sum(axis=1) / shares.sum(axis=1))

    def posterior(self, likelihood: Likelihood, labels: Labels) -> Posterior:
        """Of pixels with these likelihoods and labels."""
        rows = self.rows(labels)
        posterior = self.probabilities[rows]
        posterior *= likelihood.values
        if likelihood.evidence.shape[1] > 1:
            alone = rows == 0
            posterior[alone] *= likelihood.evidence[alone]
        sums = posterior @ self._functions
        sums /= sums[:, :1]
        mean, squares, product = sums[:, 1:3], sums[:, 3:5], sums[:, 5]
        variance = np.maximum(squares - mean**2, 0)
        covariance = product - mean.prod(axis=1)
        by_roughness, by_metallic = np.split(sums[:, 6:], [len(ROUGHNESS_NODES)], axis=1)
        intervals = [
            _interval(by_roughness, ROUGHNESS_NODES, NODE_DISTANCE),
            _interval(by_metallic, self.nodes[: by_metallic.shape[1], 1], 0.0),
        ]
        low, high = np.stack(intervals, axis=-1).astype(np.float32)
        # The group that most of the posterior is in.
        group = np.zeros(len(posterior), np.intp)
        count = self.groups.max() + 1
        for of_row in np.unique(rows):
            of_groups = np.equal.outer(self.groups[of_row], np.arange(1, count))
            here = rows == of_row
            group[here] = (posterior[here] @ of_groups.astype(np.float32)).argmax(axis=1)
        cluster = labels * count + group
        mean = np.clip(mean, 0, 1)
        return Posterior(mean, variance, covariance, low, high, cluster, likelihood.unused)


def with_evidence(
    probabilities: NDArray[np.float32], evidence: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Probabilities of nodes times the mean of what estimates say of pixels of one material."""
    if evidence.shape[1] == 1:
        return probabilities
    found = probabilities * evidence.mean(axis=0)
    return np.asarray(np.maximum(found / found.sum(), settings.NODE_PROBABILITY_MIN), np.float32)


def _interval(probabilities: NDArray[np.float32], values: Floats, width: float) -> Array:
    """(2, Q): quantiles of nodes (Q, K), each as wide as this around its value."""
    total = probabilities.cumsum(axis=1, dtype=np.float64)
    total /= total[:, -1:]
    found = []
    for level in (0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2):
        at = np.argmax(total >= level, axis=1)[:, None]
        before = np.where(at > 0, np.take_along_axis(total, np.maximum(at - 1, 0), axis=1), 0.0)
        own = np.take_along_axis(total, at, axis=1) - before
        share = (level - before) / np.maximum(own, np.finfo(np.float64).tiny)
        found.append(np.clip(values[at] + width * (share - 0.5), 0, 1)[:, 0])
    return np.stack(found)


def mixture_of(
    likelihood: NDArray[np.float32], prior: NDArray[np.float32], prior_pixels: float
) -> NDArray[np.float32]:
    """Probabilities of the nodes by EM, where their prior counts for so many pixels more."""
    # Both products of a step read each part while a processor's cache still holds it.
    pieces = slices(len(likelihood), settings.EM_PIXELS_AT_ONCE)
    parts = [np.asfortranarray(likelihood[piece]) for piece in pieces]
    probabilities = prior

    def shares(part: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(np.reciprocal(part @ probabilities) @ part)

    for _ in range(settings.EM_ITERATIONS):
        # On one thread: a part takes no longer than handing it to another.
        probabilities = probabilities * np.sum([shares(part) for part in parts], axis=0)
        probabilities += np.float32(prior_pixels) * prior
        probabilities /= probabilities.sum()
        np.maximum(probabilities, settings.NODE_PROBABILITY_MIN, out=probabilities)
    return probabilities
