"""A fit whose normals may be refined: when, in which order, and what is kept of it.

With `auto` the first fit holds the given normals. Where they are right, neighbouring pixels have
nothing in common in what it leaves of them, and that is the end of it. Else normals are refined,
and the refined fit has to earn its place: it must leave noise, or far less than the first one did.
Shadows, interreflections and a wrong field of view leave residuals that normals can bend to as
well, but never explain.

At the end every part of the picture has to have gained: where given normals explain the pictures as
well as the refined ones, given that these have two numbers a pixel more to do it with, the given
ones are put back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.estimator import solve
from pbrfit.fit.normals.all_pixels import (
    refine_all,
    restore_given,
    start_from_offsets,
    start_from_subset,
    tangent_offsets_between,
)
from pbrfit.fit.normals.noise import NeighbourPairs
from pbrfit.fit.normals.offset_prior import Neighbourhood, TangentOffsetPrior
from pbrfit.fit.normals.search import fit_subset
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import pixel_index
from pbrfit.fit.run import Run
from pbrfit.model.geometry import angles_between
from pbrfit.result.data import Status
from pbrfit.result.refinement import CHANGE_DEGREES_MIN, Refinement
from pbrfit.scene.scene import Scene
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]

OUT_OF_TIME = "the time limit came first"


@dataclass(frozen=True, eq=False)
class PixelFit:
    """Where a fit of pixels ended: its run, whose scene has the normals, and x of its objective."""

    run: Run
    x: Array
    status: Status
    reason: str


@dataclass(frozen=True)
class Unexplained:
    """What a fit leaves of the pictures."""

    loss: float
    """Mean squared residual, or what a robust loss makes of it, in units of x."""
    rmse: float
    """Its square root, in picture units."""
    residual_correlation: float
    """Between neighbours, as `NeighbourPairs` has it."""
    samples_per_unknown: float
    """Of a pixel, its normal among the unknowns."""
    share_of_freedom: float
    """Share of the degrees of freedom that two unknowns more a pixel would leave."""

    @classmethod
    def by(cls, fit: PixelFit) -> Unexplained:
        """A fit with held normals."""
        objective = fit.run.objective
        loss = objective.data_value_and_grad(fit.x)[0]
        unknowns = objective.layout.maps.stop + 2 * objective.pixels
        freedom = objective.samples - objective.size
        left = max(0.0, freedom - 2 * objective.pixels)
        return cls(
            loss=loss,
            rmse=objective.residual_rmse(loss),
            residual_correlation=NeighbourPairs(objective).residual_correlation(fit.x),
            samples_per_unknown=objective.samples / unknowns,
            share_of_freedom=left / freedom if freedom > 0 else 0.0,
        )

    def figures(self, when: str) -> dict[str, float]:
        """As `result.json` has them; `when` is "before" or "after" refinement."""
        return {f"residual_{when}": self.rmse, f"shared_{when}": self.residual_correlation}


def keeps_given(left: Unexplained, *, cut_short: bool) -> str | None:
    """Why given normals are kept without trying others; None if others are to be tried.

    `cut_short`: whether the fit was stopped by the number of its iterations, and those were few.
    """
    if left.residual_correlation <= settings.NORMALS_GIVEN_CORRELATION_MAX:
        return "the given normals explain the pictures up to noise"
    if left.loss <= (settings.NORMALS_ROUNDING_RMS * settings.MEAN_RADIANCE) ** 2:
        return "the given normals explain the pictures up to rounding"
    if left.samples_per_unknown < settings.NORMALS_SAMPLES_PER_UNKNOWN_MIN:
        return "too few pictures to tell wrong normals from materials"
    if cut_short:
        return "too few iterations to tell wrong normals from what is not fitted yet"
    return None


def keeps_refined(
    before: Unexplained | None, after: Unexplained, change: float
) -> tuple[bool, str]:
    """Whether refined normals are kept, and why, by what fits with given and with them leave.

    Without `before` refinement was asked for whatever given ones leave. `change` is the largest
    angle between them, in degrees.
    """
    if change < CHANGE_DEGREES_MIN:
        # All pixels were given theirs back, or found that they had been right. What the fit gained
        # it gained by going on.
        return False, "no other normals explain the pictures better"
    if before is None:
        return True, "asked for"
    expected = after.share_of_freedom * before.loss
    correlation = after.residual_correlation
    if after.loss <= settings.NORMALS_PERFECT * expected or (
        after.loss <= settings.NORMALS_FAR_BETTER * expected
        and correlation <= settings.NEIGHBOUR_CORRELATION_MAX
    ):
        return True, "with other normals the pictures are explained far better"
    noise = min(
        settings.NORMALS_REFINED_CORRELATION_MAX,
        settings.NORMALS_REFINED_CORRELATION_RATIO * before.residual_correlation,
    )
    if after.loss < before.loss and correlation <= noise:
        return True, "only with other normals are the pictures explained up to noise"
    return False, "other normals do not explain what the given ones leave of the pictures"


def fit(
    run: Run,
    x: Array,
    make: Callable[[Scene, bool], Objective],
    *,
    start_given: bool,
    asked: str,
    hindered: str | None,
    normals: Array | None = None,
) -> tuple[PixelFit, Refinement]:
    """Fit the scene of `run` from x, and refine its normals where that is asked for and helps.

    `make` gives the objective of a scene, with free normals or without; `asked` is "off", "auto"
    or "on"; `hindered` says why refinement cannot be done. From `normals` (P, 3) pixels may start,
    beside the given ones.
    """

    def fit_given() -> PixelFit:
        return PixelFit(run, *solve(run, x.copy(), start_given=start_given))

    why = "not asked for" if asked == "off" else hindered
    if why is None and run.left <= 0:
        why = "0 iterations asked for"
    if why is not None:
        return fit_given(), Refinement(asked, False, why)
    given, before, figures = None, None, dict[str, float]()
    if asked == "auto":
        given = fit_given()
        before = Unexplained.by(given)
        figures = before.figures("before")
        cut_short = given.status is Status.ITERATION_LIMIT
        cut_short = cut_short and run.iteration <= settings.NORMALS_ITERATIONS_MIN
        why = keeps_given(before, cut_short=cut_short)
        if why is None and run.out_of_time():
            why = OUT_OF_TIME
        if why is not None:
            return given, Refinement(asked, False, why, figures)
    rows = len(run.rows)
    found = _refine(run, x, make, normals)
    if found is None:
        assert given is not None or run.out_of_time()
        return given or fit_given(), Refinement(asked, False, OUT_OF_TIME, figures)
    refined, sigma = found
    after = Unexplained.by(refined)
    figures |= after.figures("after") | {"spread_degrees": float(np.degrees(sigma))}
    change = angles_between(refined.run.scene.normals, run.scene.normals)[run.scene.valid].max()
    kept, why = keeps_refined(before, after, change)
    if not kept and given is not None:
        # The costs stay, of what came to nothing; its history, which the runs share, does not.
        run.evaluations, run.unmeasured = refined.run.evaluations, refined.run.unmeasured
        del run.rows[rows:]
        refined = given
    elif not kept:
        refined.run.scene = run.scene
    return refined, Refinement(asked, kept, why, figures)


@one_blas_thread()
def _refine(
    run: Run, x: Array, make: Callable[[Scene, bool], Objective], normals: Array | None
) -> tuple[PixelFit, float] | None:
    """The fit with refined normals, and the σ of their offsets; None if time ran out."""
    scene = run.scene
    free = make(scene, True)
    ended: tuple[Status, str] | None = None
    free_x, prior = _start(run, x, free, normals)
    roughness_metallic, starts = None, 1
    for number in range(settings.NORMALS_PASSES):
        before = free_x.copy()
        with run.stage("normals of all pixels"):
            prior, sums = refine_all(
                free, free_x, prior, roughness_metallic, starts, run.out_of_time
            )
            if sums is None:
                free_x = before
                break
            if number == settings.NORMALS_PASSES - 1:
                restore_given(free, free_x, sums)
        run, ended = _fit_held(run, scene, free, free_x, make)
        blocks = [free_x[block] for block in free.layout.roughness_metallic]
        roughness_metallic, starts = np.stack(blocks, axis=-1), 0
        if run.out_of_time():
            break
    if ended is None:
        return None
    if run.out_of_time():  # perhaps after the fit that has ended
        ended = run.ended("")
    if run.objective.lighting is None and free.lighting is not None:
        without_lights = replace(run.scene, lighting=None)
        run = run.continued(without_lights, make(without_lights, False))
    return PixelFit(run, _held_x(free, free_x, run.objective), *ended), prior.sigma


def _start(
    run: Run, x: Array, free: Objective, normals: Array | None
) -> tuple[Array, TangentOffsetPrior]:
    """X of the objective with free normals, from lights of a subset if unknown, and the prior."""
    scene, layout, held = run.scene, free.layout, run.objective.layout
    given = np.asarray(scene.normals, dtype=np.float64)[scene.valid]
    normal_sigma = None
    if scene.normal_sigma is not None:
        normal_sigma = scene.normal_sigma[scene.valid].astype(np.float64)
    prior = TangentOffsetPrior(Neighbourhood.of(pixel_index(layout), given, normal_sigma))
    start = free.start()
    start[layout.materials] = x[held.materials]
    start[layout.maps.stop :] = x[held.maps.stop :]
    if normals is not None:
        start_from_offsets(free, start, tangent_offsets_between(given, normals))
    if free.lighting is not None:
        with run.stage("normals and lights from a subset") as notes:
            # Not what the fit before has left: each fit has all iterations that were asked for.
            found = fit_subset(
                free, start, given, normal_sigma, run.out_of_time, rounds=run.options.iterations
            )
            start_from_subset(free, start, found)
            prior = replace(prior, sigma=found.prior.sigma)
            notes.append(f"{len(found.pixels)} pixels")
    return start, prior


def _fit_held(
    run: Run,
    scene: Scene,
    free: Objective,
    free_x: Array,
    make: Callable[[Scene, bool], Objective],
) -> tuple[Run, tuple[Status, str]]:
    """Fit materials with all priors, normals and lights held at those of an x of `free`.

    That x changes. Lights are held because a fit to held normals that are a degree off takes
    blurred highlights for weak ones, and makes lights 2 to 12 % too bright and albedo too dark.
    Those of the joint steps, whose normals move along, are not bent so. But joint steps know
    squares only: where more was asked of lights, they are fitted once more.
    """
    options = run.options
    scene = replace(scene, normals=free.layout.whole(free.normals(free_x)))
    if free.lighting is not None and options.robust == "none" and not options.priors.monochrome:
        scene = replace(scene, lighting=free.unpack(free_x)[1])
    run = run.continued(scene, make(scene, False))
    objective = run.objective
    found, status, reason = solve(run, _held_x(free, free_x, objective), start_given=True)
    free_x[free.layout.materials] = found[objective.layout.materials]
    if objective.lighting is not None:
        free_x[free.layout.maps.stop :] = found[objective.lighting]
    return run, (status, reason)


def _held_x(free: Objective, free_x: Array, held: Objective) -> Array:
    """What an objective with held normals, and perhaps lights, has of an x of `free`."""
    lights = free.layout.lighting if held.lighting is not None else None
    parts = [free_x[free.layout.materials]] + ([] if lights is None else [free_x[lights]])
    return np.concatenate(parts)
