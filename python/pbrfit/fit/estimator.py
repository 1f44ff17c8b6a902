"""The fit, from a start to its end: the order of its stages.

1. **Lights** (`find_lights`): about a thousand pixels, every s-th row and column, find the lights
   of all pictures. In rounds each pixel by itself tries a grid of roughness and metallic under the
   lights so far, then joint steps move lights and materials (`joint`). What is left of the pixels
   tells how far it is from independent noise (`misfit`), and that how much the prior on lights
   weighs (`light_prior`): much at first, which keeps lights where radiance can be; where there is
   only noise next to nothing in the end.
2. **Material prior** (`priors.mixture`): what roughness and metallic each segment is made of, found
   together with the lights by as many pixels, evenly spread over the segments.
   Where pictures are so few that lights are ambiguous, both come from two starts, and the
   likelier stay.
3. **Scale** (`scale`): lights get the scale that the marginal likelihood says.
4. **All pixels**: each by itself under these lights, from the grid and around its prior; without
   one, joint steps of all pixels and lights follow.

A scene that the model fits and one that it does not go the same way. Where lights are known, steps
that move them are left out. A robust loss is lowered as squares with the weights that it gives to
residuals, which are renewed from round to round (iteratively reweighted least squares).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import lbfgsb, misfit, scale, settings
from pbrfit.fit.joint import SharedFit, minimize
from pbrfit.fit.levels import Level
from pbrfit.fit.light_prior import LightPrior
from pbrfit.fit.misfit import Misfit
from pbrfit.fit.noise import NoiseModel, estimated
from pbrfit.fit.normals.free import FreeNormals
from pbrfit.fit.nuisances import FIELD_OF_VIEW, RESPONSE, VIGNETTING, Nuisance, Nuisances
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import fit_all, put, retry_outliers, taken
from pbrfit.fit.plan import FitPlan
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.mixture import fit_prior, surprise, with_lights
from pbrfit.fit.priors.penalties import Monochrome, penalties
from pbrfit.fit.run import Run
from pbrfit.model.materials import Materials
from pbrfit.result.data import Status
from pbrfit.result.options import ROBUST_LOSSES
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]


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
    mean_squared: float = 0.0
    """Residual of the level's samples, in units of x."""
    samples: int = 0
    unknowns: float = 0.0
    """How many of each it has; unknowns that a prior holds count in part."""
    cut_short: bool = False
    """Whether a limit stopped it."""
    noise: NoiseModel | None = None
    """Of samples; None where squares are asked for, or nothing is left."""
    deviance: float = -math.inf
    """−2 ln of the likelihood of a sample, in the mean."""

    @property
    def is_noise(self) -> bool:
        """Whether what is left can be noise: of samples by themselves, or of their files.

        The blocks of a JPEG file share theirs.
        """
        of_file = self.noise is not None and self.noise.is_of_files
        shared = self.misfit.design_effect <= settings.FILE_DESIGN_EFFECT_MAX
        return self.misfit.is_noise or (of_file and shared)

    @property
    def can_be_judged(self) -> bool:
        """Whether something else may have a better score than what leaves only this noise."""
        samples = self.samples * self.misfit.effective_share
        return not self.is_noise or math.isfinite(misfit.score(0.0, self.unknowns, samples))


def solve(
    run: Run, x: Array, *, start_given: bool, lights: Lights | None = None
) -> tuple[Array, Status, str]:
    """X of a fit from x by the solver of the options, and why it ended.

    `start_given` tells L-BFGS-B to trust the start: it has no stages then. `lights` are those that
    were found from x, if they were.
    """
    loss = run.evaluate(x)[0]  # not the gradient, which is as large as x
    run.record(x, loss)
    if run.left <= 0:
        return x, Status.ITERATION_LIMIT, "0 iterations asked for"
    if run.options.solver == "gauss-newton":
        return gauss_newton(run, x, lights)
    return by_lbfgsb(run, x, loss, start_given=start_given)


