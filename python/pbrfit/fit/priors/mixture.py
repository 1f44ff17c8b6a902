"""The mixture prior on materials: which roughness and metallic a segment is made of, found by EM.

Pictures with noise leave roughness of a single pixel uncertain by 0.1, and all pixels of an object
together know it to 0.01. A penalty on differences helps only where segments are right and of one
material. Here each pixel keeps its whole likelihood over a grid of roughness and metallic, and each
segment (the whole picture if there are none) has a discrete distribution on that grid, fitted to
its pixels: one node if it is one material, two if two were merged, many if roughness varies. Each
pixel's prior then is a Gaussian with mean and variance of its posterior. This is nonparametric
empirical Bayes (H. Robbins, "An empirical Bayes approach to statistics", 1956; EM for the discrete
mixture as in N. Laird, J. Am. Stat. Assoc. 73, 1978).

With noise s², lights known and nodes k,

    l_ik = min over albedo of Σ ω (I − T)² / 2s²          A_ik = exp(−η_i (l_ik − min_k l_ik))
    p_k ← p_k mean_i [A_ik / Σ_j A_ij p_j]                 posterior_ik ∝ A_ik p_k
    prior of pixel i: s² a_i (v_i − c_i − δ)²             a_i = 1 / (σ_min² + V_i)

with c and V mean and variance of the posterior. η = σ²/(σ² + spacing²) widens likelihoods that are
too sharp for the grid. Of A to the power 1/η, what the pictures say, A is in the posterior; the
share 1 − η is left for the fit that follows. So that data count once, a pixel minimises

    (1 − η_i) Σ ω (I − T)² + s² a_i (v_i − c_i)²

which is a prior of precision a_i/(1 − η_i) beside the whole sum: a noisy pixel stays at the mean of
its posterior, a sharp one finds what is between the nodes. In the rounds below, where pixels have
to follow the lights, and beside L-BFGS-B, which moves both to its end, it is a_i. The offset δ is
common to the pixels of a segment that fell to the same group of neighbouring nodes, and free: so
the prior gathers pixels without holding on to where they were gathered while lights were still
wrong.

Lights and prior depend on each other. They are found together on a few pixels, in rounds of EM and
joint steps (`pbrfit.fit.joint`), and then applied to all. s² is that in the likelihood of a pixel,
larger than the residuals' variance where these are no noise (`pbrfit.fit.misfit`). Lights that were
found from different starts compare by `surprise`, in which pixels' materials are summed over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.joint import SharedFit, minimize
from pbrfit.fit.light_prior import LightPrior, as_in_core
from pbrfit.fit.normal_equations import albedo_solved_for
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.sampling import evenly_spaced_over, slices
from pbrfit.threads import in_pieces, one_blas_thread

Array = NDArray[np.float64]
Pixels = NDArray[np.uint64]
Labels = NDArray[np.intp]
Stop = Callable[[], bool]

ROUGHNESS_NODES = np.linspace(*settings.PRIOR_ROUGHNESS_NODES)
METALLIC_NODES = np.linspace(*settings.PRIOR_METALLIC_NODES)
PURE_NODES = np.array([0.0, 1.0])
"""Among surroundings, of which something is always left that is none of a material: as large as a
dielectric's lobe, so that metallic between both would take it up."""
NODE_DISTANCE = float(ROUGHNESS_NODES[1] - ROUGHNESS_NODES[0])


