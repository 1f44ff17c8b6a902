"""Maps that another tool, such as a network, estimated: evidence beside the pictures.

A network knows what materials look like, and errs alike over whole objects; pictures tell what
reflects how, but take shadows and light between surfaces for material where no depth tells these.
So both are measurements of one surface, each with its error.

**Roughness and metallic** v of a pixel are n ± σ by the network, which multiplies the likelihood of
each node of the material prior's grid by exp(−Σ (n − v)²/2σ²) (`squares`).

**Albedo** has relative errors, so that it is compared in logarithms: ln A ± s by the pictures,
where s is the deviation of the result, and ln M ± τ by the network. What the difference has in
common over the picture, m, is a measurement of its own, of the brightness of a channel, with the
deviations s₀ and τ₀. By inverse variances

    ln a = ln A + k₀ m + k (ln M − ln A − m)      k = s²/(s² + τ²)      k₀ = s₀²/(s₀² + τ₀²)

with the variance (1 − k) s² + (1 − k₀) s₀², and as many times that as the differences are larger
than s² + τ² (R. Birge, Physical Review 40, 1932). Where pictures tell albedo, s is small, and the
network changes nothing.

**Maps of another picture** would be as sure of themselves. So edges of the maps have to lie where
the pictures have some, better than after any of 63 displacements (`mismatch`).
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.objective import Objective
from pbrfit.io.resampling import averaged, reduced_size
from pbrfit.model.materials import Materials
from pbrfit.result.options import FitOptions
from pbrfit.result.uncertainty import TWO_SIDED, Uncertainty
from pbrfit.result.verdict import by_deviations
from pbrfit.scene.estimates import known_maps, reduced
from pbrfit.scene.scene import Scene

log = logging.getLogger("pbrfit")

Array = NDArray[np.float64]

FINISH_SIGMA = 0.2
"""σ. Networks that are trained on interiors publish errors of roughness of about .2."""

ALBEDO_SIGMA, BRIGHTNESS_SIGMA = 0.3, 0.2
"""τ and τ₀: published errors of 18 to 20 dB are .10 to .13, at a mean albedo of .35."""

DARKEST = 0.02
"""Albedo of soot, added before logarithms: hardly anything is darker."""

COMPARED_SIDE, DISPLACEMENTS = 256, 8
"""Longer side in pixels at which edges are compared, and displacements along each side."""


def used(scene: Scene, options: FitOptions) -> tuple[Scene, FitOptions]:
    """The scene and options of a fit that has its estimates as evidence, or none if they mismatch.

    Roughness and metallic are evidence by way of the material prior, albedo by its deviations, so
    that both are found unless the prior is ruled out by the options.
    """
    if scene.estimates is None:
        return scene, options
    why = mismatch(scene)
    if why:
        log.warning("estimates: not used: %s", why)
        assumed = {**scene.assumed, "estimates": f"not used: {why}"}
        return replace(scene, estimates=None, assumed=assumed), options
    priors = replace(options.priors, material=options.priors.material_strength)
    return scene, replace(options, priors=priors, uncertainty=True)


def mismatch(scene: Scene) -> str:
    """Why the scene's estimates do not show its pictures, in words; empty if they do.

    The sum of products of edges, square roots of slopes, of the mean picture and of the maps is to
    be larger than with the maps displaced, of which those of another picture are one.
    """
    assert scene.estimates is not None
    size = reduced_size(scene.valid.shape, COMPARED_SIDE)
    estimates, total = scene.estimates, np.zeros(size)
    for i in range(len(scene.images)):
        picture = scene.picture(i, slice(None)).mean(axis=-1, dtype=np.float64)
        total += averaged(np.where(scene.valid & np.isfinite(picture), picture, 0.0), size)
    if size != scene.valid.shape:
        estimates = reduced(estimates, size)
    inside = averaged(scene.valid.astype(np.float64), size) > 0.5
    shown = np.where(inside, np.maximum(total, 0), np.nan)
    of_pictures = _edges(np.log(shown / np.nanmean(shown) + DARKEST))
    of_maps = np.zeros(size)
    for plane in known_maps(estimates).values():
        for channel in np.moveaxis(np.atleast_3d(plane).astype(np.float64), -1, 0):
            edges = np.nan_to_num(_edges(channel))
            of_maps += edges / max(float(edges.std()), np.finfo(np.float64).tiny)
    known = np.isfinite(of_pictures)
    wanted = of_pictures[known] - of_pictures[known].mean()

    def alike(down: int, right: int) -> float:
        edges = np.roll(of_maps, (down, right), axis=(0, 1))[known]
        edges -= edges.mean()
        return float(wanted @ edges) / max(float(np.linalg.norm(edges)), np.finfo(np.float64).tiny)

    rows, columns = ([i * side // DISPLACEMENTS for i in range(DISPLACEMENTS)] for side in size)
    given, *displaced = (alike(down, right) for down in rows for right in columns)
    if given > max(displaced):
        return ""
    return "their edges are not where the pictures have some, so they seem to be of another view"


def _edges(plane: Array) -> Array:
    """(H, W): the square root of the slope's length, NaN where a neighbour is unknown."""
    return np.asarray(np.sqrt(np.hypot(*np.gradient(plane))))


