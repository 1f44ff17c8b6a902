"""A fit of all pixels of a scene at once, and what any fit is asked for and finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.normals import refined_fit
from pbrfit.fit.objective import Normalization, Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.penalties import Priors
from pbrfit.fit.solvers import Limits, Progress, Run, Solver
from pbrfit.fit.solvers.run import SharedState
from pbrfit.fit.uncertainty import Uncertainty, estimate
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.result.history import HistoryRow
from pbrfit.result.refinement import Refinement, RefineNormals
from pbrfit.result.result import Stage, Status
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]

Start = Materials | tuple[Materials, Array] | None
"""Maps to start from, alone or with lights."""


@dataclass(frozen=True, eq=False)
class Asked:
    """What `decompose` was asked for; its docstring has each.

    Attributes
    ----------
    hindered
        Why normals cannot be refined; None if they can.
    began
        When, by `time.perf_counter`.
    """

    solver: Solver
    limits: Limits
    threads: int
    sh_order: int
    metallic: float | None
    mono_light: bool
    priors: Priors
    uncertainty: bool
    robust: str
    equal_exposures: bool | None
    refine_normals: RefineNormals
    hindered: str | None
    seed: int
    model: Model
    progress: Callable[[Progress], None] | None
    began: float

    def layout(self, scene: Scene) -> ParameterLayout:
        """Which unknowns a scene has."""
        return ParameterLayout.of(
            scene,
            sh_order=self.sh_order,
            metallic_known=self.metallic is not None,
            mono_light=self.mono_light,
        )

    def objective(
        self, scene: Scene, *, free_normals: bool = False, units: Normalization | None = None
    ) -> Objective:
        """What is minimised."""
        return Objective(
            scene,
            threads=self.threads,
            sh_order=self.sh_order,
            metallic=self.metallic,
            mono_light=self.mono_light,
            priors=None if free_normals else self.priors,
            equal_exposures=self.equal_exposures,
            free_normals=free_normals,
            model=self.model,
            units=units,
        )

    def run(
        self,
        scene: Scene,
        objective: Objective,
        taught: SharedState | None = None,
    ) -> Run:
        """A run that is about to begin."""
        return Run(
            scene,
            objective,
            priors=self.priors,
            robust=self.robust,
            limits=self.limits,
            seed=self.seed,
            progress=self.progress,
            began=self.began,
            taught=taught,
        )


@dataclass(frozen=True, eq=False)
class Found:
    """What a fit found: arrays of whole pictures, and nothing of the core.

    Attributes
    ----------
    materials, lighting, normals
        As in `Result`.
    uncertainty
        None where it was not asked for.
    status, reason, rows, evaluations, iterations, stages
        How it went.
    seconds
        Since it began, without those of the uncertainty and of who was told.
    refinement
        What was decided about normals.
    exposures
        As in `Objective`.
    measured_lighting
        Lights by which the monochrome weight was chosen; None = it was not.
    """

    materials: Materials
    lighting: Array
    normals: Array
    uncertainty: Uncertainty | None
    status: Status
    reason: str
    rows: tuple[HistoryRow, ...]
    evaluations: int
    iterations: int
    stages: tuple[Stage, ...]
    seconds: float
    refinement: Refinement
    exposures: Array | None
    measured_lighting: Array | None


def fit_whole(scene: Scene, asked: Asked, start: Start) -> Found:
    """Fit all pixels of a scene at once."""
    found, refinement = fit_pixels(scene, asked, start)
    run, x = found.run, found.x
    seconds = run.elapsed
    uncertainty = None
    if asked.uncertainty:
        uncertainty = estimate(run.objective, x, priors=asked.priors != Priors.none())
    materials, lighting = run.objective.unpack(x)
    return Found(
        materials=materials,
        lighting=lighting,
        normals=np.asarray(run.scene.normals, dtype=np.float64),
        uncertainty=uncertainty,
        status=found.status,
        reason=found.reason,
        rows=tuple(run.rows),
        evaluations=run.evaluations,
        iterations=run.iteration,
        stages=tuple(run.stages),
        seconds=seconds,
        refinement=refinement,
        exposures=run.objective.exposures,
        measured_lighting=run.measured_lighting,
    )


def fit_pixels(
    scene: Scene, asked: Asked, start: Start, units: Normalization | None = None
) -> tuple[refined_fit.Fit, Refinement]:
    """Where the fit of a scene ends, and what was decided about its normals.

    `units` as for `Objective`.
    """

    def make(of: Scene, free_normals: bool) -> Objective:
        return asked.objective(of, free_normals=free_normals, units=units)

    objective = make(scene, False)
    return refined_fit.fit(
        asked.run(scene, objective),
        _start_of(objective, start),
        make,
        solver=asked.solver,
        start_given=start is not None,
        asked=asked.refine_normals,
        hindered=asked.hindered,
    )


def _start_of(objective: Objective, start: Start) -> Array:
    """X of the maps to start from."""
    if start is None:
        return objective.start()
    materials, lighting = (start, None) if isinstance(start, Materials) else start
    x = objective.pack(materials.albedo, materials.roughness, materials.metallic, lighting)
    return np.clip(x, *objective.bounds.T)
