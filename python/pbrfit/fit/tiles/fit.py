"""The fit of a large picture: a strided subset of its pixels, then tile by tile."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings, uncertainty
from pbrfit.fit.normals import refined_fit
from pbrfit.fit.objective import Normalization, Objective
from pbrfit.fit.run import Run, SharedState, material_errors
from pbrfit.fit.tiles.maps import TiledMaps
from pbrfit.fit.tiles.subset_fit import SubsetResult, fit_subset
from pbrfit.fit.tiles.windows import SceneCutter, Tile, strided_window, tiles
from pbrfit.fit.whole_picture import (
    FitOutput,
    FitSetup,
    Start,
    scale_deviation_of,
    scale_in_words,
)
from pbrfit.model.materials import Materials
from pbrfit.result.data import Stage, Status
from pbrfit.result.history import HistoryRow
from pbrfit.result.options import FitOptions, Priors
from pbrfit.scene.scene import Scene
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]

SUBSET_PIXELS = (settings.TILES_SUBSET_PIXELS_MIN, settings.TILES_SUBSET_PIXELS_MAX)


class Totals:
    """Samples of a whole scene, and what is left of the tiles so far.

    `samples` are those of some weight, `weight` is the sum of the weights, of which the largest
    is 1.
    """

    def __init__(self, scene: Scene, units: Normalization, channels: int) -> None:
        self._scale, self.channels = units.scale, channels
        self._loss_sum = self._weight_sum = 0.0
        self.pixels = int(np.count_nonzero(scene.valid))
        self.samples = channels * len(scene.images) * self.pixels
        self.weight = float(self.samples)
        if scene.limits is None and not scene.weighted:
            return
        self.samples, self.weight = 0, 0.0
        for i in range(len(scene.images)):
            weights = scene.channel_weights(i)
            assert weights is not None
            inside = weights[scene.valid][:, :channels]
            self.samples += int(np.count_nonzero(inside))
            self.weight += float(inside.sum(dtype=np.float64)) / units.largest_weight

    def add(self, objective: Objective, x: Array) -> None:
        """One more tile; pixels of its margin count twice."""
        self._loss_sum += objective.data_value_and_grad(x)[0] * objective.total_weight
        self._weight_sum += objective.total_weight

    @property
    def mean(self) -> float:
        """Loss of the data."""
        return self._loss_sum / self._weight_sum

    @property
    def rmse(self) -> float:
        """In picture units."""
        return math.sqrt(self.mean) * self._scale


@one_blas_thread()
def fit_tiles(
    scene: Scene,
    setup: FitSetup,
    start: Start,
    *,
    subset_pixels: tuple[int, int] = SUBSET_PIXELS,
    side: int = settings.TILE_SIDE,
) -> FitOutput:
    """Fit a scene: some of its pixels together, then all of them in tiles.

    `subset_pixels` find the lights, at least and at most; tiles have at most `side` rows and
    columns.
    """
    options = setup.options
    units = Normalization.of(scene, options.equal_exposures)
    cutter = SceneCutter(scene)
    window = strided_window(scene.valid, *subset_pixels)
    subset = fit_subset(cutter, window, setup, units, start)
    camera = subset.run.camera
    cutter.scene = scene.through(camera.fov_degrees, camera.correction)
    layout = setup.layout(scene)
    maps = TiledMaps(scene, layout, uncertain=options.uncertainty)
    smooth = options.priors.smoothness or subset.refinement.refined
    margin = settings.TILE_MARGIN_SMOOTH if smooth else settings.TILE_MARGIN
    pieces = list(tiles(scene.valid, margin, side))
    whole = Totals(scene, units, layout.channels)
    clock, statuses = subset.run, list[Status]()
    began, passes = clock.elapsed, 0.0

    def state() -> tuple[Materials, Array]:
        return maps.materials, subset.lighting

    clock.tell(clock.rows[-1].recon_rmse, state, tiles=(0, len(pieces)))
    for tile in pieces:
        run, x, status = _fit_tile(tile, subset, cutter, setup, units, whole)
        statuses.append(status)
        maps.put(tile, run.scene, run.objective.unpack(x)[0])
        whole.add(run.objective, x)
        passes += run.evaluations * run.objective.pixels / whole.pixels
        if options.uncertainty:
            before = time.perf_counter()
            assert subset.shared_state.discrepancy is not None
            found = uncertainty.spread(
                run.objective, x, subset.shared_state.discrepancy, run.posterior
            )
            maps.put_spread(tile, run.scene, found)
            clock.unmeasured += time.perf_counter() - before
        del run, x  # before the next tile has its own
        clock.tell(whole.rmse, state, tiles=(len(statuses), len(pieces)))
    of_pixels = f"{subset.pixels} of {layout.pixels} pixels"
    clock.stages.append(
        Stage(
            "all pixels in tiles, lights held",
            clock.elapsed - began,
            f"{len(pieces)} tiles; lights from {of_pixels}",
        )
    )
    clock.evaluations += round(passes)
    seconds = clock.elapsed
    truth = scene.truth
    errors = {} if truth is None else material_errors(maps.materials, truth.materials)
    clock.rows.append(
        HistoryRow(seconds, clock.iteration, clock.evaluations, whole.mean, whole.rmse, **errors)
    )
    deviations = None
    discrepancy = subset.shared_state.discrepancy
    if maps.spread is not None and discrepancy is not None:
        deviations = uncertainty.of_spread(
            maps.spread,
            layout,
            discrepancy,
            scale_deviation_of(clock, discrepancy),
            noise=uncertainty.noise_of(clock.objective, discrepancy),
        )
    status, reason = ending(subset.status, subset.reason, statuses, options)
    return FitOutput(
        materials=maps.materials,
        lighting=subset.lighting,
        normals=maps.normals,
        uncertainty=deviations,
        discrepancy=discrepancy,
        status=status,
        reason=reason,
        rows=tuple(clock.rows),
        evaluations=clock.evaluations,
        iterations=clock.iteration,
        stages=tuple(clock.stages),
        seconds=seconds,
        refinement=subset.refinement,
        camera=subset.run.camera,
        exposures=units.exposures,
        scale=scale_in_words(clock),
        measured_lighting=clock.measured_lighting,
        noise=clock.noise,
        surrounded=setup.surrounded,
        recon_rmse=None if setup.surrounded is None else whole.rmse,
    )


def ending(
    status: Status, reason: str, of_tiles: list[Status], options: FitOptions
) -> tuple[Status, str]:
    """Why a tiled fit ended, from why its subset did and each of its tiles."""
    late = of_tiles.count(Status.TIME_LIMIT)
    cut_short = of_tiles.count(Status.ITERATION_LIMIT)
    if late:
        return Status.TIME_LIMIT, (
            f"time limit of {options.time_limit:g} s reached: {late} of {len(of_tiles)} tiles "
            "are unfinished"
        )
    if status is Status.TIME_LIMIT:
        half = f"half of the time limit of {options.time_limit:g} s"
        return status, f"{half} was not enough for lights"
    if status is Status.CONVERGED and cut_short:
        done = f"{options.iterations} iterations done"
        return Status.ITERATION_LIMIT, f"{done} in {cut_short} of {len(of_tiles)} tiles"
    return status, reason


def _fit_tile(
    tile: Tile,
    subset: SubsetResult,
    cutter: SceneCutter,
    setup: FitSetup,
    units: Normalization,
    whole: Totals,
) -> tuple[Run, Array, Status]:
    """The run of a tile, its x, and why it ended; `whole` is of the scene."""
    # Nobody reads the history of a tile, so it need not know the ground truth.
    part = replace(cutter.cut(tile.outer, subset.lighting), truth=None)
    near, normals = subset.nearest.at(tile.outer)
    priors, shared_state = _scaled_to(subset, Totals(part, units, whole.channels), whole)
    setup = replace(setup, options=replace(setup.options, priors=priors), progress=None)

    def objective_of(of: Scene, free_normals: bool) -> Objective:
        objective = setup.objective(of, free_normals=free_normals, units=units)
        if not free_normals:
            objective.penalties += shared_state.penalties(objective.layout)
        return objective

    objective = objective_of(part, False)
    run = setup.run(part, objective, shared_state)
    run.unmeasured = subset.run.unmeasured
    x = objective.pack(near.albedo, near.roughness, near.metallic)
    objective.put_best_albedo(x, np.arange(objective.pixels, dtype=np.uint64))
    if run.out_of_time():
        return run, x, Status.TIME_LIMIT
    refined = subset.refinement.refined
    found = refined_fit.fit(
        run,
        x,
        objective_of,
        start_given=True,
        refines=refined,
        normals=normals[part.valid] if refined else None,
    )
    return found.run, found.x, found.status


def _scaled_to(subset: SubsetResult, part: Totals, whole: Totals) -> tuple[Priors, SharedState]:
    """What a part's priors and penalties weigh, so that they are as strong as in the whole.

    The data term is a mean by weight. Beside that of the whole, smoothness is a sum, and sparsity
    and cohesion are means over pixels, which may have more or less weight here than elsewhere.
    """
    share = part.weight / whole.weight
    density = share / (part.pixels / whole.pixels)
    shared_state = subset.shared_state
    if shared_state.cohesion is not None:
        means, weight = shared_state.cohesion
        shared_state = replace(shared_state, cohesion=(means, weight / density))
    priors = replace(
        subset.priors,
        smoothness=subset.priors.smoothness / share,
        sparsity=subset.priors.sparsity / density,
        cohesion=0.0,  # means of segments are held: a penalty of the shared state
    )
    return priors, shared_state
