"""The fit of a large picture: a lattice of its pixels, then tile by tile."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import uncertainty
from pbrfit.fit.normals import refined_fit
from pbrfit.fit.objective import Normalization, Objective
from pbrfit.fit.solvers.run import Run, SharedState, material_errors
from pbrfit.fit.tiles.canvas import Canvas
from pbrfit.fit.tiles.part import Parts
from pbrfit.fit.tiles.subset_fit import Lattice, fit_lattice
from pbrfit.fit.tiles.tiling import FEW, MARGIN, THIN_MARGIN, TILE, Tile, lattice, tiles
from pbrfit.fit.tiles.total import Total
from pbrfit.fit.whole_picture import FitOutput, FitSetup, Start
from pbrfit.model.materials import Materials
from pbrfit.result.data import Stage, Status
from pbrfit.result.history import HistoryRow
from pbrfit.result.options import Priors
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]


def fit_tiles(
    scene: Scene, setup: FitSetup, start: Start, *, few: int = FEW, side: int = TILE
) -> FitOutput:
    """Fit a scene: some of its pixels together, then all of them in tiles.

    Parameters
    ----------
    few
        Pixels that find the lights, at most.
    side
        Rows and columns of a tile, at most.
    """
    from threadpoolctl import threadpool_limits

    # Sums split over threads would round differently on a machine with more processors.
    with threadpool_limits(1, user_api="blas"):
        return _fit_tiles(scene, setup, start, few, side)


def _fit_tiles(scene: Scene, setup: FitSetup, start: Start, few: int, side: int) -> FitOutput:
    units = Normalization.of(scene, setup.options.equal_exposures)
    parts = Parts(scene)
    known = fit_lattice(parts, lattice(scene.valid, few), setup, units, start)
    layout = setup.layout(scene)
    canvas = Canvas(scene, layout, uncertain=setup.options.uncertainty)
    refined = known.refinement.refined
    margin = MARGIN if setup.options.priors.smoothness or refined else THIN_MARGIN
    pieces = list(tiles(scene.valid, margin, side))
    whole = Total(scene, units, layout.channels)
    clock, late, cut_short = known.run, 0, 0
    began, passes = clock.elapsed, 0.0
    clock.tell_tile((0, len(pieces)), clock.rows[-1].recon_rmse, lambda: _maps(canvas, known))
    for number, tile in enumerate(pieces, 1):
        run, x, status = _fit_tile(tile, known, parts, setup, units, whole)
        late += status is Status.TIME_LIMIT
        cut_short += status is Status.ITERATION_LIMIT
        canvas.put(tile, run.scene, run.objective.unpack(x)[0])
        whole.add(run.objective, x)
        passes += run.evaluations * run.objective.pixels / whole.pixels
        if setup.options.uncertainty:
            before = time.perf_counter()
            canvas.put_variances(
                tile, run.scene, uncertainty.variances(run.objective, x, known.modes)
            )
            clock.unmeasured += time.perf_counter() - before
        del run, x  # before the next tile has its own
        clock.tell_tile((number, len(pieces)), whole.rmse, lambda: _maps(canvas, known))
    clock.stages.append(
        Stage(
            "all pixels in tiles, lights held",
            clock.elapsed - began,
            f"{len(pieces)} tiles; lights from {known.pixels} of {layout.pixels} pixels",
        )
    )
    clock.evaluations += round(passes)
    seconds = clock.elapsed
    errors = {}
    if scene.truth is not None:
        errors = material_errors(canvas.materials, scene.truth.materials)
    clock.rows.append(
        HistoryRow(seconds, clock.iteration, clock.evaluations, whole.mean, whole.rmse, **errors)
    )
    status, reason = known.status, known.reason
    if late:
        status = Status.TIME_LIMIT
        reason = (
            f"time limit of {setup.options.time_limit:g} s reached: {late} of {len(pieces)} tiles "
            "are unfinished"
        )
    elif status is Status.TIME_LIMIT:
        reason = (
            f"half of the time limit of {setup.options.time_limit:g} s was not enough for lights"
        )
    elif status is Status.CONVERGED and cut_short:
        status = Status.ITERATION_LIMIT
        reason = f"{setup.options.iterations} iterations done in {cut_short} of {len(pieces)} tiles"
    deviations = None
    if canvas.variances is not None:
        deviations = uncertainty.of_variances(
            canvas.variances,
            layout,
            known.modes,
            samples=whole.samples,
            scale=units.scale,
            priors=setup.options.priors != Priors.none(),
        )
    return FitOutput(
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


def _maps(canvas: Canvas, known: Lattice) -> tuple[Materials, Array]:
    return canvas.materials, known.lighting


def _fit_tile(
    tile: Tile, known: Lattice, parts: Parts, setup: FitSetup, units: Normalization, whole: Total
) -> tuple[Run, Array, Status]:
    """The run of a tile, its x, and why it ended; `whole` is of the scene."""
    # Nobody reads the history of a tile, so it need not know the truth.
    part = replace(parts.cut(tile.outer, known.lighting), truth=None)
    near, normals = known.near.at(tile.outer)
    priors, taught = _of_part(known, Total(part, units, whole.channels), whole)
    setup = replace(setup, options=replace(setup.options, priors=priors), progress=None)

    def objective_of(of: Scene, free_normals: bool) -> Objective:
        objective = setup.objective(of, free_normals=free_normals, units=units)
        if not free_normals:
            objective.penalties += taught.penalties(objective.layout)
        return objective

    objective = objective_of(part, False)
    run = setup.run(part, objective, taught)
    run.unmeasured = known.run.unmeasured
    x = objective.pack(near.albedo, near.roughness, near.metallic)
    objective.put_best_albedo(x, np.arange(objective.pixels, dtype=np.uint64))
    if run.out_of_time():
        return run, x, Status.TIME_LIMIT
    found, _ = refined_fit.fit(
        run,
        x,
        objective_of,
        start_given=True,
        asked="on" if known.refinement.refined else "off",
        hindered=None,
        turned=normals[part.valid] if known.refinement.refined else None,
    )
    return found.run, found.x, found.status


def _of_part(known: Lattice, part: Total, whole: Total) -> tuple[Priors, SharedState]:
    """What a part's priors and penalties weigh, so that they are as strong as in the whole.

    The data term is a mean by weight. Beside that of the whole, smoothness is a sum, and sparsity
    and cohesion are means over pixels, which may have more or less weight here than elsewhere.
    """
    share = part.weight / whole.weight
    density = share / (part.pixels / whole.pixels)
    taught = known.taught
    if taught.cohesion is not None:
        means, weight = taught.cohesion
        taught = replace(taught, cohesion=(means, weight / density))
    priors = replace(
        known.priors,
        smoothness=known.priors.smoothness / share,
        sparsity=known.priors.sparsity / density,
        cohesion=0.0,  # means of segments are held, so it is a pull that was taught
    )
    return priors, taught
