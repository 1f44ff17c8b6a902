"""A fit of all pixels of a scene at once, and what any fit is given and finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import scale
from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.estimator import discrepancy_of
from pbrfit.fit.independent_lights import Shown
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.normals import refined_fit
from pbrfit.fit.objective import Normalization, Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.run import Progress, Run, SharedState
from pbrfit.fit.transport import Surrounded
from pbrfit.fit.uncertainty import Spread, of_spread, scale_deviation, spread
from pbrfit.model.geometry import angles_between
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.result.camera import Camera
from pbrfit.result.data import Stage, Status
from pbrfit.result.history import HistoryRow
from pbrfit.result.options import FitOptions
from pbrfit.result.refinement import CHANGE_DEGREES_MIN, Refinement
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]

Start = tuple[Materials, Array | None] | None
"""Maps to start from, and perhaps lights."""


@dataclass(frozen=True, eq=False)
class FitSetup:
    """The options of a fit, and what belongs to this call alone."""

    options: FitOptions
    """With the reflection model that was decided for."""
    threads: int
    """0 = one for each processor."""
    progress: Callable[[Progress], None] | None
    """Called as the fit goes on; None = nobody."""
    began: float
    """When the fit began, by `time.perf_counter`."""
    stages: tuple[Stage, ...] = ()
    """What has been done since."""
    refines: bool = False
    """Whether normals are refined."""
    why_normals: str = "not asked for"
    """The reason why they are, or are not; empty where that is to be compared."""
    surrounded: Surrounded | None = None
    """The scene with its surroundings; None = nothing blocks its light."""

    @property
    def model(self) -> Model:
        """How surfaces reflect light."""
        assert self.options.model is not None
        return self.options.model

    def layout(self, scene: Scene) -> ParameterLayout:
        """Which unknowns a scene has."""
        return ParameterLayout.of(
            scene,
            sh_order=self.options.sh_order,
            metallic_known=self.options.metallic is not None,
            mono_light=self.options.mono_light,
        )

    def objective(
        self, scene: Scene, free_normals: bool = False, *, units: Normalization | None = None
    ) -> Objective:
        """What is minimised."""
        options = self.options
        objective = Objective(
            scene,
            threads=self.threads,
            sh_order=options.sh_order,
            metallic=options.metallic,
            mono_light=options.mono_light,
            priors=None if free_normals else options.priors,
            equal_exposures=options.equal_exposures,
            free_normals=free_normals,
            model=options.model,
            units=units,
        )
        if self.surrounded is None or free_normals:
            return objective
        return objective.among(self.surrounded.tables(objective))

    def run(
        self, scene: Scene, objective: Objective, shared_state: SharedState | None = None
    ) -> Run:
        """A run that is about to begin."""
        return Run(
            scene,
            objective,
            self.options,
            progress=self.progress,
            began=self.began,
            stages=self.stages,
            shared_state=shared_state,
        )


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
    iterations: int
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
    found, refinement = fit_pixels(scene, setup, start)
    run, x = found.run, found.x
    uncertainty = None
    if setup.options.uncertainty:
        with run.stage("uncertainty"):
            run.discrepancy = run.discrepancy or discrepancy_of(run, run.objective, x)
            found_spread = spread(run.objective, x, run.discrepancy, run.posterior)
            uncertainty = uncertainty_of(run, found_spread, run.objective.layout)
    materials, lighting = run.objective.unpack(x)
    recon_rmse = None
    if setup.surrounded is not None:  # of samples as they weigh in the scene
        given = run.objective.weighed(None)
        recon_rmse = given.residual_rmse(given.data_value_and_grad(x)[0])
    return output_of(
        run,
        setup,
        refinement,
        (found.status, found.reason),
        materials=materials,
        lighting=lighting,
        normals=np.asarray(run.scene.normals, dtype=np.float64),
        uncertainty=uncertainty,
        recon_rmse=recon_rmse,
    )


def output_of(
    run: Run, setup: FitSetup, refinement: Refinement, ended: tuple[Status, str], **others: Any
) -> FitOutput:
    """What a run found, with its other fields: maps, lighting, normals, uncertainty, error."""
    by_default = "by the known lights" if run.objective.lighting is None else "by the start"
    return FitOutput(
        **others,
        discrepancy=run.discrepancy,
        shown=None if run.discrepancy is None else run.discrepancy.shown,
        status=ended[0],
        reason=ended[1],
        rows=tuple(run.rows),
        evaluations=run.evaluations,
        iterations=run.iteration,
        stages=tuple(run.stages),
        seconds=run.elapsed,
        refinement=refinement,
        camera=run.camera,
        exposures=run.objective.exposures,
        scale=by_default if run.scale is None else run.scale.assumed,
        measured_lighting=run.measured_lighting,
        noise=run.noise,
        surrounded=setup.surrounded,
    )


def uncertainty_of(run: Run, found: Spread, layout: ParameterLayout) -> Uncertainty:
    """Of pixels of a layout, with what the run knows of the common scale."""
    assert run.discrepancy is not None
    deviation, known = np.zeros(1), run.scale
    if run.objective.lighting is not None:
        own, referred = (None, False) if known is None else (known.deviation, known.referred)
        deviation = scale_deviation(own, run.discrepancy, referred=referred)
    return of_spread(found, layout, run.discrepancy, deviation, run.objective)


def fit_pixels(
    scene: Scene, setup: FitSetup, start: Start, units: Normalization | None = None
) -> tuple[refined_fit.PixelFit, Refinement]:
    """Where the fit of a scene ends, and what was done about its normals.

    `units` as for `Objective`.
    """
    units = units or Normalization.of(scene, setup.options.equal_exposures)
    make = partial(setup.objective, units=units)
    objective = make(scene)
    run, x = setup.run(scene, objective), _start_of(objective, start)
    found = refined_fit.fit(run, x, make, start_given=start is not None, refines=setup.refines)
    asked, why = setup.options.refine_normals, setup.why_normals
    refined = False
    if setup.refines:
        turned = angles_between(found.run.scene.normals, scene.normals)[scene.valid]
        refined = bool(turned.max() >= CHANGE_DEGREES_MIN)
    if setup.refines and not refined:
        # All pixels were given theirs back, or found that they had been right, or had no time.
        found.run.scene = scene.through(found.run.scene.fov)
        late = found.run.out_of_time()
        why = refined_fit.OUT_OF_TIME if late else "no other normals explain the pictures better"
    return _with_scale(found, setup.options), Refinement(asked, refined, why)


def _with_scale(found: refined_fit.PixelFit, options: FitOptions) -> refined_fit.PixelFit:
    """The fit with the scale of its reference, if it has one, and what is known of its scale."""
    run, x = found.run, found.x
    if run.objective.lighting is None or not run.iteration:
        return found
    prior = next((one for one in run.objective.penalties if isinstance(one, GaussianPrior)), None)
    if options.white is not None:
        with run.stage("albedo scale by the reference"):
            x, run.scale = scale.refer(run.objective, x, prior, options.white)
            run.record(x, run.evaluate(x)[0])
    elif run.scale is None and options.uncertainty:
        with run.stage("albedo scale"):
            run.scale = scale.judge(run.objective, x, prior, run.picture_effect)
    return replace(found, x=x)


def _start_of(objective: Objective, start: Start) -> Array:
    """X of the maps to start from."""
    if start is None:
        return objective.start()
    materials, lighting = start
    x = objective.pack(materials.albedo, materials.roughness, materials.metallic, lighting)
    return np.clip(x, *objective.bounds.T)
