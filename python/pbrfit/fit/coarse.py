"""The coarse level: rounds in which some pixels find the lights of all pictures.

In a round each pixel by itself tries a grid of roughness and metallic under the lights so far, then
joint steps move lights and materials (`joint`). What is left tells the noise of samples (`noise`),
how far it is from independent noise (`misfit`), and by that how much the prior on lights weighs
(`light_prior`). Normals (`normals.prior`) and numbers of the camera (`nuisances`) may be free too.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.fit import misfit, settings
from pbrfit.fit.joint import JointFit, SharedFit, minimize
from pbrfit.fit.levels import Level
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.misfit import Misfit
from pbrfit.fit.noise import NoiseModel, estimated
from pbrfit.fit.normals.prior import FreeNormals
from pbrfit.fit.nuisances import Nuisances
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import fit_level, is_exact, retry_outliers
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.population import METAL_SHARE
from pbrfit.fit.priors.posterior import PURE_NODES
from pbrfit.fit.run import Run
from pbrfit.model.materials import Materials
from pbrfit.values.arrays import Array


@dataclass(frozen=True, eq=False)
class Lights:
    """What a level found."""

    x: Array
    """With its lights, and the materials of its pixels."""
    misfit: Misfit
    exact: bool
    """Whether nothing is left of its pixels but rounding."""
    shared: SharedFit | None
    """None where lights are known."""
    cut_short: bool = False
    """Whether a limit stopped it."""
    noise: NoiseModel | None = None
    """Of samples; None where squares are asked for, or nothing is left."""
    deviance: float = math.inf
    """Of a sample: −2 ln of its likelihood, up to a constant."""


def rounds(
    run: Run,
    level: Level,
    x: Array,
    whole: Array,
    normals: FreeNormals | None = None,
    *,
    at_most: int = settings.COARSE_ROUNDS_MAX,
    dielectric: int = 0,
    nuisances: Nuisances | None = None,
) -> Lights:
    """Rounds of materials and joint steps of a level's pixels, whose x changes; `whole` is of all.

    `normals` is for an objective that has them free. Without, pixels have a prior around a
    dielectric of middle roughness in the first rounds, as many as `dielectric` says. `nuisances`
    are fitted too; the level's objective then sees through what they were found to be.
    """
    objective, watch = level.objective, Watch(run, whole, level)
    shared: SharedFit | None = None
    noise: NoiseModel | None = None
    if objective.lighting is not None:
        shared = SharedFit(LightPrior.around(objective, x))
    left, weight, last, exact, outliers = Misfit(np.inf), np.inf, np.inf, False, False
    given = objective
    if nuisances is not None:
        given = copy(objective)  # whose camera changes
        level = replace(level, objective=given)
    for number in range(at_most + settings.WEIGHT_ROUNDS):
        if number >= settings.EARLY_ROUNDS:
            level = replace(level, objective=_weighed(given, x, noise))
        objective, prior, fixed = level.objective, None, None
        if normals is not None:
            if number == 0:  # what the given ones can explain, first
                fit_level(objective, x, held_normals=True)
            prior = normals.prior(objective, x, number)
            fixed = prior.held(x)
        elif number < dielectric:
            sum_sq = objective.put_best_albedo(x, objective.everything)
            prior = fixed = dielectric_prior(objective, sum_sq)
        elif objective.transfer is not None and objective.metallic is not None:
            prior = fixed = pure_prior(objective, x, left)
        sum_sq = fit_level(objective, x, fixed)
        if number and prior is None:
            retry_outliers(objective, x, sum_sq)
        total = float(sum_sq.sum())
        exact = is_exact(objective, total)
        left, before, fit = left_of(level, x, sum_sq, shared, noise, prior), weight, None
        if shared is not None:
            weight = 0.0 if exact else min(weight, left.design_effect * left.variance)
            shared.lights = shared.lights.weighing(weight, left.variance, objective.pixels)
            fit = JointFit(objective, x, sum_sq, shared, prior, run.out_of_time)
            minimize(fit, settings.COARSE_STEPS, settings.COARSE_GAIN_MIN, watch.visit)
            total, sum_sq = fit.total(x, fit.sum_sq, fit.offsets), fit.sum_sq
        if normals is not None:
            assert fixed is not None
            normals.learn(objective, x, fixed, left.variance)
        deviance = math.log(max(total / objective.total_weight, settings.NOISE_VARIANCE_MIN))
        # Before the camera moves, whose step pixels have to follow first.
        if run.options.robust == "auto" and number >= settings.EARLY_ROUNDS - 1:
            noise = estimated(objective, x, outliers=outliers)
            deviance = noise.deviance(given, x)
        if nuisances is not None:
            nuisances.advance(objective, x, fit, left)
            if given is not objective:
                given.see(nuisances.scene)
        settled = (
            number >= settings.EARLY_ROUNDS
            and weight >= settings.COARSE_WEIGHT_FALL * before
            and deviance > last - settings.COARSE_ROUND_GAIN_MIN
            and (normals is None or normals.is_settled(number))
            and (nuisances is None or nuisances.is_settled)
        )
        last = deviance
        if exact or watch.stopped or run.out_of_time():
            break
        if settled or number + 1 == at_most:
            if outliers or noise is None:
                break
            # Lights follow outliers until these are known, and only now can be told from others.
            outliers, noise = True, estimated(objective, x, outliers=True)
            if not noise.tails.has_outliers:
                break
    if nuisances is not None:  # with the camera as it is now, after joint steps
        sum_sq = fit_level(objective, x, fixed)
        left = left_of(level, x, sum_sq, shared, noise, prior)
        nuisances.judge(left)
    return Lights(x, left, exact, shared, watch.stopped or run.out_of_time(), noise, deviance)


def dielectric_prior(objective: Objective, sum_sq: Array) -> GaussianPrior:
    """Around a dielectric of middle roughness, as strong as what is left of the pixels allows."""
    used = slice(len(objective.layout.roughness_metallic))
    mean = np.tile([settings.START_MIDDLE, 0.0], (objective.pixels, 1))[:, used]
    precision = misfit.variance(objective, sum_sq) / settings.DIELECTRIC_SIGMA**2
    return GaussianPrior(mean, np.full(mean.shape, precision))


def pure_prior(objective: Objective, x: Array, left: Misfit) -> GaussianPrior:
    """Around what segments are made of: metallic 0 or 1, and about one roughness.

    Among surroundings something is always left of a pixel that is of no material, and as large as
    a dielectric's highlight: metallic between 0 and 1, or a roughness of its own, would take it up.
    A segment is of metal where the sum of its pixels' log likelihood ratios says so, beside the
    share of surfaces that metals have. Pixels that share what is left of them are no independent
    witnesses: none adds more than `PURE_EVIDENCE_MAX`. Pixels without a segment are witnesses of
    themselves alone, and of any roughness.
    """
    nodes = np.linspace(*settings.PURE_ROUGHNESS_NODES)
    grid = objective.problem.material_grid(
        objective.for_core(x), objective.everything, nodes, PURE_NODES
    ).astype(np.float64)
    best = grid.min(axis=(1, 2))
    variance = misfit.variance(objective, best)
    shared = left.of_likelihood / left.variance if np.isfinite(left.variance) else 1.0
    grid = (grid - best[:, None, None]) / (2 * variance * shared)
    largest = settings.PURE_EVIDENCE_MAX
    evidence = np.clip(np.subtract(*grid.min(axis=1).T), -largest, largest)
    labels = objective.layout.segments
    if labels is not None:
        evidence = np.where(labels > 0, np.bincount(labels, evidence)[labels], evidence)
    is_metal = evidence + math.log(METAL_SHARE / (1 - METAL_SHARE)) > 0
    mean, precision = np.zeros((2, objective.pixels, 2))
    mean[:, 1], precision[:, 1] = is_metal, variance / settings.PURE_SIGMAS[1] ** 2
    if labels is not None:
        own = np.where(is_metal[:, None], grid[:, :, 1], grid[:, :, 0])
        of_segment = np.zeros((labels.max() + 1, len(nodes)))
        np.add.at(of_segment, labels, np.minimum(own, 4 * largest))
        mean[:, 0] = nodes[of_segment.argmin(axis=1)][labels]
        precision[:, 0] = np.where(labels > 0, variance / settings.PURE_SIGMAS[0] ** 2, 0.0)
    return GaussianPrior(mean, precision)


def left_of(
    level: Level,
    x: Array,
    sum_sq: Array,
    shared: SharedFit | None,
    noise: NoiseModel | None,
    prior: GaussianPrior | None = None,
) -> Misfit:
    """What is left of a level at x, whose pixels have a prior.

    κ is that of the scores s_b of square patches, their mean removed.
    """
    objective, of_files = level.objective, 1.0 if noise is None else noise.picture_effect
    variance = misfit.variance(objective, sum_sq)
    share = misfit.independent_share(objective, x)
    if shared is None:
        return Misfit(variance, 1.0, share, of_files)
    fit = JointFit(objective, x, sum_sq, shared, prior)
    if shared.is_stale(fit.size):
        shared.lights = shared.lights.weighing(variance, variance, objective.pixels)
        fit = JointFit(objective, x, sum_sq, shared, prior)
        fit.renew_preconditioner()
    finer = round(math.sqrt(len(level.pixels) / settings.COARSE_PIXELS))
    patches, effect = level.patches(settings.PATCH_SIDE * max(finer, 1)), 1.0
    if len(patches) >= settings.PATCHES_MIN:
        lights = fit.lights.mean.size
        scores = np.array([fit.kept_system(patch).gradient[:lights] for patch in patches])
        scores -= scores.mean(axis=0)
        sizes = sum(float(score @ shared.solved(objective, score)) for score in scores)
        unbiased = len(patches) / (len(patches) - 1)
        effect = unbiased * sizes / (variance * scores.shape[1])
    return Misfit(variance, effect, share, of_files)


def judged(
    objective: Objective, x: Array, level: Level | None = None, run: Run | None = None
) -> Lights:
    """What x leaves of a level, its pixels' materials put to their best.

    With a run also the noise of its samples.
    """
    level = level or Level.of(objective, settings.COARSE_PIXELS)
    few, part = level.objective, objective.part_of(x, level.pixels)
    sum_sq, noise = fit_level(few, part), None
    if run is not None and run.options.robust == "auto":
        given = few
        for number in range(settings.WEIGHT_ROUNDS):
            noise = estimated(few, part, outliers=number == settings.WEIGHT_ROUNDS - 1)
            few = _weighed(given, part, noise)
            sum_sq = fit_level(few, part)
        level = replace(level, objective=few)
    shared = None if objective.lighting is None else SharedFit(LightPrior.around(few, part))
    left = left_of(level, part, sum_sq, shared, noise)
    if shared is not None:
        weight = left.design_effect * left.variance
        shared.lights = shared.lights.weighing(weight, left.variance, few.pixels)
    return Lights(x, left, is_exact(few, float(sum_sq.sum())), shared, noise=noise)


def _weighed(given: Objective, x: Array, noise: NoiseModel | None) -> Objective:
    """A level's objective with the weights of samples at x by their noise; as given without."""
    weights = None if noise is None else noise.weights(given, x)
    return given if weights is None else given.weighed(weights)


class Watch:
    """Tells how joint steps of a level's pixels go on, and when to stop."""

    def __init__(self, run: Run, x: Array, level: Level) -> None:
        self._run, self._x, self._level = run, x, level
        self._steps_of_few, self._most_of_few = 0, run.left
        self.stopped = False

    def visit(self, part: Array, sum_sq: Array) -> bool:
        """A step of the level's pixels is done; whether to stop.

        Such steps do not count as iterations, for they cost little. But there are no more of them,
        so that few iterations take little time.
        """
        run, level = self._run, self._level
        self._steps_of_few += 1

        def state() -> tuple[Materials, Array]:
            x = self._x.copy()
            level.whole.put_part(x, level.pixels, part)
            return level.whole.unpack(x)

        mean = float(sum_sq.sum()) / level.objective.total_weight
        run.tell(run.objective.residual_rmse(mean), state)
        self.stopped = self._steps_of_few >= self._most_of_few or run.out_of_time()
        return self.stopped
