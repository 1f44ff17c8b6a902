"""The start of a fit with lamps: normals, albedo and lamps from pictures alone, taken as diffuse.

Known lamps leave robust photometric stereo at each pixel (`photometric`). Unknown ones are found
with the pseudo-normals, up to a matrix, by a factorisation; the matrix by all cues at once
(`ambiguity`). What no cue tells is named in `undetermined`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbrfit._core import InputError
from pbrfit.fit.lamps.ambiguity import Minimum, Places, Relief, minima, unit_and_length
from pbrfit.fit.lamps.photometric import DARK, Factors, factors, pseudo_normals
from pbrfit.fit.lamps.samples import MATT_PIXELS, FirstShape, Pictures, Samples, some_of
from pbrfit.fit.lamps.surface import finished, strengths_along
from pbrfit.fit.settings import COMPARE_PIXELS_MIN
from pbrfit.model.geometry import angles_between
from pbrfit.scene.outline import outline, rough_shape
from pbrfit.values.arrays import Array, Mask

EQUALLY_LIKELY = 3.0
"""Difference of the negative log likelihood below which two minima are told to be undecided: odds
of 20 to 1."""


def start_of_known_lamps(
    samples: Pictures,
    usable: Pictures,
    mask: Mask,
    views: Array,
    directions: Array,
    strengths: Array | None = None,
    threads: int = 0,
) -> FirstShape:
    """Start with lamps whose `directions`, (N, 3) unit vectors, are known.

    Of `samples` (N, H, W, C), linear radiance, some are `usable`: not clipped, and in the mask
    (H, W). `views` (H, W, 3) are unit vectors to the camera; `strengths` (N,) or (N, 3); None =
    found up to a common factor. Raises InputError for fewer than three pictures.
    """
    data = Samples.of_pictures(samples, usable, mask, threads)
    lamps = np.asarray(directions, np.float64)
    undetermined: tuple[str, ...] = ()
    if strengths is None:
        grey, undetermined = _strengths_of_known(data, lamps)
    else:
        grey = np.asarray(strengths, np.float64).reshape(data.pictures, -1).mean(axis=1)
    normals = pseudo_normals(data.relative, data.usable, lamps * grey[:, None], data.threads)
    flat = _in_plane(lamps)
    rough = rough_shape(mask, views) if flat else None
    return finished(data, normals, np.eye(3), lamps * grey[:, None], undetermined + flat, rough)


def start_of_unknown_lamps(
    samples: Pictures,
    usable: Pictures,
    mask: Mask,
    views: Array,
    fov: float = 0.0,
    threads: int = 0,
) -> FirstShape:
    """Start with lamps of which nothing is known but that there is a far one in each picture.

    `fov` is horizontal, in degrees; 0 = orthographic or unknown. All else as of known lamps.
    """
    data = Samples.of_pictures(samples, usable, mask, threads)
    least = min(3, len(data.relative))
    seen = (data.usable & (data.relative >= DARK)).sum(axis=0) >= least
    if not seen.all():
        if seen.sum() < 3:
            raise InputError(
                f"pictures: expected three or more in which a lamp is seen, found {seen.sum()}"
            )
        some, told = ([of[i] for i in np.flatnonzero(seen).tolist()] for of in (samples, usable))
        return _with_black(start_of_unknown_lamps(some, told, mask, views, fov, threads), seen)
    rays = views if fov > 0 else np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    chosen = some_of(len(data.relative), MATT_PIXELS)
    product = factors(data.relative[chosen], data.usable[chosen])
    edge = outline(mask, views)
    if product.rank < 3:
        return _start_of_few(data, views, product)
    lamps = product.lamps
    normals = pseudo_normals(data.relative, data.usable, lamps, data.threads)
    places = Places.of(data, rays, views, normals, lamps, edge)
    if not places.integrability.blocks or len(places.chosen) < COMPARE_PIXELS_MIN:
        return _start_of_few(data, views, product)
    rough = rough_shape(mask, views)[data.where][places.chosen] if len(edge) else None
    found = minima(places, rough)
    best, undetermined = _decided(found, places, len(edge) > 0)
    shape = finished(data, normals, best.normals, lamps @ best.lamps, undetermined)
    return replace(shape, relief=Relief(best.lamps, places)) if len(edge) else shape


def _with_black(start: FirstShape, seen: Mask) -> FirstShape:
    """The start with pictures (N,) in which no lamp was seen put back, of strength 0."""
    count = len(seen)
    along = np.tile([0.0, 0.0, 1.0], (count, 1))
    along[seen] = start.directions
    strengths = np.zeros((count, 3))
    strengths[seen] = start.strengths
    numbers = ", ".join(str(i + 1) for i in np.flatnonzero(~seen))
    words = f"Nothing is lit in picture {numbers}: where its lamp stands is not determined"
    return replace(
        start, directions=along, strengths=strengths, undetermined=(*start.undetermined, words)
    )


def _start_of_few(data: Samples, views: Array, product: Factors) -> FirstShape:
    """Start with lamps in a plane or a line: normals of a rough shape, corrected where lamps tell.

    A factorisation of rank 2 leaves more than a 3 × 3 matrix open. So lamps are those that suit the
    rough shape's normals best.
    """
    rough = rough_shape(data.mask, views)
    rows = np.clip(data.relative, 0.0, 2.0) * data.usable
    # Directions that hardly any normal differs in say nothing of lamps.
    lamps = np.asarray(np.linalg.lstsq(rough[data.where], rows, rcond=0.03)[0].T, np.float64)
    if product.rank > 0:
        space, _ = np.linalg.qr(product.lamps[:, : product.rank])
        lamps = space @ (space.T @ lamps)
    found = pseudo_normals(data.relative, data.usable, lamps, data.threads)
    words = (
        f"The samples have rank {product.rank}, of few pixels or under lamps in a plane with the "
        "scene or too close to each other: normals are in part those of "
        "a rough shape from the mask",
    )
    return finished(data, found, np.eye(3), lamps, words, rough)


def _strengths_of_known(data: Samples, lamps: Array) -> tuple[Array, tuple[str, ...]]:
    """Strengths (N,) of lamps with known directions; equal ones, with a word, if nothing tells."""
    chosen = some_of(len(data.relative), MATT_PIXELS)
    product = factors(data.relative[chosen], data.usable[chosen])
    found = strengths_along(product.lamps, lamps) if product.rank == 3 else None
    if found is None:
        return np.ones(len(lamps)), (
            "The lamps' directions do not tell their strengths, which are taken as equal",
        )
    return found, ()


def _in_plane(lamps: Array) -> tuple[str, ...]:
    """Words on lamps (N, 3) that lie in a plane with the surface."""
    _, values, axes = np.linalg.svd(lamps, full_matrices=False)
    if values[2] >= 0.01 * values[0]:  # the largest angle to it is about a degree
        return ()
    x, y, z = axes[2] * (1 if axes[2][2] >= 0 else -1)
    return (
        "All lamps lie in a plane with the scene: the part of a normal along "
        f"({x:.2f}, {y:.2f}, {z:.2f}) is not determined and taken from a smooth shape",
    )


def _decided(found: list[Minimum], places: Places, told: bool) -> tuple[Minimum, tuple[str, ...]]:
    """The most likely minimum, and in words what others are as likely."""
    best = found[0]
    undetermined = []
    if not told:
        # The surface that is bulged the other way, with lamps from the other side: without
        # perspective no cue but the outline knows it from this one.
        flip = np.diag([-1.0, -1.0, 1.0])
        twin = Minimum.at(best.lamps @ flip, places)
        height = float(unit_and_length(places.lamps @ best.lamps)[0][:, 1].mean())
        if twin.cost - best.cost < EQUALLY_LIKELY:
            if height < 0:
                best = twin
            undetermined.append(
                "No outline and no perspective tells a surface from the one bulged the other way "
                "under lamps from the other side: lamps are taken to be above rather than below "
                f"(mean of their y: {abs(height):.2f})"
            )
    normals = unit_and_length(places.vectors @ best.normals)[0]
    for other in found[1:]:
        if other.cost - found[0].cost > EQUALLY_LIKELY:
            break
        elsewhere = unit_and_length(places.vectors @ other.normals)[0]
        apart = float(angles_between(normals, elsewhere).mean())
        if apart > 5:  # else they are one surface
            undetermined.append(
                f"Another surface, {apart:.0f} degrees apart, is about as likely: the cues' "
                f"likelihoods differ by a factor of {np.exp(other.cost - found[0].cost):.1f}"
            )
            break
    return best, tuple(undetermined)
