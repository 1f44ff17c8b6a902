"""The fit, from a start to its end: the order of its stages.

1. **Lights** (`find_lights`): about a thousand pixels, every s-th row and column, find the lights
   of all pictures. In rounds each pixel by itself tries a grid of roughness and metallic under the
   lights so far, then joint steps move lights and materials (`joint`). What is left of the pixels
   tells how far it is from independent noise (`misfit`), and that how much the prior on lights
   weighs (`light_prior`): much at first, which keeps lights where radiance can be; where there is
   only noise next to nothing in the end.
2. **Material prior** (`priors.mixture`): what roughness and metallic each segment is made of, found
   together with the lights by as many pixels, evenly spread over the segments.
3. **All pixels**: without a material prior, joint steps of a second level first, of 16 times as
   many pixels; then each by itself under these lights, from the grid and around its prior.

A scene that the model fits and one that it does not go the same way. Where lights are known, steps
that move them are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbrfit.fit import lbfgsb, misfit, settings
from pbrfit.fit.coarse import Lights, Watch, judged, left_of, rounds
from pbrfit.fit.joint import JointFit, minimize
from pbrfit.fit.levels import Level
from pbrfit.fit.misfit import Misfit
from pbrfit.fit.nuisances import Nuisances
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import NODE_SPACING, fit_all, is_exact, retry_outliers
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.priors.mixture import fit_prior, with_lights
from pbrfit.fit.priors.penalties import Monochrome, chosen_priors, penalties
from pbrfit.fit.run import Run, State
from pbrfit.result.data import Status
from pbrfit.values.arrays import Array, Mask


def solve(run: Run, x: Array, *, start_given: bool) -> State:
    """What a fit from x by the solver of the options has found.

    `start_given` tells L-BFGS-B to trust the start: it has no stages then.
    """
    loss = run.evaluate(x)[0]  # not the gradient, which is as large as x
    run.record(x, loss)
    if run.left <= 0:
        return State(run, x, ended=(Status.ITERATION_LIMIT, "0 iterations asked for"))
    if run.options.solver == "gauss-newton":
        return gauss_newton(run, x)
    return by_lbfgsb(run, x, loss, start_given=start_given)


def gauss_newton(run: Run, x: Array) -> State:
    """What the fit has found."""
    rows = len(run.rows)
    state = fit_materials(run, lights_and_noise(run, x))
    if len(run.rows) > rows:
        return replace(state, ended=run.ended("converged"))
    # Lights without materials that were fitted under them.
    ended = run.ended("", "; all pixels were fitted once, under the lights so far")
    return replace(state, x=fit_once(run, x, state.x), ended=ended)


def lights_and_noise(run: Run, x: Array) -> Lights:
    """Lights from those of x, and the weights of samples, which the run's objective has then."""
    lights = find_lights(run, x)
    if not lights.exact and run.goes_on:
        weigh_samples(run, lights)
    return lights


def fit_materials(run: Run, lights: Lights) -> State:
    """All pixels, from these lights on, with the material prior if there is to be one."""
    state, prior = State(run, lights.x, lights.noise), None
    if run.has_mixture_prior and run.goes_on:
        if lights.exact:
            with run.stage("material prior") as notes:
                notes.append("left out: the pictures are explained to the last digit")
        else:
            state, prior = fit_mixture_prior(run, lights)
    return fit_all_pixels(state, lights, prior) if run.goes_on else state


def fit_once(run: Run, start: Array, x: Array) -> Array:
    """X of a fit that a limit stopped before all pixels had their turn under the lights of x.

    They have it now, as long as it takes: lights alone are no result. The start stays where its
    loss is lower.
    """
    loss = run.evaluate(start)[0]
    x = x.copy() if x is start else x
    with run.stage("all pixels, once"):
        fit_all(run.objective, x, starts=1)
        run.iteration += run.left > 0
        run.record(x, run.evaluate(x)[0])
    return x if run.rows[-1].loss <= loss else start


def by_lbfgsb(run: Run, x: Array, loss: float, *, start_given: bool) -> State:
    """What the fit has found."""
    with run.stage("L-BFGS-B"):
        x, kept = lbfgsb.staged(run, x, loss, start_given=start_given)
    state = State(run, x)
    if run.has_mixture_prior and not run.out_of_time():
        state, prior = fit_mixture_prior(run, judged(run.objective, x))
        kept = kept if prior is None else ""
        if run.goes_on:  # scipy takes a step even where none is left
            with run.stage("L-BFGS-B with the material prior"):
                state = replace(state, x=lbfgsb.by_scipy(run, state.x, run.left)[1])
    # With zero tolerances scipy stops early only where rounding hides any further descent.
    return replace(state, ended=run.ended("converged", kept))