def gauss_newton(run: Run, x: Array, lights: Lights | None = None) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended."""
    start, rows, loss = x, len(run.rows), run.rows[-1].loss
    with one_blas_thread():
        if lights is None:
            lights, _ = doubt_camera(run, x, find_lights(run, x))
        x = lights.x
        noise = lights.noise if run.shared_state is None else run.shared_state.noise
        run.noise = noise
        if not lights.exact and run.goes_on:
            weigh_samples(run, run.objective, x, noise)
            loss = run.evaluate(start)[0]
        prior = None
        if run.has_mixture_prior and run.goes_on:
            if lights.exact:
                with run.stage("material prior") as notes:
                    notes.append("left out: the pictures are explained to the last digit")
            else:
                others = []
                if lights.shared is not None and run.goes_on and ambiguous(run.objective):
                    others = [find_lights(run, start, dielectric=True)]
                x, prior = fit_mixture_prior(run, lights, *others)
        if run.goes_on:
            x = fit_all_pixels(run, x, lights, prior)
    if len(run.rows) == rows:  # lights without materials that were fitted under them
        return start, *run.ended("", "; kept the start: there was no time to fit all pixels")
    if not _beyond_squares(run, prior):
        return x, *run.ended("no joint step lowers the sum further")
    why = "the loss falls no further"
    if run.goes_on:
        with run.stage("L-BFGS-B, for penalties") as notes:
            before = run.iteration
            _, x = lbfgsb.by_scipy(run, x, run.left, stall=settings.STALL)
            notes.append(f"{run.iteration - before} iterations")
    if not run.has_mixture_prior and run.rows[-1].loss > loss:
        # Squares know nothing of penalties, and there was no time to lower these.
        return start, *run.ended(why, "; kept the start, whose loss is lower")
    return x, *run.ended(why)


def by_lbfgsb(run: Run, x: Array, loss: float, *, start_given: bool) -> tuple[Array, Status, str]:
    """X of the fit, and why it ended."""
    with run.stage("L-BFGS-B"):
        x, _, kept = lbfgsb.staged(run, x, loss, start_given=start_given)
    if run.has_mixture_prior and not run.out_of_time():
        x, prior = fit_mixture_prior(run, judged(run.objective.reweighted(x), x))
        kept = kept if prior is None else ""
        if run.goes_on:  # scipy takes a step even where none is left
            with run.stage("L-BFGS-B with the material prior"):
                _, x = lbfgsb.by_scipy(run, x, run.left)
    # With zero tolerances scipy stops early only where rounding hides any further descent.
    return x, *run.ended("no step lowers the loss further", kept)


def ambiguous(objective: Objective) -> bool:
    """Whether pictures are so few that other lights with other materials may explain them too."""
    return bool(objective.samples < settings.SAMPLES_OF_UNKNOWN * objective.layout.maps.stop)


def find_lights(run: Run, x: Array, *, dielectric: bool = False) -> Lights:
    """Lights that explain a level of pixels, from those of x; see `rounds`."""
    objective = run.objective
    if run.shared_state is not None:  # a tile, which is told all that pixels share
        return Lights(x, Misfit(0.0), False, None)
    with run.stage("lights") as notes:
        level = Level.of(objective, settings.COARSE_PIXELS)
        known = "lights known; " if objective.lighting is None else ""
        notes.append(f"{known}{len(level.pixels)} pixels")
        unknown = [] if run.camera.how != "assumed" or dielectric else [FIELD_OF_VIEW]
        if known and not unknown:
            return judged(objective, x, level, run)
        x = x.copy()
        part = objective.part_of(x, level.pixels)
        if dielectric:
            notes.append("as if all were dielectric")
        watch = Watch(run, x, level)
        first = settings.DIELECTRIC_ROUNDS if dielectric else 0
        nuisances = Nuisances(run.scene, unknown) if unknown else None
        found = rounds(run, level, part, watch, dielectric=first, nuisances=nuisances)
        objective.put_part(x, level.pixels, part)
        if nuisances is not None:
            run.see(nuisances)
            notes.append(f"field of view {run.camera.in_words()}")
        notes.append(found.misfit.in_words())
    return replace(found, x=x)


def doubt_camera(run: Run, x: Array, lights: Lights) -> tuple[Lights, Lights | None]:
    """Lights, with a correction of the pictures if they ask for it; and with another field of view.

    `lights` are those that were found from x. The numbers whose score test promises most are fitted
    first, and kept where the score is lower and only noise is left; of a field of view it is enough
    if most of the misfit is gone, and not if the given one leaves only noise. Wrong normals and bad
    pictures ask for another camera too, but it does not help them much. A correction is `run`'s
    from then on. A given field of view stays: `run.camera` tells of the other one, and what that
    leaves is returned beside.
    """
    untried = {"fov": (FIELD_OF_VIEW,), "response": RESPONSE, "vignetting": VIGNETTING}
    if run.camera.how != "given":
        del untried["fov"]
    if run.options.solver != "gauss-newton" or run.options.response in ("srgb", "linear"):
        del untried["response"]
    told = run.camera.figures or lights.shared is None or run.camera.how == "assumed"
    if told or lights.exact or lights.cut_short or not lights.can_be_judged:
        return lights, None
    level = Level.of(run.objective, settings.COARSE_PIXELS)
    if len(level.patches()) < settings.CAMERA_PATCHES_MIN:
        return lights, None
    least = dict.fromkeys(untried, settings.CAMERA_GAIN_MIN)
    least["response"] = 0.0 if run.options.response == "fit" else settings.CAMERA_GAIN_MIN
    figures: dict[str, float] = {}
    with run.stage("camera") as notes:
        other = None
        tests = _score_tests(run, lights, untried)
        figures |= {f"score_test_{name}": gain for name, gain in tests.items()}
        while untried:
            name = max(untried, key=lambda name: tests[name] / max(least[name], 1e-300))
            numbers = untried.pop(name)
            if tests[name] < least[name] or run.out_of_time():
                break
            notes.append(f"score test of {name} {tests[name]:.3g}")
            if name == "fov":  # from the start, because materials have bent to the given one
                found, nuisances = _with_camera(run, x, numbers, None)
            else:
                found, nuisances = _with_camera(run, lights.x, numbers, lights.noise)
            kept = _keeps(lights, found, name, nuisances.surprise(), figures)
            if name == "fov":
                figures["other_fov_degrees"] = nuisances.scene.fov
                figures["other_fov_sigma"] = nuisances.fov_sigma
            notes.append(f"{found.misfit.in_words()}{'' if kept else ', not kept'}")
            if kept and name == "fov":
                other = found
                few, end = level.objective, level.objective.layout.maps.stop
                before = run.objective.part_of(lights.x, level.pixels)
                run.scale_by_other = scale.change(found.x[end:], before[end:], few)
                break
            if kept:
                run.see(nuisances)
                lights = replace(found, x=x.copy())
                run.objective.put_part(lights.x, nuisances.pixels, found.x)
                tests = _score_tests(run, lights, untried)
        run.camera = replace(run.camera, figures=figures, contradicted=other is not None)
        if not notes:
            notes.append("as given, by the score tests")
    return lights, other


def _score_tests(
    run: Run, lights: Lights, groups: Mapping[str, Sequence[Nuisance]]
) -> dict[str, float]:
    """What each group of numbers promises under some lights, χ²."""
    assert lights.shared is not None
    level = Level.of(run.objective, settings.COARSE_PIXELS)
    few, part = level.objective, run.objective.part_of(lights.x, level.pixels)
    if lights.noise is not None:
        few = few.weighed(lights.noise.weights(few, part))
    # A copy: where nothing is changed, what follows has to be the same to the last bit.
    fit = copy(lights.shared).joint_fit(few, part, _fit_level(few, part))
    nuisances = Nuisances(run.scene, [one for group in groups.values() for one in group])
    if groups:
        nuisances.estimate(few, part, fit, lights.misfit)
    return {name: nuisances.test(group) for name, group in groups.items()}


def _with_camera(
    run: Run, x: Array, numbers: Sequence[Nuisance], noise: NoiseModel | None
) -> tuple[Lights, Nuisances]:
    """What the level leaves with other numbers of the camera, from x; its x is of the level."""
    level = Level.of(run.objective, settings.COARSE_PIXELS)
    part = run.objective.part_of(x, level.pixels)
    fitted = [] if run.camera.how == "given" else [FIELD_OF_VIEW]
    if run.scene.correction is not None:  # another was fitted before
        fitted += [*RESPONSE, *VIGNETTING]
    fitted += [one for one in numbers if one not in fitted]
    nuisances = Nuisances(run.scene, fitted)
    nuisances.pixels = level.pixels
    watch = Watch(run, x, level)
    found = rounds(run, level, part, watch, nuisances=nuisances, noise=noise)
    return replace(found, x=part, unknowns=found.unknowns + len(numbers)), nuisances


def _keeps(
    before: Lights, found: Lights, name: str, surprise: float, figures: dict[str, float]
) -> bool:
    """Whether other numbers, as unlikely as they are by their prior, are better ones."""
    samples = found.samples * found.misfit.effective_share
    scores = [misfit.score(one.deviance, one.unknowns, samples) for one in (before, found)]
    scores[1] += surprise
    figures["score_given"], figures[f"score_other_{name}"] = scores
    share = math.exp(found.deviance - before.deviance)
    share *= max(found.misfit.design_effect, 1.0) / max(before.misfit.design_effect, 1.0)
    told = found.is_noise
    if name == "fov":  # a given one that leaves noise alone is contradicted by none
        told = (told and not before.is_noise) or share <= settings.CAMERA_MISFIT_SHARE_MAX
    return scores[1] < scores[0] and told


def rounds(
    run: Run,
    level: Level,
    x: Array,
    watch: Watch,
    normals: FreeNormals | None = None,
    *,
    at_most: int = settings.COARSE_ROUNDS_MAX,
    dielectric: int = 0,
    nuisances: Nuisances | None = None,
    noise: NoiseModel | None = None,
) -> Lights:
    """Rounds of materials and joint steps of a level's pixels, whose x changes.

    `normals` is for an objective that has them free. Without, pixels have a prior around a
    dielectric of middle roughness in the first rounds, as many as `dielectric` says. `nuisances`
    are fitted too; the level's objective then sees through what they were found to be. `noise` of
    samples weighs them from the start, where x has been found with it.
    """
    objective = level.objective
    everything = np.arange(objective.pixels, dtype=np.uint64)
    shared = None
    if objective.lighting is not None:
        shared = SharedFit(LightPrior.around(objective, x))
    left, weight, last, exact = Misfit(np.inf), np.inf, np.inf, False
    given = objective
    if nuisances is not None:
        given = copy(objective)  # whose camera changes
        level = replace(level, objective=given)
    for number in range(at_most):
        if number >= settings.ROBUST_ROUND or noise is not None:
            first = number == settings.ROBUST_ROUND
            weighed = _weighed(run, given, level.objective, x, noise, first=first)
            level = replace(level, objective=weighed)
            if shared is not None:
                shared.stale = True
        objective, prior, fixed = level.objective, None, None
        if normals is not None:
            if number == 0:  # what the given ones can explain, first
                _fit_level(objective, x, held_normals=True)
            prior = normals.prior(objective, x, number)
            fixed = GaussianPrior(prior.prior_mean(x), prior.precision)
        elif number < dielectric:
            prior = fixed = _dielectric(objective, objective.put_best_albedo(x, everything))
        sum_sq = _fit_level(objective, x, fixed)
        if number and prior is None:
            retry_outliers(objective, x, sum_sq)
        exact = float(sum_sq.sum()) <= settings.EXACT_RMSE**2 * objective.total_weight
        left, before, fit = _left(level, x, sum_sq, shared, noise, fixed), weight, None
        total = float(sum_sq.sum())
        if shared is not None:
            weight = 0.0 if exact else min(weight, left.design_effect * left.variance)
            shared.lights = shared.lights.weighing(weight, left.variance, objective.pixels)
            fit = shared.joint_fit(objective, x, sum_sq, prior=prior, stop=run.out_of_time)
            minimize(fit, settings.COARSE_STEPS, settings.COARSE_GAIN_MIN, watch.visit_few)
            total, sum_sq = fit.total(x, fit.sum_sq, fit.offsets), fit.sum_sq
        if normals is not None:
            assert fixed is not None
            normals.learn(objective, x, fixed, left.variance)
        deviance = math.log(max(total / objective.total_weight, settings.NOISE_VARIANCE_MIN))
        # Before the camera moves, whose step pixels have to follow first.
        told = number >= settings.ROBUST_ROUND - 1 or noise is not None
        if run.options.robust == "auto" and told:
            noise = estimated(objective, x)
            deviance = noise.deviance(given, x)
        if nuisances is not None:
            nuisances.advance(objective, x, fit, left)
            if given is not objective:
                given.see(nuisances.scene)
        settled = (
            number >= settings.ROBUST_ROUND
            and weight >= settings.COARSE_WEIGHT_FALL * before
            and deviance > last - settings.COARSE_ROUND_GAIN_MIN
            and (normals is None or normals.is_settled(number))
            and (nuisances is None or nuisances.is_settled)
        )
        last = deviance
        if settled or exact or watch.stopped or run.out_of_time():
            break
    if nuisances is not None:  # with the camera as it is now, after joint steps
        sum_sq = _fit_level(objective, x, fixed)
        if noise is not None:
            noise = estimated(objective, x)
            deviance = noise.deviance(given, x)
        left = _left(level, x, sum_sq, shared, noise, fixed)
        nuisances.judge(left)
        deviance += nuisances.log_slope(objective, x)
    mean_squared = float(sum_sq.sum()) / objective.total_weight
    unknowns = objective.size if normals is None else normals.unknowns(objective)
    cut_short = watch.stopped or run.out_of_time()
    return Lights(
        *(x, left, exact, shared, mean_squared, given.samples, unknowns, cut_short),
        noise=noise,
        deviance=deviance,
    )


def _fit_level(
    objective: Objective,
    x: Array,
    prior: GaussianPrior | None = None,
    *,
    held_normals: bool = False,
) -> Array:
    """Give a level's pixels their best materials, from nodes too; their sums of squares (P,)."""
    starts = settings.SUBSET_STARTS
    sum_sq = fit_all(objective, x, starts=starts, prior=prior, held_normals=held_normals)
    assert sum_sq is not None  # nothing stops it
    return sum_sq


