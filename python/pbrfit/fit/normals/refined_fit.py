"""A fit whose normals may be refined: when, in which order, and what is kept of it.

With `auto` the first fit holds the given normals. Where they are right, neighbouring pixels have
nothing in common in what it leaves of them, and that is the end of it. Else normals are refined,
and the refined fit has to earn its place: it must leave noise, or far less than the held one did.
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

from pbrfit.fit import normals as free_normals
from pbrfit.fit.gauss_newton.pixels import chunks, taken
from pbrfit.fit.misfit import NeighbourPairs
from pbrfit.fit.normals.noise import degrees_of_freedom, noise_variance
from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import MEAN_RADIANCE, NEIGHBOUR_CORRELATION_MAX
from pbrfit.fit.solvers.run import Run
from pbrfit.fit.solvers.strategies import solve
from pbrfit.model.geometry import angles_between
from pbrfit.result.data import Status
from pbrfit.result.refinement import LEAST_CHANGE, Refinement
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]

RIGHT = 0.03
"""Mean cosine between residuals of neighbours up to which the given normals are right."""

ROUNDING = 1e-6
"""Root mean square residual, as a share of the mean radiance, of which nothing is to be made: that
of float32 pictures is 6e-8 at most, and neighbours of one colour may be rounded alike."""

EXPLAINED = 0.1
LESS_SHARED = 0.5
"""And with refined ones: what they leave is noise up to so much, if it is at most half of what the
given ones left. Noise that seven numbers a pixel were fitted to shares less."""

MUCH_LESS = 0.1
NOTHING = 0.01
"""Of the squares with given normals, each by its degrees of freedom: what leaves no more explains
the pictures, if neighbours share little of it, or if it is next to nothing. Normals that bend to
shadows leave little too, but neighbours share that."""

PASSES = 2
"""Of turning all normals, and fitting with them held."""

ENOUGH = 2.0
"""Samples for each unknown of a pixel, its normal's included, from which on `auto` refines: with
fewer almost anything can be explained."""

LOOK = 50
"""Iterations at which a fit that was stopped by their number is a look, not a fit: what it leaves
may be gone with the next ones."""

WINDOW = 5
"""Pixels in each direction over which a gain is averaged."""

FREE_GAIN = 2.0
"""Of squares in units of the noise: what two numbers more a pixel gain on noise alone."""

SURE = 3.0
"""Standard deviations beyond that a gain has to be."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended: its run, whose scene has the normals, and x of the run's objective."""

    run: Run
    x: Array
    status: Status
    reason: str