def find_lights(run: Run, x: Array) -> Lights:
    """Lights that explain a level of pixels, from those of x; see `rounds`."""
    objective = run.objective
    if run.shared is not None:  # a tile, which is told all that pixels share
        return Lights(x, Misfit(0.0), False, None, noise=run.shared.noise)
    with run.stage("lights") as notes:
        level = Level.of(objective, settings.COARSE_PIXELS)
        known = "lights known; " if objective.lighting is None else ""
        notes.append(f"{known}{len(level.pixels)} pixels")
        is_open = objective.transfer is None
        fov = is_open and run.camera.how == "assumed"
        response = is_open and run.options.response == "fit" and run.scene.correction is None
        if known and not (fov or response):
            return judged(objective, x, level, run)
        x = x.copy()
        best = None
        for dielectric in _starts(objective):
            nuisances = Nuisances(run.scene, fov, response) if fov or response else None
            part = objective.part_of(x, level.pixels)
            found = rounds(run, level, part, x, dielectric=dielectric, nuisances=nuisances)
            if best is None or found.deviance < best[0].deviance:
                best = found, nuisances
            if found.exact or found.cut_short:
                break
        assert best is not None
        found, nuisances = best
        objective.put_part(x, level.pixels, found.x)
        if nuisances is not None:
            run.see(nuisances)
            notes.append(f"field of view {run.camera.in_words()}")
        notes.append(found.misfit.in_words())
    return replace(found, x=x)


def _starts(objective: Objective) -> list[int]:
    """First rounds of each start in which all surfaces are taken for dielectrics.

    Where pictures are few, other lights with other materials explain them nearly as well.
    """
    layout, second = objective.layout, settings.EARLY_ROUNDS
    if objective.transfer is not None:
        return [second]
    samples = layout.channels * layout.pictures * layout.pixels
    few = samples < settings.SAMPLES_OF_UNKNOWN * layout.maps.stop
    return [0, second] if few and objective.lighting is not None else [0]


def fit_mixture_prior(run: Run, lights: Lights) -> tuple[State, GaussianPrior | None]:
    """What is found with the material prior, a penalty from here on, and this; one iteration.

    Where time runs out before, x is as it was and there is no prior. Weights that are chosen by
    rule are chosen by the lights that were found with it. A tile has the prior of the subset.
    """
    objective, x, strength = run.objective, lights.x, run.options.priors.material_strength
    state, prior, stop = State(run, x, lights.noise), None, run.out_of_time
    with run.stage("material prior") as notes:
        if lights.shared is not None and not lights.exact:
            variance = lights.misfit.of_likelihood
            x = with_lights(objective, x, strength, variance, lights.shared, stop)
        if stop():
            pass
        elif run.shared is not None:
            assert run.shared.material is not None
            if (applied := run.shared.material.applied(objective, x, stop)) is not None:
                x, prior, posterior = applied
                state = replace(state, posterior=posterior)
        else:
            found = replace(state, x=x).judged()
            notes.append(found.in_words())
            state, once = replace(state, discrepancy=found), run.options.solver == "gauss-newton"
            given = x, strength, found.of_pixel, stop
            fitted = fit_prior(objective, *given, counted_once=once, pooling=found.pooling)
            if fitted is not None:
                x, prior, posterior, material = fitted
                state = replace(state, posterior=posterior, material=material)
        if prior is None:
            notes.append("stopped before all pixels had theirs")
            return state, None
        lighting = objective.unpack(x)[1]
        priors = chosen_priors(objective.layout, run.options.priors, lighting)
        objective.penalties = [*penalties(objective.layout, priors), prior]
        loss = run.evaluate(x)[0]
        run.iteration += 1
        run.record(x, loss)
    return replace(state, x=x, measured_lighting=lighting), prior