def _dielectric(objective: Objective, sum_sq: Array) -> GaussianPrior:
    """Around a dielectric of middle roughness, as strong as what is left of the pixels allows."""
    used = slice(len(objective.layout.roughness_metallic))
    mean = np.tile([settings.START_ROUGHNESS, 0.0], (objective.pixels, 1))[:, used]
    precision = misfit.variance(objective, sum_sq) / settings.DIELECTRIC_SIGMA**2
    return GaussianPrior(mean, np.full(mean.shape, precision))


def _left(
    level: Level,
    x: Array,
    sum_sq: Array,
    shared: SharedFit | None,
    noise: NoiseModel | None,
    prior: GaussianPrior | None = None,
) -> Misfit:
    """What is left of a level at x, whose pixels have a prior."""
    objective, of_files = level.objective, 1.0 if noise is None else noise.picture_effect
    variance = misfit.variance(objective, sum_sq)
    share = misfit.independent_share(objective, x)
    if shared is None:
        return Misfit(variance, 1.0, share, of_files)
    if shared.inverse is None or shared.stale:
        shared.lights = shared.lights.weighing(variance, variance, objective.pixels)
        shared.joint_fit(objective, x, sum_sq, prior=prior).renew_preconditioner()
    effect = misfit.design_effect(level, x, sum_sq, partial(shared.solved, objective), prior)
    return Misfit(variance, effect, share, of_files)