def fit(
    run: Run,
    x: Array,
    make: Callable[[Scene, bool], Objective],
    *,
    start_given: bool,
    asked: str,
    hindered: str | None,
    turned: Array | None = None,
) -> tuple[Fit, Refinement]:
    """Fit the scene of `run` from x, and refine its normals where that is asked for and helps.

    Parameters
    ----------
    make
        The objective of a scene, with free normals or without.
    asked
        "off", "auto" or "on".
    hindered
        Why refinement cannot be done; None if it can.
    turned
        (P, 3): unit normals that pixels may start from, beside the given ones; None = none.
    """
    why = "not asked for" if asked == "off" else hindered
    if why is None and run.left <= 0:
        why = "0 iterations asked for"
    if why is not None:
        return Fit(run, *solve(run, x, start_given=start_given)), Refinement(asked, False, why)
    held, figures = None, dict[str, float]()
    if asked == "auto":
        held = Fit(run, *solve(run, x.copy(), start_given=start_given))
        objective = run.objective
        shared = NeighbourPairs(objective).residual_correlation(held.x)
        before = objective.data_value_and_grad(held.x)[0]
        figures = {
            "residual_before": objective.residual_rmse(before),
            "shared_before": shared,
        }
        if shared <= RIGHT:
            why = "the given normals explain the pictures up to noise"
            return held, Refinement(asked, False, why, figures)
        if before <= (ROUNDING * MEAN_RADIANCE) ** 2:
            why = "the given normals explain the pictures up to rounding"
            return held, Refinement(asked, False, why, figures)
        unknowns = objective.layout.maps.stop / objective.pixels + 2
        if objective.samples < ENOUGH * unknowns * objective.pixels:
            why = "too few pictures to tell wrong normals from materials"
            return held, Refinement(asked, False, why, figures)
        if held.status is Status.ITERATION_LIMIT and run.iteration <= LOOK:
            why = "too few iterations to tell wrong normals from what is not fitted yet"
            return held, Refinement(asked, False, why, figures)
        if run.out_of_time():
            return held, Refinement(asked, False, "the time limit came first", figures)
    rows = len(run.rows)
    found = _refined(run, x, make, turned)
    if found is None:
        assert held is not None or run.out_of_time()
        held = held or Fit(run, *solve(run, x, start_given=start_given))
        return held, Refinement(asked, False, "the time limit came first", figures)
    refined, spread = found
    objective = refined.run.objective
    after = objective.data_value_and_grad(refined.x)[0]
    shared = NeighbourPairs(objective).residual_correlation(refined.x)
    figures |= {
        "residual_after": objective.residual_rmse(after),
        "shared_after": shared,
        "spread_degrees": float(np.degrees(spread)),
    }
    change = angles_between(refined.run.scene.normals, run.scene.normals)[run.scene.valid]
    if change.max() < LEAST_CHANGE:
        # All pixels were given theirs back, or found that they had been right. What the fit gained
        # it gained by going on.
        why = "no other normals explain the pictures better"
        if held is not None:
            return _after(held, refined.run, rows), Refinement(asked, False, why, figures)
        refined.run.scene = run.scene
        return refined, Refinement(asked, False, why, figures)
    if held is None:
        return refined, Refinement(asked, True, "asked for", figures)
    far_less = _left_of_degrees(objective) * before
    reason = _explained(after, before, far_less, shared, figures["shared_before"])
    if reason is not None:
        return refined, Refinement(asked, True, reason, figures)
    why = "other normals do not explain what the given ones leave of the pictures"
    return _after(held, refined.run, rows), Refinement(asked, False, why, figures)


def _explained(
    after: float, before: float, far_less: float, shared: float, shared_before: float
) -> str | None:
    """Why refined normals are kept, by what they leave and what of it neighbours share; or None."""
    if after <= NOTHING * far_less or (
        after <= MUCH_LESS * far_less and shared <= NEIGHBOUR_CORRELATION_MAX
    ):
        return "with other normals the pictures are explained far better"
    if after < before and shared <= min(EXPLAINED, LESS_SHARED * shared_before):
        return "only with other normals are the pictures explained up to noise"
    return None


def _left_of_degrees(objective: Objective) -> float:
    """Share of the degrees of freedom of a held fit that two numbers more a pixel leave it."""
    held = objective.samples - objective.size
    return max(0.0, held - 2 * objective.pixels) / held if held > 0 else 0.0


def _after(held: Fit, later: Run, rows: int) -> Fit:
    """A fit with what a later run that came to nothing has cost; of its history the first rows."""
    run = held.run
    run.stages, run.evaluations, run.unmeasured = later.stages, later.evaluations, later.unmeasured
    del run.rows[rows:]
    return held


def _refined(
    run: Run,
    x: Array,
    make: Callable[[Scene, bool], Objective],
    turned: Array | None,
) -> tuple[Fit, float] | None:
    """The fit with refined normals, and the spread of their changes; None if time ran out."""
    from threadpoolctl import threadpool_limits

    scene, valid = run.scene, run.scene.valid
    given = np.asarray(scene.normals, dtype=np.float64)[valid]
    sigma = None if scene.normal_sigma is None else scene.normal_sigma[valid].astype(np.float64)
    free = make(scene, True)
    layout = free.layout
    moving = free.start()
    moving[layout.materials] = x[run.objective.layout.materials]
    moving[layout.maps.stop :] = x[run.objective.layout.maps.stop :]
    if turned is not None:
        free_normals.start_nearer(free, moving, free_normals.tilts_between(given, turned))
    starts = 1
    # Sums split over threads would round differently on a machine with more processors.
    with threadpool_limits(1, user_api="blas"):
        if free.lighting is not None:
            with run.stage("normals and lights from a lattice") as notes:
                # Not what the fit before has left: each fit has all iterations that were asked for.
                lattice = free_normals.find(
                    free, moving, given, sigma, run.out_of_time, rounds=run.options.iterations
                )
                free_normals.spread_out(free, moving, lattice)
                spread = lattice.prior.spread
                notes.append(f"{len(lattice.pixels)} pixels")
        else:
            spread = free_normals.FIRST_SPREAD
        prior = free_normals.prior_of(free, given, sigma, spread)
        ended: tuple[Status, str] | None = None
        finish = None
        for number in range(PASSES):
            before = moving.copy()
            with run.stage("normals of all pixels"):
                prior, squares = free_normals.turn(
                    free, moving, prior, finish, starts, run.out_of_time
                )
                if squares is None:
                    moving = before
                    break
                if number == PASSES - 1:
                    _put_back(free, moving, squares)
            run, ended = _fit_held(run, scene, free, moving, make)
            finish = np.stack([moving[block] for block in layout.roughness_metallic], axis=-1)
            starts = 0
            if run.out_of_time():
                break
    if ended is None:
        return None
    if run.out_of_time():  # perhaps after the fit that has ended
        ended = run.ended("")
    if run.objective.lighting is None and free.lighting is not None:
        unlit = replace(run.scene, lighting=None)
        run = run.continued(unlit, make(unlit, False))
    return Fit(run, _of_held(free, moving, run.objective), *ended), prior.spread