@dataclass(frozen=True, eq=False)
class FittedPrior:
    """The prior as fitted to some pixels, to be held for others of the same segments and lights."""

    distributions: _Distributions
    """Of the segments."""
    variance: float
    """s², of samples of weight 1, in units of x."""
    strength: float
    """`Priors.material`."""
    counted_once: bool
    """Whether data that the posterior has count once, beside it."""

    def applied(
        self, objective: Objective, x: Array, stop: Stop
    ) -> tuple[Array, GaussianPrior] | None:
        """X with all pixels at the mean of their prior, each with its best albedo; and the prior.

        None if stopped before all pixels had theirs.
        """
        grid = _Grid(objective, x, self.variance)
        posterior = self.distributions.of_all(grid, stop)
        if posterior is None:
            return None
        prior = self.around(posterior, objective)
        x = x.copy()
        _put_all(objective, x, prior.mean)
        return x, replace(prior, cluster=None)

    def around(self, posterior: _Posterior, objective: Objective) -> GaussianPrior:
        """Of pixels with this posterior."""
        prior = posterior.prior(settings.PRIOR_SIGMA_MIN, self.strength * self.variance, objective)
        if not self.counted_once:
            return prior
        precision = prior.precision / posterior.unused[:, None]
        return replace(prior, precision=precision)


@one_blas_thread()
def fit_prior(
    objective: Objective,
    x: Array,
    strength: float,
    variance: float,
    stop: Stop = lambda: False,
    *,
    counted_once: bool,
) -> tuple[Array, GaussianPrior, FittedPrior] | None:
    """Fit the prior under the lights of x, with the strength of `Priors.material`.

    `variance` is s² in the likelihood of a pixel. Returned are x for all pixels, their prior, and
    what was fitted; None if time ran out before all pixels had theirs. `stop` is asked between
    pieces of the pixels.
    """
    x = x.copy()
    grid = _Grid(objective, x, variance)
    distributions = _fit_distributions(grid)
    posterior = distributions.of_all(grid, stop)
    if posterior is None:
        return None
    fitted = FittedPrior(distributions, variance, strength, counted_once)
    prior = fitted.around(posterior, objective)
    _put_all(objective, x, prior.mean)
    return x, prior, fitted


def prior_at(
    objective: Objective, x: Array, sigma_min: float, variance: float, metallic: Array
) -> GaussianPrior:
    """The prior of all pixels at x, fitted to an even share of them; lights stay.

    `metallic` is that of the nodes, and not read where it is known.
    """
    grid = _Grid(objective, x, variance, metallic)
    posterior = _fit_distributions(grid).of_all(grid)
    assert posterior is not None
    return posterior.prior(sigma_min, variance, objective)


def _labels(objective: Objective) -> Labels:
    """The pixels' segments (P,), 0 = unclassified."""
    layout = objective.layout
    return np.zeros(layout.pixels, np.intp) if layout.segments is None else layout.segments


def _fit_distributions(grid: _Grid) -> _Distributions:
    """To an even share of the grid's pixels."""
    labels = _labels(grid.objective)
    many = evenly_spaced_over(labels, settings.PRIOR_FIT_PIXELS)
    return _Distributions.of(grid.likelihood(many), labels[many], grid)


def with_lights(
    objective: Objective,
    x: Array,
    strength: float,
    variance: float,
    shared: SharedFit,
    stop: Stop = lambda: False,
) -> Array:
    """X with the lights that some pixels, with their prior, find from those of x.

    `variance` is s² in the likelihood of a pixel. `stop` is asked between rounds.
    """
    x = x.copy()
    for sigma_min, at_most, steps in settings.PRIOR_ROUNDS:
        if stop():
            break
        labels = _labels(objective)
        pixels = evenly_spaced_over(labels, at_most)
        few, part = objective.restricted(pixels), objective.part_of(x, pixels)
        everything, labels = np.arange(few.pixels, dtype=np.uint64), labels[pixels]
        grid = _Grid(few, part, variance)
        likelihood = grid.likelihood(everything)
        posterior = _Distributions.of(likelihood, labels, grid).posterior(likelihood, labels)
        prior = posterior.prior(sigma_min, strength * variance, few)
        _put(few, part, everything, prior.mean)
        sum_sq = few.put_best_albedo(part, everything)
        fit = shared.joint_fit(few, part, sum_sq, prior=prior, stop=stop)
        minimize(fit, steps, settings.GAIN_MIN)
        x[objective.layout.maps.stop :] = part[few.layout.maps.stop :]
    return x


