"""The fit of a strided subset of the pixels, and what all others take over from it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.estimator import discrepancy_of
from pbrfit.fit.objective import Normalization, Objective, valid_values
from pbrfit.fit.run import Run, SharedState
from pbrfit.fit.tiles.maps import NearestMaps
from pbrfit.fit.tiles.windows import SceneCutter, Window, cut_maps
from pbrfit.fit.whole_picture import FitSetup, Start, fit_pixels
from pbrfit.model.materials import Materials
from pbrfit.result.data import Status
from pbrfit.result.options import Priors
from pbrfit.result.refinement import Refinement

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SubsetResult:
    """What a subset of the pixels found."""

    run: Run
    """Whose clock goes on."""
    status: Status
    reason: str
    pixels: int
    """How many there are."""
    lighting: Array
    """(N, 16, 3) in picture units."""
    refinement: Refinement
    shared_state: SharedState
    priors: Priors
    """What tiles have in common, and the priors that they have then."""
    nearest: NearestMaps
    """Materials and normals to start from."""


def fit_subset(
    cutter: SceneCutter, window: Window, setup: FitSetup, units: Normalization, start: Start
) -> SubsetResult:
    """Fit the pixels of a window of a scene as if they were all.

    `units` are those of the scene. Of a time limit half is left to the tiles.
    """
    options = setup.options
    if options.time_limit is not None:
        setup = replace(setup, options=replace(options, time_limit=options.time_limit / 2))
    if options.white is not None:
        setup = replace(setup, options=replace(setup.options, white=window.place(*options.white)))
    whole, scene = cutter.scene, cutter.cut(window)
    if start is not None:
        start = _of_window(start, window, whole.valid)
    found, refinement = fit_pixels(scene, setup, start, units)
    run, x = found.run, found.x
    objective = run.objective
    materials, lighting = objective.unpack(x)
    if setup.options.uncertainty and run.discrepancy is None:
        began = time.perf_counter()
        run.discrepancy = discrepancy_of(run, objective, x)
        run.unmeasured += time.perf_counter() - began
    material, priors = None, setup.options.priors
    if run.fitted_prior is not None:
        material = run.fitted_prior
    else:  # the subset had no time or no use for the fitted prior: tiles have none either
        priors = replace(priors, material=0.0)
    return SubsetResult(
        run=run,
        status=found.status,
        reason=found.reason,
        pixels=objective.pixels,
        lighting=lighting,
        refinement=refinement,
        shared_state=SharedState(
            material=material,
            robust=objective.robust,
            noise=run.noise,
            discrepancy=run.discrepancy,
            cohesion=_segment_means(objective, x, priors.cohesion),
        ),
        priors=priors,
        nearest=NearestMaps(window, whole.valid, materials, np.asarray(run.scene.normals)),
    )


def _of_window(
    start: Materials | tuple[Materials, Array], window: Window, valid: NDArray[np.bool_]
) -> Materials | tuple[Materials, Array]:
    """What a window has of a start, which is checked as a whole: a window of others may fit too."""
    materials = start if isinstance(start, Materials) else start[0]
    for name in ("albedo", "roughness", "metallic"):
        valid_values(name, getattr(materials, name), valid)
    part = cut_maps(materials, window)
    return part if isinstance(start, Materials) else (part, start[1])


def _segment_means(objective: Objective, x: Array, weight: float) -> tuple[Array, float] | None:
    """As `SharedState.cohesion`; NaN for segments that none of these pixels is in."""
    layout = objective.layout
    if not weight or layout.segments is None:
        return None
    length = layout.segment_count + 1
    counts = np.bincount(layout.segments, minlength=length)
    with np.errstate(invalid="ignore"):
        means = [
            np.bincount(layout.segments, weights=x[block], minlength=length) / counts
            for block in layout.roughness_metallic
        ]
    return np.stack(means, axis=-1), weight
