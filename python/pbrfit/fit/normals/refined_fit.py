"""A fit whose normals are refined: in which order, and what is kept of it.

Whether they are is decided by left-out pictures (`pbrfit.fit.compare`), or asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.coarse import Lights, rounds
from pbrfit.fit.estimator import find_lights, solve
from pbrfit.fit.levels import Level
from pbrfit.fit.light_modes import light_modes
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.normals.all_pixels import (
    refine_all,
    start_from_level,
    start_from_offsets,
    tangent_offsets_between,
)
from pbrfit.fit.normals.free import FreeNormals
from pbrfit.fit.normals.offset_prior import Neighbourhood, TangentOffsetPrior
from pbrfit.fit.nuisances import FIELD_OF_VIEW, Nuisances
from pbrfit.fit.objective import Objective
from pbrfit.fit.run import Run, State
from pbrfit.fit.sampling import pixel_index
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]

OUT_OF_TIME = "the time limit came first"


@dataclass(frozen=True, eq=False)
class Found:
    """Normals and lights of all pixels, on which the material prior has no influence."""

    run: Run
    """That goes on, through the camera that was found."""
    free: Objective
    x: Array
    """Of `free`."""
    noise: NoiseModel | None


def fit(
    run: Run,
    x: Array,
    make: Callable[[Scene, bool], Objective],
    *,
    start_given: bool,
    refines: bool,
    normals: Array | None = None,
) -> State:
    """What is found from x, with refined normals if so asked and there is time.

    `make` gives the objective of a scene, with free normals or without. From `normals` (P, 3)
    pixels may start, beside the given ones.
    """
    found = find(run, x, make, normals) if refines and run.left > 0 else None
    if found is None:
        return solve(run, x.copy(), start_given=start_given)
    return fit_held(found, make)


def find(
    run: Run, x: Array, make: Callable[[Scene, bool], Objective], normals: Array | None = None
) -> Found | None:
    """Refined normals from x, as `fit`; None if time ran out."""
    noise, refining = None, run
    if run.shared is not None:  # a tile of a picture whose subset has found the rest
        noise = run.shared.noise
    elif run.camera.how == "assumed":
        find_lights(run, x)  # and a field of view, with the given normals
    free = make(run.scene, True)
    free_x, offsets = _start(run, x, free, normals)
    if run.shared is None:
        offsets, found, nuisances = _find_normals(run, free, free_x, offsets)
        noise = found.noise
        if nuisances is not None:
            refining = run.continued(nuisances.scene, free)
            refining.see(nuisances)
    with refining.stage("normals of all pixels"):
        if not refine_all(free, free_x, offsets, noise, refining.out_of_time):
            return None
    return Found(refining, free, free_x, noise)


def _start(
    run: Run, x: Array, free: Objective, normals: Array | None
) -> tuple[Array, TangentOffsetPrior]:
    """X of the objective with free normals, from that with held ones, and the offsets' prior."""
    scene, layout, held = run.scene, free.layout, run.objective.layout
    given, sigma = _given(scene)
    start = free.start()
    start[layout.materials] = x[held.materials]
    start[layout.maps.stop :] = x[held.maps.stop :]
    if normals is not None:
        start_from_offsets(free, start, tangent_offsets_between(given, normals))
    return start, TangentOffsetPrior(Neighbourhood.of(pixel_index(layout.valid), given, sigma))


def _given(scene: Scene) -> tuple[Array, Array | None]:
    """Normals (P, 3), and how unsure they are (P,), if it is known."""
    normals = np.asarray(scene.normals, dtype=np.float64)[scene.valid]
    if scene.normal_sigma is None:
        return normals, None
    return normals, scene.normal_sigma[scene.valid].astype(np.float64)


def _find_normals(
    run: Run, free: Objective, x: Array, prior: TangentOffsetPrior
) -> tuple[TangentOffsetPrior, Lights, Nuisances | None]:
    """The prior on offsets as a level found it, and what is left of that; x has what it found.

    A field of view that nobody told is fitted with the normals once more, for it was found with the
    given ones.
    """
    with run.stage("lights and normals") as notes:
        level = Level.of(free, settings.COARSE_PIXELS)
        chosen = level.pixels.astype(np.intp)
        given, sigma = _given(run.scene)
        sigma = None if sigma is None else sigma[chosen]
        nuisances = Nuisances(run.scene, [FIELD_OF_VIEW]) if run.camera.how == "fitted" else None
        for at_most in settings.NORMALS_ROUNDS_OF_PASSES:
            of_level = FreeNormals.of(level, given[chosen], sigma)
            part = free.part_of(x, level.pixels)
            found = rounds(run, level, part, x, of_level, at_most=at_most, nuisances=nuisances)
            x[free.layout.maps.stop :] = part[level.objective.layout.maps.stop :]
            if found.cut_short:
                break
        start_from_level(free, x, level, part)
        notes += [f"{len(level.pixels)} pixels", found.misfit.in_words()]
        if nuisances is not None:
            notes.append(f"field of view {nuisances.camera(run.camera).in_words()}")
    return replace(prior, sigma=of_level.offsets.sigma), found, nuisances


def fit_held(found: Found, make: Callable[[Scene, bool], Objective]) -> State:
    """What is found with all priors, by normals that were found."""
    free, free_x = found.free, found.x.copy()
    state = _fit_held(found.run, free, free_x, make)
    run, ended = state.run, state.ended
    if run.out_of_time():  # perhaps after the fit that has ended
        ended = run.ended("")
    if run.objective.lighting is None and free.lighting is not None:
        without_lights = replace(run.scene, lighting=None)
        run = run.continued(without_lights, make(without_lights, False))
    return replace(state, run=run, x=_held_x(free, free_x, run.objective), ended=ended)


def _fit_held(
    run: Run, free: Objective, free_x: Array, make: Callable[[Scene, bool], Objective]
) -> State:
    """What is found with all priors, normals and lights held at those of an x of `free`.

    That x changes. Lights are held because a fit to held normals that are a degree off takes
    blurred highlights for weak ones, and makes lights 2 to 12 % too bright and albedo too dark.
    Those of the joint steps, whose normals move along, are not bent so. But joint steps know
    squares only: where more was asked of lights, they are fitted once more.
    """
    scene, modes = replace(run.scene, normals=free.layout.whole(free.normals(free_x))), None
    if free.lighting is not None:
        of_lights = make(scene, False)
        if free.sample_weights is not None:
            of_lights = of_lights.weighed(free.sample_weights)
        held_x = _held_x(free, free_x, of_lights)
        modes = light_modes(of_lights, held_x)
        if not run.options.priors.monochrome:
            scene = replace(scene, lighting=free.unpack(free_x)[1])
    objective = make(scene, False)
    run = run.continued(scene, objective, light_modes=modes)
    state = solve(run, _held_x(free, free_x, objective), start_given=True)
    free_x[free.layout.materials] = state.x[objective.layout.materials]
    if objective.lighting is not None:
        free_x[free.layout.maps.stop :] = state.x[objective.lighting]
    return state


def _held_x(free: Objective, free_x: Array, held: Objective) -> Array:
    """What an objective with held normals, and perhaps lights, has of an x of `free`."""
    materials = free_x[free.layout.materials]
    if held.lighting is None:
        return materials.copy()
    return np.concatenate([materials, free_x[free.layout.lighting]])