def prior_without_data(
    objective: Objective, x: Array, strength: float, variance: float
) -> GaussianPrior:
    """A prior of all pixels around the groups of nodes that they fell to; x is put to its mean.

    Other than one around the pixels' own posteriors, it has no noise of theirs in it. `strength`
    and `variance` are as for `fit_prior`.
    """
    labels, everything = _labels(objective), np.arange(objective.pixels, dtype=np.uint64)
    grid = _Grid(objective, x, variance)
    likelihood = grid.likelihood(everything)
    distributions = _Distributions.of(likelihood, labels, grid)
    groups = distributions.without_data(distributions.posterior(likelihood, labels), labels)
    groups = _with_spread(objective, x, groups, variance)
    prior = groups.prior(settings.SPREAD_MIN, strength * variance, objective)
    _put(objective, x, everything, prior.mean)
    return prior


def _with_spread(objective: Objective, x: Array, groups: _Posterior, variance: float) -> _Posterior:
    """Groups of nodes with the spread of roughness that their pixels have, if that is less.

    Nodes are 0.03 apart, and lights react to a spread that is not there. At the mean of its group a
    pixel, albedo solved for, has the score u = −∂l/∂r and the information h. With a spread W² the
    scores of a group have the variance h + h² W², so

        W² = Σ [(u − h ū)² − h] / Σ h²      ū = Σ u / Σ h

    (the estimate by moments of a meta-analysis; R. DerSimonian and N. Laird, Controlled Clinical
    Trials 7, 1986).
    """
    x, everything = x.copy(), np.arange(objective.pixels, dtype=np.uint64)
    _put(objective, x, everything, groups.gaussian(1.0, 1.0, objective)[0])
    objective.put_best_albedo(x, everything)
    own, gradient = albedo_solved_for(objective, x)
    h, u = own[:, 0, 0], gradient[:, 0]  # times the variance
    _, cluster = np.unique(groups.cluster, return_inverse=True)
    tiny = np.finfo(np.float64).tiny
    mean = np.bincount(cluster, u) / np.maximum(np.bincount(cluster, h), tiny)
    u -= h * mean[cluster]
    excess = np.bincount(cluster, u**2 - variance * h)
    spread = excess / np.maximum(np.bincount(cluster, h**2), tiny)
    found = groups.variance.copy()
    found[:, 0] = np.clip(spread[cluster], 0, found[:, 0])
    return groups._replace(variance=found)


def surprise(objective: Objective, x: Array, variance: float, prior: LightPrior) -> float:
    """−2 ln of the likelihood of the lights of x, with their prior, less a constant: as χ².

    Σ_i [min_k 2 l_ik − 2 ln Σ_k A_ik p_k] over an even share of the pixels: their roughness and
    metallic are summed over and not fitted, or more freedom would always be better.
    """
    labels = _labels(objective)
    pixels = evenly_spaced_over(labels, settings.PRIOR_ROUNDS[-1][1])
    grid, labels = _Grid(objective, x, variance), labels[pixels]
    likelihood = grid.likelihood(pixels)
    distributions = _Distributions.of(likelihood, labels, grid)
    marginal = (likelihood.values * distributions.probabilities[distributions.rows(labels)]).sum(1)
    lights = as_in_core(x[objective.layout.lighting], objective).ravel()
    misfit = float(likelihood.least.sum(dtype=np.float64)) + prior.cost(lights)
    return misfit / variance - 2 * float(np.log(marginal).sum(dtype=np.float64))


def _put_all(objective: Objective, x: Array, values: Array) -> None:
    """Give all pixels of x these roughness and metallic (P, F), and their best albedo."""
    everything = np.arange(objective.pixels, dtype=np.uint64)
    _put(objective, x, everything, values)
    objective.put_best_albedo(x, everything)