def squares(objective: Objective, pixels: NDArray[np.uint64], nodes: Array) -> Array | None:
    """Σ (n − v)²/σ² of some pixels at roughness and metallic v of nodes (K, 2): (Q, K); or None.

    What is unknown adds nothing; without estimates there are none.
    """
    found = objective.estimated_finish(pixels)
    if found is None:
        return None
    off = (found[:, None] - nodes) / FINISH_SIGMA
    return np.asarray(np.nansum(off * off, axis=-1))


def fused(
    materials: Materials, uncertainty: Uncertainty, estimates: Materials, *, grey: bool
) -> tuple[Materials, Uncertainty]:
    """Materials with the albedo of both, and their uncertainty; estimates lose colour if `grey`."""
    given = estimates.albedo.astype(np.float64)
    if grey:
        given = np.broadcast_to(given.mean(axis=-1, keepdims=True), given.shape)
    inside = np.isfinite(materials.roughness)
    own = materials.albedo[inside].astype(np.float64) + DARKEST
    off = np.log(given[inside] + DARKEST) - np.log(own)
    known = np.isfinite(off)
    if not known.any():
        return materials, uncertainty
    common = np.square(uncertainty.albedo_scale)
    variance = np.square(uncertainty.deviation.albedo[inside] / own) - common
    variance = np.maximum(variance, 0.0)
    total = variance + ALBEDO_SIGMA**2
    mean = np.sum(off / total, axis=0, where=known) / np.sum(1 / total, axis=0, where=known)
    off = np.where(known, off - mean, 0.0)
    larger = np.maximum(np.sum(off**2 / total, axis=0) / known.sum(axis=0), 1.0)
    share = np.where(known, variance / total, 0.0)
    of_common = common / (common + BRIGHTNESS_SIGMA**2)
    value = np.clip(own * np.exp(of_common * mean + share * off) - DARKEST, 0, 1)
    common = common * (1 - of_common)
    sigma = (value + DARKEST) * np.sqrt(larger * (1 - share) * variance + common)

    def whole(values: Array) -> Array:
        found = np.full(given.shape, np.nan)
        found[inside] = np.clip(values, 0, 1)
        return found

    red, green, blue = np.sqrt(common).tolist()
    deviation = replace(uncertainty.deviation, albedo=whole(sigma))
    return replace(materials, albedo=whole(value)), replace(
        uncertainty,
        deviation=deviation,
        low=replace(uncertainty.low, albedo=whole(value - TWO_SIDED * sigma)),
        high=replace(uncertainty.high, albedo=whole(value + TWO_SIDED * sigma)),
        albedo_scale=(red, green, blue),
        verdicts=by_deviations(deviation),
    )