def fit_all_pixels(state: State, lights: Lights, prior: GaussianPrior | None) -> State:
    """With all pixels, and without a material prior the lights, fitted.

    With one, lights have been found by many pixels whose materials the prior summed up. Now that
    each pixel has its own, lights would follow the bias that these have in common (J. Neyman and
    E. Scott, Econometrica 16, 1948). They move only where the monochrome prior, which is known from
    here on, weighs.
    Where time runs out before all pixels have had their turn, x is as it was before.
    """
    run, x, posterior = state.run, state.x.copy(), state.posterior
    objective, shared = run.objective, lights.shared
    if shared is not None:
        weight = sum(one.weight for one in objective.penalties if isinstance(one, Monochrome))
        of_sum = weight * objective.total_weight / objective.pixels
        shared.lights = replace(shared.lights, grey=of_sum / shared.lights.mean.size)
    with run.stage("all pixels") as notes:
        if shared is not None and (prior is None or shared.lights.grey):
            of_all = move_lights(run, x, lights, prior)
            if of_all and not run.goes_on:
                return replace(state, x=x)
        wide: bool | Mask = True
        if prior is not None and posterior is not None:
            wide = np.any(posterior.variance > NODE_SPACING**2, axis=1)
        sum_sq = fit_all(objective, x, starts=wide, prior=prior, stop=run.out_of_time)
        if sum_sq is None:
            notes.append("stopped before all pixels had their turn")
            return state
        # Half of the pixels leave nothing but rounding.
        if is_exact(objective, float(np.median(sum_sq)) * objective.pixels):
            retry_outliers(objective, x, sum_sq, run.out_of_time)
        run.visit(x, sum_sq)
    return replace(state, x=x)


def move_lights(run: Run, x: Array, lights: Lights, prior: GaussianPrior | None) -> bool:
    """Rounds of joint steps of a level's pixels and of trying them again; its part of x changes.

    Returns whether these are all pixels.
    The prior on lights weighs less where less is left of the level than was of the coarse one. A
    step has to promise more where the design effect is large: where residuals are alike, the many
    squares that it lowers are few.
    """
    objective, shared = run.objective, lights.shared
    gain, variance = settings.GAIN_MIN, lights.misfit.variance
    assert shared is not None
    level = Level.of(objective, settings.LIGHTS_PIXELS)
    few, part = level.objective, objective.part_of(x, level.pixels)
    whole = len(level.pixels) == objective.pixels
    rows = None if prior is None else prior.rows(level.pixels)
    watch = Watch(run, x, level)

    def visit(part: Array, sum_sq: Array) -> bool:
        objective.put_part(x, level.pixels, part)
        return run.visit(x, sum_sq) if whole else watch.visit(part, sum_sq)

    for number in range(settings.GLOBAL_ROUNDS_MAX):
        starts = 1 if number == 0 else 0
        sum_sq = fit_all(few, part, starts=starts, prior=rows, stop=run.out_of_time)
        if sum_sq is None:
            break
        if is_exact(few, float(np.median(sum_sq)) * few.pixels):
            retry_outliers(few, part, sum_sq, run.out_of_time)
        elif number == 0 and prior is None:
            found = left_of(level, part, sum_sq, shared, lights.noise)
            gain *= max(found.design_effect, 1.0)
        total = float(sum_sq.sum())
        if visit(part, sum_sq):
            break
        last, variance = variance, min(variance, misfit.variance(few, sum_sq))
        shared.lights = shared.lights.times(variance / last if last else 1.0)
        fit = JointFit(few, part, sum_sq, shared, rows, run.out_of_time)
        minimize(fit, settings.GLOBAL_STEPS_MAX, gain, visit)
        more = prior is None and total - float(sum_sq.sum()) > gain * misfit.variance(few, sum_sq)
        if not more or not run.goes_on:
            break
    return whole


def weigh_samples(run: Run, lights: Lights) -> None:
    """Weigh the samples of all pixels by their noise; the objective changes, and x.

    Outliers show once pixels are fitted, and the fit is another then: so both are done in turn.
    """
    objective, x, noise = run.objective, lights.x, lights.noise
    if noise is None or (noise.is_even and not objective.has_limits):
        return
    with run.stage("noise") as notes:
        weighed = objective.weighed(noise.weights(objective, None))
        for number in range(settings.WEIGHT_ROUNDS):
            if fit_all(weighed, x, starts=1 if number == 0 else 0, stop=run.out_of_time) is None:
                notes.append("stopped before all pixels had their turn")
                break
            weighed = objective.weighed(noise.weights(objective, x, first=number == 0))
        objective.adopt(weighed)
        notes.append(noise.in_words())