def judged(
    objective: Objective, x: Array, level: Level | None = None, run: Run | None = None
) -> Lights:
    """What x leaves of a level, its pixels' materials put to their best.

    With a run also the noise of its samples.
    """
    level = level or Level.of(objective, settings.COARSE_PIXELS)
    few, part = level.objective, objective.part_of(x, level.pixels)
    sum_sq, noise = _fit_level(few, part), None
    deviance = math.log(max(float(sum_sq.sum()) / few.total_weight, settings.NOISE_VARIANCE_MIN))
    if run is not None and run.options.robust == "auto":
        given = few
        for _ in range(settings.WEIGHT_ROUNDS):
            noise = estimated(few, part)
            few = _weighed(run, given, few, part, noise)
            sum_sq = _fit_level(few, part)
        assert noise is not None
        deviance = noise.deviance(given, part)
        level = replace(level, objective=few)
    mean_squared = float(sum_sq.sum()) / few.total_weight
    shared = None if objective.lighting is None else SharedFit(LightPrior.around(few, part))
    left = _left(level, part, sum_sq, shared, noise)
    if shared is not None:
        weight = left.design_effect * left.variance
        shared.lights = shared.lights.weighing(weight, left.variance, few.pixels)
    exact = mean_squared <= settings.EXACT_RMSE**2
    return Lights(
        *(x, left, exact, shared, mean_squared, few.samples, few.size),
        noise=noise,
        deviance=deviance,
    )


