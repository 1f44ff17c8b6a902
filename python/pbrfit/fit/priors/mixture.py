"""The mixture prior on materials: which roughness and metallic a segment is made of, found by EM.

Pictures with noise leave roughness of a single pixel uncertain by 0.1, and all pixels of an object
together know it to 0.01. A penalty on differences helps only where segments are right and of one
material. Here each pixel keeps its whole likelihood over a grid of roughness and metallic, and each
segment (the whole picture if there are none) has a discrete distribution on that grid, fitted to
its pixels: one node if it is one material, two if two were merged, many if roughness varies. Each
pixel's prior then is a Gaussian with mean and variance of its posterior. This is nonparametric
empirical Bayes (H. Robbins, "An empirical Bayes approach to statistics", 1956; EM for the discrete
mixture as in N. Laird, J. Am. Stat. Assoc. 73, 1978).

With noise s², and c and V mean and variance of the posterior (`pbrfit.fit.priors.posterior`),

    prior of pixel i: s² a_i (v_i − c_i − δ)²             a_i = 1 / (σ_min² + V_i)

Of what the pictures say, the share 1 − η is not in the posterior, but left for the fit that
follows. So that data count once, a pixel minimises

    (1 − η_i) Σ ω (I − T)² + s² a_i (v_i − c_i)²

which is a prior of precision a_i/(1 − η_i) beside the whole sum: a noisy pixel stays at the mean of
its posterior, a sharp one finds what is between the nodes. In the rounds below, where pixels have
to follow the lights, and beside L-BFGS-B, which moves both to its end, it is a_i. The offset δ is
common to the pixels of a segment that fell to the same group of neighbouring nodes, and free: so
the prior gathers pixels without holding on to where they were gathered while lights were still
wrong.

Lights and prior depend on each other. They are found together on a few pixels, in rounds of EM and
joint steps (`pbrfit.fit.joint`), and then applied to all. Around its own posterior each pixel would
pull at the lights with its noise, which biases them however many pixels there are (J. Neyman and E.
Scott, Econometrica 16, 1948); so in the last round, where there are segments, pixels have the mean
and the spread of their group of nodes. Those that are of none, as where the outline of a segment is
off by a pixel, take no part: a mean that is not theirs would bend the lights. s² is that in the
likelihood of a pixel, larger than the residuals' variance where these are no noise
(`pbrfit.fit.misfit`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pbrfit.fit import settings
from pbrfit.fit.joint import JointFit, SharedFit, minimize
from pbrfit.fit.normal_equations import albedo_solved_for
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.posterior import (
    PURE_NODES,
    Distributions,
    Grid,
    Pooling,
    Posterior,
    Stop,
    labels_of,
)
from pbrfit.fit.sampling import evenly_spaced_over
from pbrfit.values.arrays import Array, Floats


@dataclass(frozen=True, eq=False)
class FittedPrior:
    """The prior as fitted to some pixels, to be held for others of the same segments and lights."""

    distributions: Distributions
    """Of the segments."""
    variance: float
    """s², of samples of weight 1, in units of x."""
    strength: float
    """`Priors.material`."""
    counted_once: bool
    """Whether data that the posterior has count once, beside it."""

    def applied(
        self, objective: Objective, x: Array, stop: Stop
    ) -> tuple[Array, GaussianPrior, Posterior] | None:
        """X with all pixels at the mean of their prior, each with its best albedo; what they have.

        None if stopped before all pixels had theirs.
        """
        grid = Grid(objective, x, self.variance)
        posterior = self.distributions.of_all(grid, stop)
        if posterior is None:
            return None
        prior = posterior.prior(settings.PRIOR_SIGMA_MIN, self.strength * self.variance, objective)
        if self.counted_once:
            # What clusters of pixels are made of has been found together with the lights.
            precision = prior.precision / posterior.unused[:, None]
            prior = replace(prior, precision=precision, cluster=None)
        x = x.copy()
        _put(objective, x, prior.mean)
        return x, prior, posterior


def fit_prior(
    objective: Objective,
    x: Array,
    strength: float,
    variance: float,
    stop: Stop = lambda: False,
    *,
    counted_once: bool,
    pooling: Pooling | None = None,
) -> tuple[Array, GaussianPrior, Posterior, FittedPrior] | None:
    """Fit the prior under the lights of x, with the strength of `Priors.material`.

    `variance` is s² in the likelihood of a pixel. Returned are x for all pixels, their prior, and
    what was fitted; None if time ran out before all pixels had theirs. `stop` is asked between
    pieces of the pixels.
    """
    distributions = _fit_distributions(Grid(objective, x, variance), pooling)
    fitted = FittedPrior(distributions, variance, strength, counted_once)
    applied = fitted.applied(objective, x, stop)
    return None if applied is None else (*applied, fitted)


def prior_at(objective: Objective, x: Array, sigma_min: float, variance: float) -> GaussianPrior:
    """The prior of all pixels at x, fitted to an even share of them; normals are free, lights stay.

    Pictures alone do not say then that surfaces are of metal or are not.
    """
    grid = Grid(objective, x, variance, PURE_NODES)
    posterior = _fit_distributions(grid).of_all(grid)
    assert posterior is not None
    return posterior.prior(sigma_min, variance, objective)


def _fit_distributions(grid: Grid, pooling: Pooling | None = None) -> Distributions:
    """To an even share of the grid's pixels."""
    labels = labels_of(grid.objective)
    many = evenly_spaced_over(labels, settings.LIGHTS_PIXELS)
    return Distributions.of(grid.likelihood(many), labels[many], grid, pooling)


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
        if sigma_min == 0 and objective.layout.segments is None:
            break  # one distribution for all of a picture is too rough
        if stop():
            break
        pixels = evenly_spaced_over(labels_of(objective), at_most)
        few, part = objective.restricted(pixels), objective.part_of(x, pixels)
        grid, labels = Grid(few, part, variance), labels_of(few)
        likelihood = grid.likelihood(few.everything)
        distributions = Distributions.of(likelihood, labels, grid)
        posterior = distributions.posterior(likelihood, labels)
        if sigma_min == 0:
            of_any = distributions.share_in_groups(likelihood, labels) > 0.5
            kept = np.flatnonzero(of_any).astype(np.uint64)
            if 2 * len(kept) > len(labels):
                few, part = few.restricted(kept), few.part_of(part, kept)
                posterior, labels = posterior.part(kept), labels[kept]
            posterior = distributions.without_data(posterior, labels)
            posterior = _with_spread(few, part, posterior, variance)
            sigma_min = settings.SPREAD_MIN
        prior = posterior.prior(sigma_min, strength * variance, few)
        sum_sq = _put(few, part, prior.mean)
        fit = JointFit(few, part, sum_sq, shared, prior, stop)
        minimize(fit, steps, settings.GAIN_MIN)
        x[objective.layout.maps.stop :] = part[few.layout.maps.stop :]
    return x