def _put(objective: Objective, x: Array, pixels: Pixels, values: Array) -> None:
    """Give some pixels of x these roughness and metallic (Q, F)."""
    for block, of_block in zip(objective.layout.roughness_metallic, values.T, strict=True):
        x[block][pixels] = of_block


class _Grid:
    """Likelihoods over the nodes, (roughness, metallic) row by row, with the lights of x."""

    def __init__(
        self, objective: Objective, x: Array, variance: float, metallic: Array | None = None
    ) -> None:
        self._planes = len(objective.layout.roughness_metallic)
        self._problem, self._x = objective.problem, objective.for_core(x)
        self.objective, self._variance = objective, variance
        known = objective.known_metallic
        if metallic is None:
            metallic = METALLIC_NODES if objective.transfer is None else PURE_NODES
        self._metallic = metallic if known is None else np.array([known])
        nodes = np.meshgrid(ROUGHNESS_NODES, self._metallic, indexing="ij")
        self.roughness, self.metallic = (of_nodes.ravel() for of_nodes in nodes)

    def likelihood(self, pixels: Pixels) -> _Likelihood:
        """Of some pixels."""

        def of_piece(piece: slice) -> _Likelihood:
            return self.of_piece(pixels[piece])

        pieces = slices(len(pixels), settings.PIXELS_AT_ONCE)
        parts = in_pieces(self.objective.threads, of_piece, pieces)
        return _Likelihood(*map(np.concatenate, zip(*parts, strict=True)))

    def _sum_sq(self, pixels: Pixels) -> NDArray[np.float32]:
        """Least Σ ω (I − T)² of each node, (Q, nodes)."""
        sum_sq = self._problem.material_grid(self._x, pixels, ROUGHNESS_NODES, self._metallic)
        return sum_sq.reshape(len(pixels), -1)

    def of_piece(self, pixels: Pixels) -> _Likelihood:
        """The same of few enough pixels."""
        excess = self._sum_sq(pixels)
        least = excess.min(axis=1, keepdims=True)
        excess -= least
        excess /= np.float32(2 * self._variance)
        # σ of roughness, from the curvature of its profile at the best node.
        profile = _least(excess.reshape(len(pixels), len(ROUGHNESS_NODES), -1))
        best = np.clip(profile.argmin(axis=1), 1, len(ROUGHNESS_NODES) - 2)[:, None]
        below, at, above = (np.take_along_axis(profile, best + i, axis=1) for i in (-1, 0, 1))
        curvature = (
            np.maximum(below - 2 * at + above, settings.LIKELIHOOD_CURVATURE_MIN) / NODE_DISTANCE**2
        )
        sharpness = settings.PRIOR_NODE_SPACING**2 * curvature  # spacing²/σ²
        share = 1 / (1 + sharpness)  # η
        excess *= -share
        np.exp(excess, out=excess)
        return _Likelihood(excess, (sharpness * share)[:, 0], least[:, 0])