def fit_mixture_prior(
    run: Run, lights: Lights, *others: Lights
) -> tuple[Array, GaussianPrior | None]:
    """X with the material prior fitted around it, which is a penalty from here on; one iteration.

    Of several lights those that are likeliest with their prior stay. Where time runs out before, x
    is as it was and there is no prior. Weights that are chosen by rule are chosen by the lights
    that were found with it.
    """
    objective, x, held = run.objective, lights.x, []
    if lights.shared is not None:
        with run.stage("material prior") as notes:
            lights = _with_prior(run, (lights, *others), notes)
        # One distribution for all of a picture is too rough for so soft a direction.
        if not lights.exact and objective.layout.segments is not None:
            with run.stage("scale") as notes:
                lights = _with_scale(run, lights, notes)
    with run.stage("material prior") as notes:
        found = _fitted_prior(run, lights)
        if found is None:
            notes.append("stopped before all pixels had theirs")
            return x, None
        x, prior = found
        if run.shared_state is not None:
            held = run.shared_state.penalties(objective.layout)
        run.measured_lighting = objective.unpack(x)[1]
        plan = FitPlan.of(
            run.scene, objective.layout, priors=run.options.priors, lighting=run.measured_lighting
        )
        objective.penalties = [*penalties(objective.layout, plan.priors), *held, prior]
        objective.robust = run.robust_around(x)
        loss = run.evaluate(x)[0]
        run.iteration += 1
        run.record(x, loss)
    return x, prior