def _fit_held(
    run: Run,
    scene: Scene,
    free: Objective,
    moving: Array,
    make: Callable[[Scene, bool], Objective],
) -> tuple[Run, tuple[Status, str]]:
    """Fit materials with all priors, normals and lights held at those of an x of `free`.

    That x changes. Lights are held because a fit to held normals that are a degree off takes
    blurred highlights for weak ones, and makes lights 2 to 12 % too bright and albedo too dark.
    Those of the joint steps, whose normals move along, are not drawn so. But joint steps know
    squares only: where more was asked of lights, they are fitted once more.
    """
    turned = replace(scene, normals=free.layout.whole(free.normals(moving)))
    if (
        free.lighting is not None
        and run.options.robust == "none"
        and not run.options.priors.monochrome
    ):
        turned = replace(turned, lighting=free.unpack(moving)[1])
    run = run.continued(turned, make(turned, False))
    objective = run.objective
    start = _of_held(free, moving, objective)
    found, status, reason = solve(run, start, start_given=True)
    moving[free.layout.materials] = found[objective.layout.materials]
    if objective.lighting is not None:
        moving[free.layout.maps.stop :] = found[objective.lighting]
    return run, (status, reason)


def _of_held(free: Objective, x: Array, held: Objective) -> Array:
    """What an objective with held normals, and perhaps lights, has of an x of `free`."""
    lights = free.layout.lighting if held.lighting is not None else None
    parts = [x[free.layout.materials]] + ([] if lights is None else [x[lights]])
    return np.concatenate(parts)


def _put_back(free: Objective, x: Array, squares: Array) -> None:
    """Give pixels their given normals back around which nothing has been gained; x changes."""
    from scipy.ndimage import uniform_filter

    layout = free.layout
    assert layout.tangent_offsets is not None
    nowhere = x.copy()
    nowhere[layout.tangent_offsets] = 0.0
    as_given = np.empty(free.pixels)
    own = np.empty((free.pixels, layout.maps.stop // free.pixels))
    empty = np.empty(0)
    for chunk in chunks(free.pixels):
        own[chunk], as_given[chunk] = free.problem.fit_materials(
            free.for_core(nowhere),
            chunk,
            empty,
            empty,
            starts=0,
            steps=12,
            exact_steps=2,
            held_normals=True,
        )
    gain = (as_given - squares) / noise_variance(free, squares)
    gain = np.minimum(gain, 10 * degrees_of_freedom(free))
    inside = uniform_filter(layout.valid.astype(np.float64), WINDOW, mode="constant")
    around = uniform_filter(layout.whole(gain, 0.0), WINDOW, mode="constant")
    counted = np.maximum(inside[layout.valid] * WINDOW**2, 1.0)
    mean = around[layout.valid] * WINDOW**2 / counted
    # Squares of a normal number have mean 1 and variance 2.
    needed = FREE_GAIN * (1 + SURE * np.sqrt(1 / counted))
    back = mean < needed
    turned = taken(free, x, slice(None)).copy()
    turned[back] = own[back]
    x[layout.maps] = turned.T.ravel()
