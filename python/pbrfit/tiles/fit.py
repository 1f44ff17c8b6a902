"""The fit of a large picture: a lattice of its pixels, then tile by tile."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit import refined_fit, uncertainty
from pbrfit.history import HistoryRow
from pbrfit.objective import Objective, Units
from pbrfit.priors import Priors
from pbrfit.result import Stage, Status
from pbrfit.scene import Scene
from pbrfit.solvers import Run
from pbrfit.solvers.run import material_errors
from pbrfit.tiles.canvas import Canvas
from pbrfit.tiles.lattice_fit import Lattice, fit_lattice
from pbrfit.tiles.part import Parts
from pbrfit.tiles.tiling import FEW, MARGIN, THIN_MARGIN, TILE, Tile, lattice, tiles
from pbrfit.whole_fit import Asked, Found, Start

Array = NDArray[np.float64]


def fit_tiles(
    scene: Scene, asked: Asked, start: Start, *, few: int = FEW, side: int = TILE
) -> Found:
    """Fit a scene: some of its pixels together, then all of them in tiles.

    Parameters
    ----------
    few
        Pixels that find the lights, at most.
    side
        Rows and columns of a tile, at most.
    """
    units = Units.of(scene, asked.equal_exposures)
    parts = Parts(scene)
    known = fit_lattice(parts, lattice(scene.valid, few), asked, units, start)
    layout = asked.layout(scene)
    canvas = Canvas(scene, layout, uncertain=asked.uncertainty)
    refined = known.refinement.refined
    margin = MARGIN if asked.priors.smoothness or refined else THIN_MARGIN
    pieces = list(tiles(scene.valid, margin, side))
    whole = _Total(scene, units, layout.channels)
    clock, late = known.run, 0
    began = clock.elapsed
    for number, tile in enumerate(pieces, 1):
        run, x, in_time = _fit_tile(tile, known, parts, asked, units, whole.weight)
        late += not in_time
        canvas.put(tile, run.scene, run.objective.unpack(x)[0])
        whole.add(run.objective, x)
        clock.evaluations += run.evaluations
        if asked.uncertainty:
            before = time.perf_counter()
            canvas.put_variances(
                tile, run.scene, uncertainty.variances(run.objective, x, known.modes)
            )
            clock.unmeasured += time.perf_counter() - before
        clock.tell_tile(
            (number, len(pieces)), whole.rmse, lambda: (canvas.materials, known.lighting)
        )
    clock.stages.append(
        Stage(
            "all pixels in tiles, lights held",
            clock.elapsed - began,
            f"{len(pieces)} tiles; lights from {known.pixels} of {layout.pixels} pixels",
        )
    )
    errors = {}
    if scene.truth is not None:
        errors = material_errors(canvas.materials, scene.truth.materials)
    seconds = clock.elapsed
    clock.rows.append(
        HistoryRow(seconds, clock.iteration, clock.evaluations, whole.mean, whole.rmse, **errors)
    )
    status, reason = known.status, known.reason
    if late:
        status = Status.TIME_LIMIT
        reason = (
            f"time limit of {asked.limits.seconds:g} s reached: {late} of {len(pieces)} tiles are "
            "unfinished"
        )
    deviations = None
    if canvas.variances is not None:
        deviations = uncertainty.of_variances(
            canvas.variances,
            layout,
            known.modes,
            samples=whole.samples,
            scale=units.scale,
            priors=asked.priors != Priors.none(),
        )
    return Found(
        materials=canvas.materials,
        lighting=known.lighting,
        normals=canvas.normals,
        uncertainty=deviations,
        status=status,
        reason=reason,
        rows=tuple(clock.rows),
        evaluations=clock.evaluations,
        iterations=clock.iteration,
        stages=tuple(clock.stages),
        seconds=seconds,
        refinement=known.refinement,
        exposures=units.exposures,
        measured_lighting=clock.measured_lighting,
    )


class _Total:
    """Samples and weights of a whole scene, and what is left of the tiles so far."""

    def __init__(self, scene: Scene, units: Units, channels: int) -> None:
        self._scale = units.scale
        self._left = self._of = 0.0
        if scene.weights is None or not scene.weighted:
            self.samples = channels * len(scene.images) * int(np.count_nonzero(scene.valid))
            self.weight = float(self.samples)
            return
        self.samples, self.weight = 0, 0.0
        for of_picture in scene.weights:
            inside = of_picture[scene.valid]
            self.samples += channels * int(np.count_nonzero(inside))
            self.weight += channels * float(inside.sum(dtype=np.float64)) / units.largest_weight

    def add(self, objective: Objective, x: Array) -> None:
        self._left += objective.data_value_and_grad(x)[0] * objective.total_weight
        self._of += objective.total_weight

    @property
    def mean(self) -> float:
        """Loss of the data."""
        return self._left / self._of

    @property
    def rmse(self) -> float:
        """In picture units."""
        return math.sqrt(self.mean) * self._scale


def _fit_tile(
    tile: Tile, known: Lattice, parts: Parts, asked: Asked, units: Units, weight: float
) -> tuple[Run, Array, bool]:
    """The run of a tile, its x, and whether time was enough; `weight` is that of the scene."""
    part = parts.cut(tile.outer, known.lighting)
    near, normals = known.near.at(tile.outer)

    def objective_of(of: Scene, priors: Priors, free_normals: bool) -> Objective:
        objective = replace(asked, priors=priors).objective(
            of, free_normals=free_normals, units=units
        )
        if not free_normals:
            objective.penalties += known.taught.penalties(objective.layout)
        return objective

    # Segments' means are held, so cohesion is a pull that was taught.
    priors = replace(known.priors, cohesion=0.0)
    objective = objective_of(part, priors, False)
    if priors.smoothness:
        # A sum over the tile, beside a mean over it that in the whole is over more.
        share = objective.total_weight / weight
        priors = replace(priors, smoothness=priors.smoothness / share)
        objective = objective_of(part, priors, False)
    run = asked.run(part, objective, priors=priors, taught=known.taught, told=False)
    run.unmeasured = known.run.unmeasured
    x = objective.pack(near.albedo, near.roughness, near.metallic)
    objective.put_best_albedo(x, np.arange(objective.pixels, dtype=np.uint64))
    if run.out_of_time():
        return run, x, False
    found, _ = refined_fit.fit(
        run,
        x,
        lambda of, free: objective_of(of, priors, free),
        solver="auto",
        start_given=True,
        asked="on" if known.refinement.refined else "off",
        hindered=None,
        turned=normals[part.valid] if known.refinement.refined else None,
    )
    return found.run, found.x, found.status is not Status.TIME_LIMIT