def _with_prior(run: Run, candidates: tuple[Lights, ...], notes: list[str]) -> Lights:
    """The likeliest of some lights, each as it is with the material prior."""
    strength = run.options.priors.material
    objective = _robust(run, run.objective, candidates[0].x)
    variance = min(each.misfit.of_likelihood for each in candidates)
    scores: list[tuple[float, Lights]] = []
    for each in candidates:
        assert each.shared is not None
        of_pixel = each.misfit.of_likelihood
        x = with_lights(objective, each.x, strength, of_pixel, each.shared, run.out_of_time)
        if scores and run.out_of_time():
            break
        score = 0.0
        if len(candidates) > 1 and not run.out_of_time():
            lights = each.shared.lights.weighing(variance, variance, objective.pixels)
            score = surprise(objective, x, variance, lights)
        scores.append((score, replace(each, x=x)))
    if len(scores) > 1:
        notes.append(
            "-2 ln of the likelihood of lights: "
            + ", ".join(f"{score - scores[0][0]:+.0f}" for score, _ in scores[1:])
            + " from the second start"
        )
    surest = min((each.misfit for each in candidates), key=lambda one: one.of_likelihood)
    return replace(min(scores, key=itemgetter(0))[1], misfit=surest)


def _with_scale(run: Run, lights: Lights, notes: list[str]) -> Lights:
    """Lights with the scale that the marginal likelihood says."""
    assert lights.shared is not None
    strength, variance = run.options.priors.material, lights.misfit.of_likelihood
    objective = _robust(run, run.objective, lights.x)
    found = None
    if not run.out_of_time():
        found = scale.find(objective, lights.x, strength, variance, lights.shared, run.out_of_time)
    if found is None:
        notes.append("stopped before it was found")
        return lights
    x, run.scale = found
    notes.append(run.scale.note)
    return replace(lights, x=x)


