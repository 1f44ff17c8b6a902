"""Maps that another tool, such as a network, estimated: evidence beside the pictures.

A network knows what materials look like, and errs alike over whole objects; pictures tell what
reflects how, but take shadows and light between surfaces for material where no depth tells these.
So both are measurements of one surface, each with its error.

**Roughness and metallic** v of a pixel are n ± σ by the network, E = exp(−Σ (n − v)²/2σ²). As its
error is one over a whole object, many pixels know no more than one: the mean of E over a segment
multiplies the distribution from which that of the segment is fitted (`priors.posterior`), and E
itself the posterior of a pixel without a segment.

**Albedo** has relative errors, so that it is compared in logarithms: ln A ± s by the pictures,
where s is the deviation of the result, and ln M ± τ by the network. What the difference has in
common over the picture, m, is a measurement of its own, of the brightness of a channel, with the
deviations s₀ and τ₀. By inverse variances

    ln a = ln A + k₀ m + k (ln M − ln A − m)      k = s²/(s² + τ²)      k₀ = s₀²/(s₀² + τ₀²)

with the variance (1 − k) s² + (1 − k₀) s₀², and as many times that as the differences are larger
than s² + τ² (R. Birge, Physical Review 40, 1932). Where pictures tell albedo, s is small, and the
network changes nothing.

**Maps of another picture** would be as sure of themselves. So they are held against the pictures
first (`mismatch`).
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.objective import Objective
from pbrfit.fit.sampling import Pixels
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.model.estimates import reduced
from pbrfit.model.materials import Materials
from pbrfit.result.options import FitOptions
from pbrfit.result.uncertainty import TWO_SIDED, Uncertainty
from pbrfit.result.verdict import by_deviations
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array

log = logging.getLogger("pbrfit")


FINISH_SIGMA = 0.2
"""σ. Networks that are trained on interiors publish errors of roughness of about .2."""

ALBEDO_SIGMA, BRIGHTNESS_SIGMA = 0.3, 0.2
"""τ and τ₀: published errors of 18 to 20 dB are .10 to .13, at a mean albedo of .35."""

DARKEST = 0.02
"""Albedo of soot, added before logarithms: hardly anything is darker."""

COMPARED_SIDE = 256
"""Longer side in pixels at which slopes are compared."""

CORRELATION_MIN = 0.25
"""Of slopes: with a network's errors .74 to .96, of other rooms from the same place at most .20."""


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

    Slopes of ln albedo and of the logarithm of the mean picture are correlated where both show the
    same view: most edges are of paint. Maps of another view may have edges in the same places, as
    those of rooms, but then brighter and darker are on other sides.
    """
    assert scene.estimates is not None
    size = reduced_size(scene.valid.shape, COMPARED_SIDE)
    estimates, total = scene.estimates, np.zeros((*size, 3))
    if not np.isfinite(estimates.albedo).any():
        return "there is no albedo among them, by which they are held against the pictures"
    for i in range(len(scene.images)):
        picture = scene.picture(i, slice(None))
        used = scene.valid[..., None] & np.isfinite(picture)
        total += averaged_channels(np.where(used, picture, 0.0), size)
    if size != scene.valid.shape:
        estimates = reduced(estimates, size)
    inside = averaged(scene.valid.astype(np.float64), size) > 0.5
    shown = np.where(inside[..., None], np.maximum(total, 0), np.nan)
    logarithms = np.log(shown / np.nanmean(shown) + DARKEST), np.log(estimates.albedo + DARKEST)
    one, other = (np.stack(np.gradient(of, axis=(0, 1))) for of in logarithms)
    both = np.isfinite(one) & np.isfinite(other)
    sizes = np.linalg.norm(one[both]) * np.linalg.norm(other[both])
    alike = float(one[both] @ other[both]) / max(float(sizes), np.finfo(np.float64).tiny)
    if alike >= CORRELATION_MIN:
        return ""
    why = f"their edges and those of the pictures have a correlation of {alike:.2f}"
    return f"{why} (at least {CORRELATION_MIN}), so they seem to be of another view"


def evidence(objective: Objective, pixels: Pixels, nodes: Array) -> NDArray[np.float32]:
    """E of some pixels at roughness and metallic of nodes (K, 2): (Q, K); (Q, 1) of 1 without any.

    What is unknown adds nothing.
    """
    found = objective.estimated_finish(pixels)
    if found is None:
        return np.ones((len(pixels), 1), np.float32)
    total = np.zeros((len(pixels), len(nodes)), np.float32)
    for values, of_nodes in zip(found.T, nodes.T, strict=True):
        off = np.subtract.outer(values, of_nodes) / FINISH_SIGMA
        total -= np.nan_to_num(off * off / 2).astype(np.float32)
    return np.exp(total)


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