def _least(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Over the last axis, which is short: numpy's own minimum is for long ones."""
    found = values[..., 0].copy()
    for i in range(1, values.shape[-1]):
        np.minimum(found, values[..., i], out=found)
    return found


class _Likelihood(NamedTuple):
    """What pixels' samples say about the nodes."""

    values: NDArray[np.float32]
    """A, (Q, nodes); 1 at the best node of each pixel."""
    unused: NDArray[np.float32]
    """1 − η, (Q,)."""
    least: NDArray[np.float32]
    """Σ ω (I − T)² at the best node, (Q,)."""


class _Posterior(NamedTuple):
    """Mean and variance of roughness and metallic, (Q, 2), the cluster and 1 − η, (Q,)."""

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    cluster: Labels
    unused: NDArray[np.float32]

    def gaussian(
        self, sigma_min: float, variance: float, objective: Objective
    ) -> tuple[Array, Array]:
        """Mean and precision of the unknown ones of roughness and metallic, each (P, F).

        `variance` is s² times the strength.
        """
        used = slice(len(objective.layout.roughness_metallic))
        precision = variance / (sigma_min**2 + self.variance[:, used].astype(np.float64))
        return self.mean[:, used].astype(np.float64), precision

    def prior(self, sigma_min: float, variance: float, objective: Objective) -> GaussianPrior:
        """See `gaussian`."""
        _, cluster = np.unique(self.cluster, return_inverse=True)
        blocks, factor = objective.layout.roughness_metallic, 1 / objective.total_weight
        mean, precision = self.gaussian(sigma_min, variance, objective)
        return GaussianPrior(mean, precision, cluster, blocks, factor)


@dataclass(frozen=True, eq=False)
class _Distributions:
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
    def of(cls, found: _Likelihood, labels: Labels, grid: _Grid) -> _Distributions:
        """From pixels of these labels; unclassified ones, of label 0, have the picture's."""
        from scipy.ndimage import label

        likelihood = found.values
        whole = _mixture(likelihood)
        rows = [whole]
        row = np.zeros(labels.max() + 1, np.intp)
        order = np.argsort(labels, kind="stable")
        segments, starts = np.unique(labels[order], return_index=True)
        for segment, of_segment in zip(segments, np.split(order, starts[1:]), strict=True):
            if segment and len(of_segment) >= settings.SEGMENT_PIXELS_MIN:
                row[segment] = len(rows)
                rows.append(_mixture(likelihood[of_segment], whole))
        probabilities = np.maximum(np.stack(rows), np.float32(settings.NODE_PROBABILITY_MIN))
        shape = (len(ROUGHNESS_NODES), -1)
        high = probabilities > settings.GROUP_PROBABILITY_SHARE * probabilities.max(
            axis=1, keepdims=True
        )
        groups = np.stack([label(of_row.reshape(shape))[0].ravel() for of_row in high])
        nodes = np.stack([grid.roughness, grid.metallic], axis=-1).astype(np.float32)
        return cls(probabilities, groups.astype(np.intp), row, nodes)

    def of_all(self, grid: _Grid, stop: Stop = lambda: False) -> _Posterior | None:
        """The posterior of all pixels of the grid's objective; None if stopped before."""
        labels = _labels(grid.objective)
        everything = np.arange(len(labels), dtype=np.uint64)

        def of_piece(chunk: slice) -> _Posterior | None:
            if stop():
                return None
            return self.posterior(grid.of_piece(everything[chunk]), labels[chunk])

        parts = in_pieces(
            grid.objective.threads, of_piece, slices(len(labels), settings.PIXELS_AT_ONCE)
        )
        found = [part for part in parts if part is not None]
        if len(found) < len(parts):
            return None
        return _Posterior(*map(np.concatenate, zip(*found, strict=True)))

    def without_data(self, posterior: _Posterior, labels: Labels) -> _Posterior:
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

    def posterior(self, likelihood: _Likelihood, labels: Labels) -> _Posterior:
        """Of pixels with these likelihoods and labels."""
        rows = self.rows(labels)
        posterior = self.probabilities[rows]
        posterior *= likelihood.values
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
        return _Posterior(np.clip(mean, 0, 1), variance, cluster, likelihood.unused)


def _mixture(
    likelihood: NDArray[np.float32], whole: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Probabilities of the nodes by EM; `whole` counts as some pixels more."""
    nodes = likelihood.shape[1]
    probabilities = np.full(nodes, 1 / nodes, np.float32) if whole is None else whole
    for _ in range(settings.EM_ITERATIONS):
        of_pixels = likelihood @ probabilities
        probabilities = probabilities * (np.reciprocal(of_pixels) @ likelihood)
        if whole is not None:
            probabilities += np.float32(settings.PICTURE_PSEUDO_PIXELS) * whole
        probabilities /= probabilities.sum()
    return probabilities