def _with_spread(objective: Objective, x: Array, groups: Posterior, variance: float) -> Posterior:
    """Groups of nodes with the spread of roughness that their pixels have, if that is less.

    Nodes are 0.03 apart, and lights react to a spread that is not there. At the mean of its group a
    pixel, albedo solved for, has the score u = −∂l/∂r and the information h. With a spread W² the
    scores of a group have the variance h + h² W², so

        W² = Σ [(u − h ū)² − h] / Σ h²      ū = Σ u / Σ h

    (the estimate by moments of a meta-analysis; R. DerSimonian and N. Laird, Controlled Clinical
    Trials 7, 1986).
    """
    x = x.copy()
    _put(objective, x, groups.mean)
    own, gradient = albedo_solved_for(objective, x)
    h, u = own[:, 0, 0], gradient[:, 0]  # times the variance
    _, cluster = np.unique(groups.cluster, return_inverse=True)
    score, information = np.bincount(cluster, u), np.bincount(cluster, h)
    # Rounding leaves pixels that one picture shows, with as many samples as albedos, h about 0.
    mean = np.divide(score, information, out=np.zeros_like(score), where=information > 0)
    u -= h * mean[cluster]
    excess = np.bincount(cluster, u**2 - variance * h)
    spread = excess / np.maximum(np.bincount(cluster, h**2), np.finfo(np.float64).tiny)
    found = groups.variance.copy()
    found[:, 0] = np.clip(spread[cluster], 0, found[:, 0])
    return groups._replace(variance=found)


def _put(objective: Objective, x: Array, values: Floats) -> Array:
    """Give pixels of x these roughness and metallic (P, 1 or 2) with their best albedo.

    Returned is the sum of squared residuals of each, (P,).
    """
    for block, of_block in zip(objective.layout.roughness_metallic, values.T, strict=False):
        x[block] = of_block
    return objective.put_best_albedo(x, objective.everything)
