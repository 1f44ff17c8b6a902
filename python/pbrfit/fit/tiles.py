"""Large pictures: lights from some of the pixels, then all pixels tile by tile.

What a fit holds beside the pictures is a few hundred bytes a pixel, and for a large picture that is
more than the pictures themselves. But lights have few unknowns: a strided subset of the pixels
finds them as well as all do. Once they are known pixels touch each other only where normals are
refined. So every s-th row and column is a small scene, which is fitted as any other; then, with its
lights, its decision on normals and its material prior held, tiles of the picture are fitted one
after the other. Where normals are refined they have a margin, which is not kept. Only the pictures
and the resulting maps are there as a whole.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pbrfit.fit import settings, uncertainty
from pbrfit.fit.normals import refined_fit
from pbrfit.fit.objective import Normalization, valid_values
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.run import FitSetup, Run, State
from pbrfit.fit.sampling import pixel_index
from pbrfit.fit.whole_picture import FitOutput, Start, fit_pixels, output_of, uncertainty_of
from pbrfit.fit.windows import Tile, Window, cut, strided_window, tiles
from pbrfit.model.materials import Materials, nearest_inside
from pbrfit.result.data import Stage, Status
from pbrfit.result.options import FitOptions
from pbrfit.result.refinement import Refinement
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array


def fit_tiles(
    scene: Scene,
    setup: FitSetup,
    start: Start,
    *,
    subset_pixels: int = settings.TILES_SUBSET_PIXELS_MAX,
    side: int = settings.TILE_SIDE,
) -> FitOutput:
    """Fit a scene: about `subset_pixels` of its pixels together, then all of them in tiles.

    Tiles have at most `side` rows and columns.
    """
    options = setup.options
    units = Normalization.of(scene, options.equal_exposures)
    subset = _fit_subset(scene, setup, units, start, subset_pixels)
    state, clock, refined = subset.state, subset.state.run, subset.refinement.refined
    seen = scene.through(clock.camera.fov_degrees, clock.camera.correction)
    layout = setup.layout(scene)
    maps = _Maps(scene, layout, uncertain=options.uncertainty)
    pieces = list(tiles(scene.valid, settings.TILE_MARGIN if refined else 0, side))
    statuses = list[Status]()
    began, passes, loss, weight = clock.elapsed, 0.0, 0.0, 0.0

    def told(recon_rmse: float) -> None:
        done = len(statuses), len(pieces)
        clock.tell(recon_rmse, lambda: (maps.materials, subset.lighting), tiles=done)

    told(clock.rows[-1].recon_rmse)
    for tile in pieces:
        found = _fit_tile(tile, subset, seen, setup, units)
        objective, x = found.run.objective, found.x
        statuses.append(found.ended[0])
        loss += objective.data_value_and_grad(x)[0] * objective.total_weight
        weight += objective.total_weight
        passes += found.run.evaluations * objective.pixels / layout.pixels
        before = time.perf_counter()
        maps.put(tile, found, state)
        clock.unmeasured += time.perf_counter() - before
        del found, objective, x  # before the next tile has its own
        told(clock.objective.residual_rmse(loss / weight))
    few = clock.objective.pixels
    note = f"{len(pieces)} tiles; lights from {few} of {layout.pixels} pixels"
    clock.stages.append(Stage("all pixels in tiles, lights held", clock.elapsed - began, note))
    clock.evaluations += round(passes)
    mean = loss / weight
    rmse = clock.objective.residual_rmse(mean)
    clock.add_row(scene, maps.materials, mean, rmse)
    return output_of(
        replace(state, ended=ending(*state.ended, statuses, options)),
        setup,
        subset.refinement,
        materials=maps.materials,
        lighting=subset.lighting,
        normals=maps.normals,
        uncertainty=None if maps.spread is None else uncertainty_of(state, maps.spread, layout),
        recon_rmse=None if setup.surrounded is None else rmse,
    )


def ending(
    status: Status, reason: str, of_tiles: list[Status], options: FitOptions
) -> tuple[Status, str]:
    """Why a tiled fit ended, from why its subset did and each of its tiles."""
    late = of_tiles.count(Status.TIME_LIMIT)
    cut_short = of_tiles.count(Status.ITERATION_LIMIT)
    if late:
        unfinished = f"{late} of {len(of_tiles)} tiles are unfinished"
        return Status.TIME_LIMIT, f"time limit of {options.time_limit:g} s reached: {unfinished}"
    if status is Status.TIME_LIMIT:
        half = f"half of the time limit of {options.time_limit:g} s"
        return status, f"{half} was not enough for lights"
    if status is Status.CONVERGED and cut_short:
        done = f"{options.iterations} iterations done"
        return Status.ITERATION_LIMIT, f"{done} in {cut_short} of {len(of_tiles)} tiles"
    return status, reason


@dataclass(frozen=True, eq=False)
class _Subset:
    """What a strided subset of the pixels found, which all others take over."""

    state: State
    """Whose run's clock goes on."""
    refinement: Refinement
    lighting: Array
    """(N, 16, 3) in picture units."""
    window: Window
    maps: Array
    """Which pixels of the picture they are, and (h, w, 8): their materials and normals, those of
    their nearest pixel that has some where one has none."""

    def nearest(self, window: Window) -> tuple[Materials, Array]:
        """Materials and normals (h, w, ...) of the subset at the pixels of another window."""
        pairs = (window.rows, self.window.rows), (window.columns, self.window.columns)
        places = [
            np.rint((np.arange(here.start, here.stop) - there.start) / there.step).clip(
                0, length - 1
            )
            for (here, there), length in zip(pairs, self.maps.shape[:2], strict=True)
        ]
        maps = self.maps[np.ix_(*(place.astype(np.intp) for place in places))]
        return Materials.of_planes(maps), maps[..., 5:]