def _fitted_prior(run: Run, lights: Lights) -> tuple[Array, GaussianPrior] | None:
    """X and the prior: that of the shared state, if there is one, else of the run's own pixels."""
    strength, x = run.options.priors.material, lights.x
    objective = _robust(run, run.objective, x)
    if run.shared_state is not None:
        assert run.shared_state.material is not None
        return run.shared_state.material.applied(objective, x, run.out_of_time)
    variance = lights.misfit.of_likelihood
    steps = run.options.solver == "gauss-newton"
    # Penalties that follow have to weigh against the data as they are.
    once = steps and not _beyond_squares(run, None)
    fitted = fit_prior(objective, x, strength, variance, run.out_of_time, counted_once=once)
    if fitted is None:
        return None
    x, prior, run.fitted_prior = fitted
    if steps:
        # What clusters of pixels are made of has been found together with the lights.
        prior = replace(prior, cluster=None)
    return x, prior


def _make_grey(shared: SharedFit, objective: Objective) -> None:
    """Give the lights the monochrome prior of the objective."""
    weight = sum(one.weight for one in objective.penalties if isinstance(one, Monochrome))
    of_sum = weight * objective.total_weight / objective.pixels
    shared.lights = replace(shared.lights, grey=of_sum / shared.lights.mean.size)


def fit_all_pixels(run: Run, x: Array, lights: Lights, prior: GaussianPrior | None) -> Array:
    """X with all pixels, and without a material prior the lights, fitted.

    With one, lights have been found by many pixels whose materials the prior summed up. Now that
    each pixel has its own, lights would follow the bias that these have in common (J. Neyman and
    E. Scott, Econometrica 16, 1948). They move only where the monochrome prior, which is known from
    here on, weighs. The prior on lights weighs less where less is left of all pixels than was of
    the coarse level.
    Where time runs out before all pixels have had their turn, x is as it was before.
    """
    watch, shared = Watch(run, x), lights.shared
    variance = lights.misfit.variance
    if shared is not None:
        _make_grey(shared, run.objective)
        if prior is not None and not shared.lights.grey:
            shared = None
    with run.stage("all pixels") as notes:
        for number in range(settings.GLOBAL_ROUNDS_MAX):
            objective = _robust(run, run.objective, x)
            before, starts = x.copy(), 1 if number == 0 else 0
            sum_sq = fit_all(objective, x, starts=starts, prior=prior, stop=run.out_of_time)
            if sum_sq is None:
                notes.append("stopped before all pixels had their turn")
                return before
            del before  # of the size of x, which counts
            if prior is None:
                retry_outliers(objective, x, sum_sq, run.out_of_time)
            total = float(sum_sq.sum())
            if watch.visit(x, sum_sq):
                break
            if shared is not None:
                last, variance = variance, min(variance, misfit.variance(objective, sum_sq))
                shared.lights = shared.lights.times(variance / last if last else 1.0)
                fit = shared.joint_fit(objective, x, sum_sq, prior=prior, stop=run.out_of_time)
                minimize(fit, settings.GLOBAL_STEPS_MAX, settings.GAIN_MIN, watch.visit)
            more = prior is None and shared is not None
            if run.options.robust in ROBUST_LOSSES and number < settings.ROBUST_ROUND:
                more = True  # whose weights settle
            elif total - float(sum_sq.sum()) <= settings.GAIN_MIN * misfit.variance(
                objective, sum_sq
            ):
                more = False
            if not more or not run.goes_on:
                break
    return x


