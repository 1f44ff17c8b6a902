"""What a fit is given, how it runs (clock, limits, history, progress), and what it has found."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field

import numpy as np

from pbrfit.fit import discrepancy
from pbrfit.fit.discrepancy import Discrepancy
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.nuisances import Nuisances
from pbrfit.fit.objective import Normalization, Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.mixture import FittedPrior
from pbrfit.fit.priors.posterior import Posterior
from pbrfit.fit.scale import Scale
from pbrfit.fit.transport import Surrounded
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.result import metrics
from pbrfit.result.camera import Camera
from pbrfit.result.data import Stage, Status
from pbrfit.result.history import HistoryRow
from pbrfit.result.options import FitOptions
from pbrfit.result.verdict import PARAMETERS
from pbrfit.scene.scene import Scene
from pbrfit.steps import step
from pbrfit.values.arrays import Array


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
    state: Callable[[], tuple[Materials, Array]] = field(repr=False, compare=False)
    tiles: tuple[int, int] | None = None


@contextmanager
def notebook_bar(iterations: int) -> Iterator[Callable[[Progress], None]]:
    """Give what moves a bar, in notebooks a widget: by iterations, of large pictures then tiles."""
    from tqdm.auto import tqdm

    with tqdm(total=iterations, unit="it", desc="fit") as bar:

        def show(progress: Progress) -> None:
            bar.set_postfix_str(f"recon {progress.recon_rmse:.2e}", refresh=False)
            done = progress.iteration
            if progress.tiles is not None:
                done, of = progress.tiles
                if done == 0:
                    bar.unit = "tile"
                    bar.reset(of)
            bar.update(done - bar.n)

        yield show
        bar.total = bar.n  # most fits need fewer iterations than they may do
        bar.refresh()


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


class Trace:
    """What a running fit has been doing: its clock and limits, stages, history and progress."""

    def __init__(self, setup: FitSetup) -> None:
        self.options = setup.options
        self._progress, self._began = setup.progress, setup.began
        self._iteration_limit = setup.options.iterations
        self.unmeasured = 0.0
        """Seconds spent on comparing with the ground truth and in `progress`."""
        self.evaluations = self.iteration = 0
        self.rows: list[HistoryRow] = []
        self.stages = list(setup.stages)
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

    def add_row(self, scene: Scene, found: Materials | None, loss: float, rmse: float) -> None:
        """Add a row to the history, with errors of what was found where the truth is known."""
        elapsed, errors = self.elapsed, {}
        if scene.truth is not None and found is not None:
            errors = material_errors(found, scene.truth.materials)
        row = HistoryRow(elapsed, self.iteration, self.evaluations, loss, rmse, **errors)
        self.rows.append(row)

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
    """One fit of an objective.

    `shared` is what a subset of the scene's pixels has found, where this is another part of it;
    None = the whole scene, which finds it itself.
    """

    def __init__(
        self, setup: FitSetup, scene: Scene, objective: Objective, shared: State | None = None
    ) -> None:
        super().__init__(setup)
        self.scene, self.objective, self.shared = scene, objective, shared
        self.light_modes: Array | None = None
        """How lights may move that are held for now, though not known; None = as the objective."""
        self.camera = Camera(scene.fov, "given" if scene.fov_known else "assumed")
        """What has been decided about it."""
        self._last = math.nan, math.nan  # loss and its data term, of the last evaluation

    def continued(
        self,
        scene: Scene,
        objective: Objective,
        *,
        light_modes: Array | None = None,
        options: FitOptions | None = None,
    ) -> Run:
        """A run that goes on with another scene and objective, and has all iterations again.

        Both write into one history.
        """
        later = copy.copy(self)
        later.scene, later.objective, later.options = scene, objective, options or self.options
        later.light_modes = self.light_modes if light_modes is None else light_modes
        later._iteration_limit = self.iteration + self.options.iterations
        later._last = math.nan, math.nan
        return later

    def see(self, nuisances: Nuisances) -> None:
        """Take the camera that was fitted: from here on all pixels see through it."""
        self.scene = nuisances.scene
        self.objective.see(self.scene)
        self.camera = nuisances.camera(self.camera)

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
        found = None if self.scene.truth is None else self.objective.unpack(x)[0]
        self.add_row(self.scene, found, loss, recon)
        self.tell(recon, lambda: self.objective.unpack(x), elapsed=elapsed)

    def visit(self, x: Array, sum_sq: Array) -> bool:
        """Record that all pixels have new materials, with sums of squares (P,); whether to stop."""
        # Pixels that are freed after the last iteration belong to that.
        self.iteration += self.left > 0
        # Squares are those of float64, which a float32 evaluation of a good fit does not reach.
        loss = data = float(sum_sq.sum()) / self.objective.total_weight
        if self.objective.penalties:
            loss += self.objective.add_penalties(x, np.zeros(self.objective.size))
        self.record(x, loss, data)
        return not self.goes_on


@dataclass(frozen=True, eq=False)
class State:
    """What a fit has found; of its parts some are what all pixels of a scene have in common."""

    run: Run
    """Whose scene has the normals and the camera."""
    x: Array
    """Of its objective."""
    noise: NoiseModel | None = None
    """Of samples; None where all weigh as given."""
    material: FittedPrior | None = None
    """The material prior; None where the fit has none."""
    posterior: Posterior | None = None
    """Of all pixels, by that prior."""
    measured_lighting: Array | None = None
    """When that was fitted: the monochrome weight is chosen by it."""
    discrepancy: Discrepancy | None = None
    """How far samples are off under the lights that the prior was fitted with, or those of x."""
    scale: Scale | None = None
    """What is known of the common scale of lights and albedo."""
    ended: tuple[Status, str] = (Status.CONVERGED, "converged")
    """Why it ended."""

    @property
    def picture_effect(self) -> float:
        """As of the noise of samples; 1 where none was found."""
        return 1.0 if self.noise is None else self.noise.picture_effect

    def judged(self) -> Discrepancy:
        """How far samples are off, found now under the lights of x if it was not before."""
        run = self.run
        return self.discrepancy or discrepancy.find(
            run.objective, self.x, self.picture_effect, modes=run.light_modes
        )


def material_errors(found: Materials, true: Materials) -> dict[str, float]:
    """Root mean square errors of the maps."""
    return {
        f"{name}_rmse": metrics.rmse(getattr(found, name), getattr(true, name))
        for name in PARAMETERS
    }