def _fit_subset(
    scene: Scene, setup: FitSetup, units: Normalization, start: Start, pixels: int
) -> _Subset:
    """Fit about so many pixels of a scene as if they were all; `units` are those of the scene.

    Of a time limit half is left to the tiles.
    """
    window, options = strided_window(scene.valid, pixels), setup.options
    if options.time_limit is not None:
        options = replace(options, time_limit=options.time_limit / 2)
    if options.white is not None:
        (column, row, value), (rows, columns) = options.white, (window.rows, window.columns)
        place = (column - columns.start) / columns.step, (row - rows.start) / rows.step
        options = replace(options, white=(*place, value))
    if start is not None:
        materials, lights = start
        # As a whole, for a window of others may fit too.
        for name, values in vars(materials).items():
            valid_values(name, values, scene.valid)
        start = materials.each(window.of), lights
    part = cut(scene, window)
    state, refinement = fit_pixels(part, replace(setup, options=options), start, units)
    run = state.run
    materials, lighting = run.objective.unpack(state.x)
    if options.uncertainty and state.discrepancy is None:
        began = time.perf_counter()
        state = replace(state, discrepancy=state.judged())
        run.unmeasured += time.perf_counter() - began
    whole = np.dstack([materials.planes, np.asarray(run.scene.normals)])
    whole = whole[nearest_inside(window.of(scene.valid))]
    return _Subset(state, refinement, lighting, window, whole)


def _fit_tile(
    tile: Tile, subset: _Subset, scene: Scene, setup: FitSetup, units: Normalization
) -> State:
    """What is found of a tile of a scene, whose subset has found all that pixels share."""
    # Nobody reads the history of a tile, so it need not know the ground truth.
    part = replace(cut(scene, tile.outer), lighting=subset.lighting, truth=None)
    options = setup.options
    if subset.state.material is None:  # there was no time or no use for it
        options = replace(options, priors=replace(options.priors, material=0.0))
    began = setup.began + subset.state.run.unmeasured
    setup = replace(setup, options=options, progress=None, began=began)
    make = partial(setup.objective, units=units)
    objective = make(part)
    run = Run(setup, part, objective, subset.state)
    near, normals = subset.nearest(tile.outer)
    x = objective.pack(near.albedo, near.roughness, near.metallic)
    objective.put_best_albedo(x, objective.everything)
    if run.out_of_time():
        return State(run, x, ended=(Status.TIME_LIMIT, ""))
    refined = subset.refinement.refined
    start = normals[part.valid] if refined else None
    return refined_fit.fit(run, x, make, start_given=True, refines=refined, normals=start)


class _Maps:
    """Maps of a picture, NaN until their tile is done, with `spread` if somebody asked."""

    def __init__(self, scene: Scene, layout: ParameterLayout, *, uncertain: bool) -> None:
        shape = scene.valid.shape
        self.materials = Materials(
            np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
        )
        self.normals = np.array(scene.normals, dtype=np.float64)
        self.spread: uncertainty.Spread | None = None
        self._valid = scene.valid
        if uncertain:
            unknowns = layout.maps.stop // layout.pixels
            self.spread = uncertainty.Spread.empty(layout.pixels, unknowns, layout.channels)
            self._number = pixel_index(layout.valid).astype(np.int32)

    def put(self, tile: Tile, found: State, subset: State) -> None:
        """Keep what a tile found inside, with its posteriors."""
        objective, part = found.run.objective, found.run.scene
        materials, _ = objective.unpack(found.x)
        for name, values in vars(materials).items():
            tile.inner.of(getattr(self.materials, name))[...] = tile.inside.of(values)
        tile.inner.of(self.normals)[...] = tile.inside.of(part.normals)
        if self.spread is None:
            return
        spread = uncertainty.spread(objective, found.x, subset.judged(), found.posterior)
        inside = np.zeros(part.valid.shape, bool)
        tile.inside.of(inside)[...] = True
        numbers = tile.inner.of(self._number)[tile.inner.of(self._valid)]
        self.spread.put(numbers.astype(np.intp), spread, inside[part.valid])