def _weighed(
    run: Run,
    given: Objective,
    now: Objective,
    x: Array,
    noise: NoiseModel | None,
    *,
    first: bool = False,
) -> Objective:
    """A level's objective with the weights of samples at x, by their noise or a robust loss.

    `given` is the objective without, and `now` the one that x was fitted to, for the `first` time
    with weights or not.
    """
    if noise is None:
        return _robust(run, now, x)
    weights = noise.weights(given, x, first=first)
    return given if weights is None else given.weighed(weights)


def weigh_samples(run: Run, objective: Objective, x: Array, noise: NoiseModel | None) -> None:
    """Weigh the samples of all pixels by their noise; the objective changes, and x.

    Outliers show once pixels are fitted, and the fit is another then: so both are done in turn.
    """
    if noise is None or (noise.is_even and not objective.has_limits):
        return
    with run.stage("noise of samples") as notes:
        weighed = objective.weighed(noise.weights(objective, None))
        for number in range(settings.WEIGHT_ROUNDS):
            if fit_all(weighed, x, starts=1 if number == 0 else 0, stop=run.out_of_time) is None:
                notes.append("stopped before all pixels had their turn")
                break
            weighed = objective.weighed(noise.weights(objective, x, first=number == 0))
        objective.adopt(weighed)
        notes.append(noise.in_words())


def _robust(run: Run, objective: Objective, x: Array) -> Objective:
    """Squares with the weights of the robust loss at x; without one the objective as it is."""
    if run.options.robust in ("auto", "none"):
        return objective
    objective.robust = (
        run.robust_around(x)
        if objective is run.objective
        else objective.robust_around(x, run.options.robust)
    )
    return objective.reweighted(x)


def _beyond_squares(run: Run, prior: GaussianPrior | None) -> bool:
    """Whether the objective has penalties that joint steps do not know."""
    others = [one for one in run.objective.penalties if one is not prior]
    return not all(isinstance(one, Monochrome) for one in others)


class Watch:
    """Turns joint steps into iterations and rows of the history."""

    def __init__(self, run: Run, x: Array, level: Level | None = None) -> None:
        self._run, self._x, self._level = run, x, level
        self._steps_of_few, self._most_of_few = 0, run.left
        self.stopped = False

    def visit_few(self, part: Array, sum_sq: Array) -> bool:
        """A step of the level's pixels is done; whether to stop.

        Such steps do not count as iterations, for they cost little. But there are no more of them,
        so that few iterations take little time.
        """
        run, level = self._run, self._level
        assert level is not None
        self._steps_of_few += 1

        def state() -> tuple[Materials, Array]:
            x = put(run.objective, self._x, level.pixels, taken(level.objective, part, slice(None)))
            x[run.objective.layout.maps.stop :] = part[level.objective.layout.maps.stop :]
            return run.objective.unpack(x)

        mean = float(sum_sq.sum()) / level.objective.total_weight
        run.tell(run.objective.residual_rmse(mean), state)
        self.stopped = self._steps_of_few >= self._most_of_few or run.out_of_time()
        return self.stopped

    def visit(self, x: Array, sum_sq: Array) -> bool:
        """All pixels have new materials; whether to stop."""
        run = self._run
        # Pixels that are freed after the last iteration belong to that.
        run.iteration += run.left > 0
        # Squares are those of float64, which a float32 evaluation of a good fit does not reach.
        loss = data = float(sum_sq.sum()) / run.objective.total_weight
        if run.objective.penalties:
            loss += run.objective.add_penalties(x, np.zeros(run.objective.size))
        run.record(x, loss, data)
        return run.left <= 0 or run.out_of_time()
