"""A running fit: its clock, its limits, its history, its progress."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.nuisances import Nuisances
from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.mixture import FittedPrior
from pbrfit.fit.priors.posterior import Posterior
from pbrfit.fit.scale import Scale
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.result.camera import Camera
from pbrfit.result.data import Stage, Status
from pbrfit.result.history import HistoryRow
from pbrfit.result.options import FitOptions
from pbrfit.scene.scene import Scene
from pbrfit.steps import step

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Progress:
    """Where a running fit stands; passed to `progress` at the start and after each step.

    Attributes
    ----------
    iteration, iterations
        Done, and at most to be done.
    evaluations
        Passes over all pictures so far.
    recon_rmse
        In picture units; while lights are sought on some pixels, of those.
    elapsed_s
        Without the time that `progress` itself and comparing with ground truth have taken.
    tiles
        How many tiles of a large picture are done, and of how many; None while it is fitted as a
        whole.
    state
        Called inside `progress`, it gives maps and lights as they are now, as `Objective.unpack`.
    """

    iteration: int
    iterations: int
    evaluations: int
    recon_rmse: float
    elapsed_s: float
    state: Callable[[], tuple[Materials, NDArray[np.float64]]] = field(repr=False, compare=False)
    tiles: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class SharedState:
    """What some pixels of a scene were found to have in common with all others."""

    material: FittedPrior | None = None
    """The learnt material prior; None where the fit has none."""
    noise: NoiseModel | None = None
    """Of samples; None where none was found."""
    discrepancy: Discrepancy | None = None
    """How far samples are off; None where nothing asked for it."""


class Trace:
    """What a running fit has been doing: its clock and limits, stages, history and progress."""

    def __init__(
        self,
        options: FitOptions,
        *,
        progress: Callable[[Progress], None] | None,
        began: float,
        stages: Sequence[Stage] = (),
    ) -> None:
        self.options = options
        self._progress, self._began = progress, began
        self._iteration_limit = options.iterations
        self.unmeasured = 0.0
        """Seconds spent on comparing with the ground truth and in `progress`."""
        self.evaluations = self.iteration = 0
        self.rows: list[HistoryRow] = []
        self.stages = list(stages)
        self._late_in = ""
        """The stage in which the time limit was reached."""

    @property
    def left(self) -> int:
        """Iterations."""
        return self._iteration_limit - self.iteration

    @property
    def elapsed(self) -> float:
        """Seconds since the fit began, without what is unmeasured."""
        return time.perf_counter() - self._began - self.unmeasured

    def out_of_time(self) -> bool:
        """Whether the time limit is reached."""
        return self.options.time_limit is not None and self.elapsed >= self.options.time_limit

    @property
    def goes_on(self) -> bool:
        """Whether no limit is reached."""
        return self.left > 0 and not self.out_of_time()

    @contextmanager
    def stage(self, name: str) -> Iterator[list[str]]:
        """Notes the time of a stage of the fit; what is said about it goes into the list."""
        began, notes = self.elapsed, list[str]()
        with nullcontext() if self._progress is None else step(name):
            yield notes
        self.stages.append(Stage(name, self.elapsed - began, "; ".join(notes)))
        if not self._late_in and self.out_of_time():
            self._late_in = name

    def ended(self, why: str, kept: str = "") -> tuple[Status, str]:
        """Status and reason of a fit that stops here: `why`, unless a limit stopped it."""
        if self.out_of_time():
            where = f" in stage {self._late_in}" if self._late_in else ""
            limit = f"time limit of {self.options.time_limit:g} s reached{where}"
            return Status.TIME_LIMIT, f"{limit}{kept}"
        if self.left <= 0:
            return Status.ITERATION_LIMIT, f"{self._iteration_limit} iterations done{kept}"
        return Status.CONVERGED, why

    def tell(
        self,
        recon_rmse: float,
        state: Callable[[], tuple[Materials, Array]],
        *,
        tiles: tuple[int, int] | None = None,
        elapsed: float | None = None,
    ) -> None:
        """Call `progress`, whose fields these are; what is done since `elapsed` is unmeasured."""
        elapsed = self.elapsed if elapsed is None else elapsed
        if self._progress is not None:
            done = self.iteration, self._iteration_limit, self.evaluations
            self._progress(Progress(*done, recon_rmse, elapsed, state, tiles))
        self.unmeasured += self.elapsed - elapsed


class Run(Trace):
    """One fit of an objective, and what it has found so far.

    `shared_state` is what a subset of the scene's pixels has found, where this is another part of
    it; None = the whole scene, which finds it itself.
    """

    def __init__(
        self,
        scene: Scene,
        objective: Objective,
        options: FitOptions,
        *,
        progress: Callable[[Progress], None] | None,
        began: float,
        stages: Sequence[Stage] = (),
        shared_state: SharedState | None = None,
    ) -> None:
        super().__init__(options, progress=progress, began=began, stages=stages)
        self.shared_state = shared_state
        self.scene, self.objective = scene, objective
        self.measured_lighting: Array | None = None
        """When the material prior was fitted: the monochrome weight is chosen by it."""
        self.fitted_prior: FittedPrior | None = None
        """The material prior as it was fitted last."""
        self.posterior: Posterior | None = None
        """Of all pixels, by that prior."""
        self.discrepancy: Discrepancy | None = None
        """How far samples are off under the lights that were found last."""
        self.light_modes: Array | None = None
        """How lights may move that are held for now, though not known; None = as the objective."""
        self.noise: NoiseModel | None = None
        """Of samples, as it was found last."""
        self.camera = Camera(scene.fov, "given" if scene.fov_known else "assumed")
        """What has been decided about it."""
        self.scale: Scale | None = None
        """What is known of the common scale of lights and albedo."""
        self._last = math.nan, math.nan  # loss and its data term, of the last evaluation

    def continued(self, scene: Scene, objective: Objective) -> Run:
        """A run that goes on with another scene and objective, and has all iterations again.

        Both write into one history.
        """
        later = copy.copy(self)
        later.scene, later.objective = scene, objective
        later._iteration_limit = self.iteration + self.options.iterations
        later._last = math.nan, math.nan
        return later

    def see(self, nuisances: Nuisances) -> None:
        """Take the camera that was fitted: from here on all pixels see through it."""
        self.scene = nuisances.scene
        self.objective.see(self.scene)
        self.camera = nuisances.camera(self.camera)

    @property
    def picture_effect(self) -> float:
        """As of the noise of samples; 1 where none was found."""
        return 1.0 if self.noise is None else self.noise.picture_effect

    @property
    def has_mixture_prior(self) -> bool:
        """Whether the fit has a mixture prior on materials."""
        return self.options.priors.material_strength > 0

    def evaluate(self, x: Array) -> tuple[float, Array]:
        """Loss, penalties included, and gradient."""
        self.evaluations += 1
        data, gradient = self.objective.data_value_and_grad(x)
        loss = data + self.objective.add_penalties(x, gradient)
        self._last = loss, data
        return loss, gradient

    def record(self, x: Array, loss: float, data: float | None = None) -> None:
        """Add a row to the history, and call `progress`.

        `data` is the loss without penalties, if it is known.
        """
        elapsed = self.elapsed
        if data is None:
            # In all but rare cases x was the last to be evaluated.
            last, data = self._last
            if last != loss:
                data = self.objective.data_value_and_grad(x)[0]
        recon = self.objective.residual_rmse(data)
        errors = {}
        if self.scene.truth is not None:
            found, _ = self.objective.unpack(x)
            errors = material_errors(found, self.scene.truth.materials)
        self.rows.append(
            HistoryRow(elapsed, self.iteration, self.evaluations, loss, recon, **errors)
        )
        self.tell(recon, lambda: self.objective.unpack(x), elapsed=elapsed)


def material_errors(found: Materials, true: Materials) -> dict[str, float]:
    """Root mean square errors of the maps."""
    names = ("albedo", "roughness", "metallic")
    return {
        f"{name}_rmse": metrics.rmse(getattr(found, name), getattr(true, name)) for name in names
    }
