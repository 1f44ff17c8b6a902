"""A fit of all pixels of a scene at once, and what any fit hands over."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import scale
from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.independent_lights import Shown
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.normals import refined_fit
from pbrfit.fit.objective import Normalization
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.run import FitSetup, Run, State
from pbrfit.fit.transport import Surrounded
from pbrfit.fit.uncertainty import Spread, of_spread, scale_deviation, spread
from pbrfit.model.geometry import angles_between
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.result.camera import Camera
from pbrfit.result.data import Stage, Status
from pbrfit.result.history import HistoryRow
from pbrfit.result.options import FitOptions
from pbrfit.result.refinement import CHANGE_DEGREES_MIN, Refinement
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array

Start = tuple[Materials, Array | None] | None
"""Maps to start from, and perhaps lights."""


@dataclass(frozen=True, eq=False)
class FitOutput:
    """What a fit found: arrays of whole pictures, and nothing of the core."""

    materials: Materials
    lighting: Array
    normals: Array
    """As in `Result`."""
    uncertainty: Uncertainty | None
    """None where it was not asked for."""
    status: Status
    reason: str
    rows: tuple[HistoryRow, ...]
    evaluations: int
    stages: tuple[Stage, ...]
    """How it went."""
    seconds: float
    """Since it began, without those of `progress`."""
    refinement: Refinement
    camera: Camera
    """What was decided about normals, and about the camera."""
    exposures: Array | None
    """As in `Objective`."""
    scale: str
    """What the scale between lights and albedo rests on, in words."""
    measured_lighting: Array | None
    """Lights by which the monochrome weight was chosen; None = it was not."""
    noise: NoiseModel | None = None
    """Of samples; None where all weigh as given."""
    discrepancy: Discrepancy | None = None
    """How far samples are off; None where neither a prior nor the uncertainty asked for it."""
    shown: Shown | None = None
    """What independent lights show of a pixel; None where nobody asked."""
    surrounded: Surrounded | None = None
    recon_rmse: float | None = None
    """With surroundings or lamps, and the error with them, weighted, of samples over exposures."""
    lamps: Lamps | None = None
    """Of the pictures, in picture units; None where light is spherical harmonics alone."""
    height: NDArray[np.float32] | None = None
    """As in `Result`."""
    normal_sigma: Array | None = None
    """(H, W), degrees: how uncertain normals are that lamps have told; None = they were held."""


def fit_whole(scene: Scene, setup: FitSetup, start: Start) -> FitOutput:
    """Fit all pixels of a scene at once."""
    state, refinement = fit_pixels(scene, setup, start)
    run, objective, uncertainty = state.run, state.run.objective, None
    if setup.options.uncertainty:
        with run.stage("uncertainty"):
            state = replace(state, discrepancy=state.judged())
            found = spread(objective, state.x, state.judged(), state.posterior)
            uncertainty = uncertainty_of(state, found, objective.layout)
    materials, lighting = objective.unpack(state.x)
    recon_rmse = None
    if setup.surrounded is not None:  # of samples as they weigh in the scene
        given = objective.weighed(None)
        recon_rmse = given.residual_rmse(given.data_value_and_grad(state.x)[0])
    return output_of(
        state,
        setup,
        refinement,
        materials=materials,
        lighting=lighting,
        normals=np.asarray(run.scene.normals, dtype=np.float64),
        uncertainty=uncertainty,
        recon_rmse=recon_rmse,
    )


def output_of(state: State, setup: FitSetup, refinement: Refinement, **others: Any) -> FitOutput:
    """What was found, with the other fields: maps, lighting, normals, uncertainty, error."""
    run = state.run
    by_default = "by the known lights" if run.objective.lighting is None else "by the start"
    return FitOutput(
        **others,
        discrepancy=state.discrepancy,
        shown=None if state.discrepancy is None else state.discrepancy.shown,
        status=state.ended[0],
        reason=state.ended[1],
        rows=tuple(run.rows),
        evaluations=run.evaluations,
        stages=tuple(run.stages),
        seconds=run.elapsed,
        refinement=refinement,
        camera=run.camera,
        exposures=run.objective.exposures,
        scale=by_default if state.scale is None else state.scale.assumed,
        measured_lighting=state.measured_lighting,
        noise=state.noise,
        surrounded=setup.surrounded,
    )


def uncertainty_of(state: State, found: Spread, layout: ParameterLayout) -> Uncertainty:
    """Of pixels of a layout, with what is known of the common scale."""
    deviation, known, objective = np.zeros(1), state.scale, state.run.objective
    discrepancy = state.judged()
    if objective.lighting is not None:
        own, referred = (None, False) if known is None else (known.deviation, known.referred)
        deviation = scale_deviation(own, discrepancy, referred=referred)
    return of_spread(found, layout, discrepancy, deviation, objective)


def fit_pixels(
    scene: Scene, setup: FitSetup, start: Start, units: Normalization | None = None
) -> tuple[State, Refinement]:
    """What the fit of a scene has found, and what was done about its normals.

    `units` as for `Objective`.
    """
    units = units or Normalization.of(scene, setup.options.equal_exposures)
    make = partial(setup.objective, units=units)
    objective = make(scene)
    x = objective.start()
    if start is not None:
        maps, lighting = start
        x = objective.pack(maps.albedo, maps.roughness, maps.metallic, lighting)
        x = np.clip(x, *objective.bounds.T)
    run, given = Run(setup, scene, objective), start is not None
    state = refined_fit.fit(run, x, make, start_given=given, refines=setup.refines)
    asked, why = setup.options.refine_normals, setup.why_normals
    refined = False
    if setup.refines:
        turned = angles_between(state.run.scene.normals, scene.normals)[scene.valid]
        refined = bool(turned.max() >= CHANGE_DEGREES_MIN)
    if setup.refines and not refined:
        # All pixels were given theirs back, or found that they had been right, or had no time.
        state.run.scene = scene.through(state.run.scene.fov)
        why = "no other normals explain the pictures better"
        why = refined_fit.OUT_OF_TIME if state.run.out_of_time() else why
    return _with_scale(state, setup.options), Refinement(asked, refined, why)


def _with_scale(state: State, options: FitOptions) -> State:
    """With the scale of a reference, if there is one, and what is known of the scale."""
    run, x, objective = state.run, state.x, state.run.objective
    if objective.lighting is None or not run.iteration:
        return state
    prior = next((one for one in objective.penalties if isinstance(one, GaussianPrior)), None)
    known = None
    if options.white is not None:
        with run.stage("albedo scale by the reference"):
            x, known = scale.refer(objective, x, prior, options.white)
            run.record(x, run.evaluate(x)[0])
    elif options.uncertainty:
        with run.stage("albedo scale"):
            known = scale.judge(objective, x, prior, state.picture_effect)
    return replace(state, x=x, scale=known)
