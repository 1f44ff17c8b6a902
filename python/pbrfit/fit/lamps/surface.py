"""Normals and albedo of all pixels, and colours of lamps, from pseudo-normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pbrfit.fit.lamps.cues import unit_and_length
from pbrfit.fit.lamps.photometric import PseudoNormals
from pbrfit.fit.lamps.places import KNOWN_MIN
from pbrfit.fit.lamps.samples import Samples, some_of
from pbrfit.fit.lamps.strengths import color_of_lamps

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COLORED_MAX = 20_000
"""Pixels that the lamps' colours are found from."""

RADII = (3.0, 12.0, 48.0)
"""Standard deviations in pixels of the mean normal around a pixel that does not know its own."""

ENOUGH = 0.05
"""Share of known pixels, by the weights of that mean, from which on it is taken."""


@dataclass(frozen=True, eq=False)
class LampStart:
    """Where a fit with lamps begins.

    Attributes
    ----------
    normals
        (H, W, 3) unit vectors in camera space, NaN outside the mask.
    albedo
        (H, W, 3) linear, up to a factor for each channel; NaN outside the mask.
    directions
        (N, 3) unit vectors from the scene to the lamps.
    strengths
        (N, 3) linear, such that a sample is albedo times strength times max(n·l, 0).
    weights
        (N, H, W) in [0, 1], how far each sample follows this law: small in highlights and shadows.
    known
        (H, W), True where the pixel's own samples tell its normal.
    figures
        What each step and each cue said.
    undetermined
        Sentences on what is not determined; empty if nothing is known of that kind.
    """

    normals: Array
    albedo: Array
    directions: Array
    strengths: Array
    weights: Array
    known: Mask
    figures: dict[str, float]
    undetermined: tuple[str, ...]


def finished(
    data: Samples,
    views: Array,
    found: PseudoNormals,
    lamps: Array,
    figures: dict[str, float],
    undetermined: tuple[str, ...],
    rough: Array | None = None,
) -> LampStart:
    """Normals, albedo and colours from pseudo-normals under lamps, directions times strengths.

    A pixel whose samples tell little, because most are in shadow, leans on the mean normal of those
    around it: b is the most likely one if beside its own samples it is normal about that one, with
    a precision that is a small part of what pixels know on the whole.
    """
    information, axes = np.linalg.eigh(found.precision)
    told = information[:, 0]
    # Where lamps lie in a plane no sample tells the third part: the least that is told counts.
    medians = np.median(information, axis=0)
    lean = KNOWN_MIN * float(medians[medians > 1e-6 * medians[2]].min(initial=np.inf))
    lean = lean if np.isfinite(lean) else 1.0
    known = told > lean
    unit, albedo = unit_and_length(found.vectors)
    if rough is None:
        certain = known if known.any() else np.ones_like(known)
        around = _around(data, np.where(certain[:, None], unit, 0.0), views)
    else:
        around = rough[data.where]
    typical = np.where(known, albedo, data.brightness)
    expected = np.einsum("pji,pj->pi", axes, typical[:, None] * around)
    own = np.einsum("pji,pj->pi", axes, found.vectors)
    precision = np.maximum(information, 0.0)
    mixed = (precision * own + lean * expected) / (precision + lean)
    vectors = np.where(known[:, None], found.vectors, np.einsum("pij,pj->pi", axes, mixed))
    unit, _ = unit_and_length(vectors)
    along, strengths = unit_and_length(lamps)
    shading = np.maximum(unit @ along.T, 0.0)
    some = some_of(len(unit), COLORED_MAX)
    of_values = found.weights[..., None] * data.told
    _, colors = color_of_lamps(data.colors[some], shading[some], of_values[some], strengths)
    planes = _albedo(data.colors, shading, of_values, colors)
    weights = np.zeros((data.pictures, *data.mask.shape))
    weights[:, data.mask] = found.weights.T
    return LampStart(
        normals=data.plane(unit, np.nan),
        albedo=data.plane(planes, np.nan),
        directions=along,
        strengths=colors,
        weights=weights,
        known=data.plane(known.astype(np.float64), 0.0).astype(bool),
        figures={**figures, "share of pixels that tell their normal": float(known.mean())},
        undetermined=undetermined,
    )


def _around(data: Samples, unit: Array, views: Array) -> Array:
    """Mean normal (P, 3) around each pixel, of `unit`, which is 0 where there is none."""
    found = views[data.where].astype(np.float64)
    plane = data.plane(unit, 0.0)
    weight = np.einsum("hwi,hwi->hw", plane, plane)
    for radius in RADII[::-1]:  # from far to near, what is nearer replaces what is farther
        near = np.stack([gaussian_filter(plane[..., i], radius) for i in range(3)], axis=-1)
        share = gaussian_filter(weight, radius)[data.where]
        enough = share > ENOUGH
        found[enough] = near[data.where][enough]
    return unit_and_length(found)[0]


def _albedo(colors: Array, shading: Array, weights: Array, strengths: Array) -> Array:
    """Albedo (P, 3) by weighted least squares; without a sample of weight, by the sum of all."""
    channels = colors.shape[2]
    used = strengths[:, :channels]
    product = shading[..., None] * used
    tiny = np.finfo(np.float64).tiny
    below = np.einsum("pnc,pnc,pnc->pc", weights, product, product)
    found = np.einsum("pnc,pnc,pnc->pc", weights, product, colors) / np.maximum(below, tiny)
    total = colors.sum(axis=1) / np.maximum(product.sum(axis=1), 1e-3 * used.sum(axis=0))
    found = np.where(below > 1e-6 * np.median(below, axis=0), found, total)
    return np.asarray(np.maximum(np.broadcast_to(found, (len(found), 3)), 0.0))
