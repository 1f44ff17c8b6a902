"""A fit whose normals are refined together with materials and lights, if it is asked for.

Normals of an estimator are ten degrees off and more, and every wrong normal bends its material and
the lights. Pictures under several lights know better: a pixel has a number a picture and channel,
and with its normal seven unknowns. A normal is unknown as its tangent offset (a, b): it is along
n₀ + a t₁ + b t₂, with tangents t at the given normal n₀ (docs/model.md).

1. The coarse level (`pbrfit.fit.coarse.rounds`) finds lights and normals from the given ones, with
   the priors of `pbrfit.fit.normals.prior`.
2. All pixels change their normals in these lights, each by itself, with a prior around where its
   neighbours are. These are seen where they were before, so the prior is made anew a few times.
   Lights stay: what the two numbers more of each pixel take up of the noise would bend them,
   however many pixels there are.
3. A fit with these normals and lights held (`pbrfit.fit.estimator`) finds materials with all
   priors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.fit import settings
from pbrfit.fit.coarse import Lights, rounds
from pbrfit.fit.discrepancy import light_modes
from pbrfit.fit.estimator import find_lights, solve
from pbrfit.fit.levels import Level
from pbrfit.fit.noise import NoiseModel
from pbrfit.fit.normals.prior import (
    FreeNormals,
    Neighbourhood,
    TangentOffsetPrior,
    noise_variance,
    offset_variances,
    offsets_of,
    pixel_sums,
)
from pbrfit.fit.nuisances import Nuisances
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import fit_all, place, taken
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.run import Run, State
from pbrfit.fit.sampling import pixel_index
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array

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
        nuisances = Nuisances(run.scene) if run.camera.how == "fitted" else None
        for at_most in (settings.NORMALS_DIELECTRIC_ROUNDS, settings.COARSE_ROUNDS_MAX):
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
    """What is found with all priors, normals and lights held at those that were found.

    Lights are held because a fit to held normals that are a degree off takes
    blurred highlights for weak ones, and makes lights 2 to 12 % too bright and albedo too dark.
    Those of the joint steps, whose normals move along, are not bent so. But joint steps know
    squares only: where more was asked of lights, they are fitted once more.
    """
    run, free, free_x = found.run, found.free, found.x
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
    if run.out_of_time():  # perhaps after the fit that has ended
        state = replace(state, ended=run.ended(""))
    if objective.lighting is not None or free.lighting is None:
        return state
    without_lights = replace(run.scene, lighting=None)
    run = run.continued(without_lights, make(without_lights, False))
    return replace(state, run=run, x=np.concatenate([state.x, free_x[free.layout.lighting]]))


def _held_x(free: Objective, free_x: Array, held: Objective) -> Array:
    """What an objective with held normals, and perhaps lights, has of an x of `free`."""
    materials = free_x[free.layout.materials]
    if held.lighting is None:
        return materials.copy()
    return np.concatenate([materials, free_x[free.layout.lighting]])


def tangent_offsets_between(given: Array, changed: Array) -> Array:
    """Tangent offsets (P, 2) that change unit normals (P, 3) into others.

    n is along n₀ + a t₁ + b t₂ with tangents at n₀ that are unit vectors at right angles, so that
    a = n·t₁ / n·n₀ and b = n·t₂ / n·n₀.
    """
    x, y, z = given.T
    mirrored = z <= -0.99  # tangents are those of the mirror image (docs/model.md)
    upper = np.where(mirrored, -z, z)
    first = np.stack([1 - x**2 / (1 + upper), -x * y / (1 + upper), -x], axis=-1)
    second = np.stack([-x * y / (1 + upper), 1 - y**2 / (1 + upper), -y], axis=-1)
    for tangent in (first, second):
        tangent[mirrored, 2] *= -1
    cosine = np.maximum(np.einsum("pi,pi->p", given, changed), 0.1)  # else it grows without bound
    return np.stack(
        [np.einsum("pi,pi->p", changed, tangent) / cosine for tangent in (first, second)], axis=-1
    )


def start_from_level(objective: Objective, x: Array, level: Level, part: Array) -> None:
    """Give all pixels the unknowns of a level's nearest one, and its lights; x changes.

    `part` is x of the level.
    """
    from scipy.spatial import KDTree

    layout, of_level = objective.layout, level.objective.layout
    places = np.argwhere(layout.valid)
    _, nearest = KDTree(places[level.pixels.astype(np.intp)]).query(places)
    place(objective, x, slice(None), taken(level.objective, part, np.asarray(nearest, np.uint64)))
    x[layout.maps.stop :] = part[of_level.maps.stop :]


def start_from_offsets(objective: Objective, x: Array, offsets: Array) -> None:
    """Give pixels these tangent offsets (P, 2) where they explain more than those of x; x changes.

    Each with its best albedo, and roughness and metallic as they are.
    """
    assert objective.tangent_offsets is not None
    before = objective.put_best_albedo(x, objective.everything)
    other = x.copy()
    other[objective.tangent_offsets] = offsets.T.ravel()
    after = objective.put_best_albedo(other, objective.everything)
    better = np.flatnonzero(after < before).astype(np.uint64)
    place(objective, x, better, taken(objective, other, better))


def refine_all(
    objective: Objective,
    x: Array,
    prior: TangentOffsetPrior,
    noise: NoiseModel | None,
    stop: Callable[[], bool],
) -> bool:
    """Change the normals of all pixels, with their materials; x changes. False if time ran out.

    Samples weigh by their `noise`, of which outliers show once pixels are fitted.
    """
    layout = objective.layout
    assert layout.tangent_offsets is not None
    for number in range(settings.WEIGHT_ROUNDS):
        if noise is not None:
            weights = noise.weights(objective, x if number else None, first=number == 1)
            objective.adopt(objective.weighed(weights))
        offsets = offsets_of(objective, x)
        variance = noise_variance(objective, pixel_sums(objective, x))
        offset_mean, offset_precision = prior.conditional(offsets, variance)
        free = np.zeros((len(offsets), len(layout.roughness_metallic)))
        pixel_prior = GaussianPrior(
            np.concatenate([free, offset_mean], axis=1),
            np.concatenate([free, offset_precision], axis=1),
        )
        starts, steps = (0, 0) if number else (1, settings.DESCENT_STEPS)
        if fit_all(objective, x, starts=starts, steps=steps, prior=pixel_prior, stop=stop) is None:
            return False
        left = offset_variances(objective, x, pixel_prior.precision, variance)
        prior = prior.fitted(offsets_of(objective, x), left)
    return True
