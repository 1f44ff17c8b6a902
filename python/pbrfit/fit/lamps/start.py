"""The start of a fit with lamps: normals, albedo and lamps from pictures alone, taken as diffuse.

Known lamps leave robust photometric stereo at each pixel (`photometric`). Unknown ones are found
with the pseudo-normals, up to a matrix, by a factorisation (`factorization`); the matrix by all
cues at once (`ambiguity`, `cues`). What no cue tells is named in `undetermined`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.lamps.ambiguity import EQUALLY_LIKELY, FEW, Minimum, minima
from pbrfit.fit.lamps.cues import Places, unit_and_length
from pbrfit.fit.lamps.factorization import Factors, factors
from pbrfit.fit.lamps.outline import Outline, inflated, outline
from pbrfit.fit.lamps.photometric import DARK, PseudoNormals, pseudo_normals
from pbrfit.fit.lamps.places import PLACES_MAX, chosen_places
from pbrfit.fit.lamps.samples import Samples, some_of
from pbrfit.fit.lamps.strengths import strengths_along
from pbrfit.fit.lamps.surface import LampStart, finished

__all__ = ["LampStart", "start_of_known_lamps", "start_of_unknown_lamps"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FACTORED_MAX = 4000
"""Pixels that the lamps' space is found from: N unknown lamps of three numbers each are known to a
per cent of σ by as many."""

PLACES_MIN = 30
"""Pixels with a pseudo-normal of their own below which cues say nothing: each of the eight unknowns
would have fewer than four."""

SAME_DEGREES = 5.0
"""Mean angle between two minima's normals, in degrees, up to which they are one surface."""

FLAT = 0.01
"""Least singular value of the lamps' directions, of the largest, below which they lie in a plane:
their largest angle to it is about a degree."""


def start_of_known_lamps(
    samples: Array,
    usable: Mask,
    mask: Mask,
    views: Array,
    directions: Array,
    strengths: Array | None = None,
) -> LampStart:
    """Start with lamps whose directions are known.

    Parameters
    ----------
    samples
        (N, H, W) or (N, H, W, 3) linear radiance.
    usable
        Of that shape: values that are not clipped and belong to the mask.
    mask
        (H, W).
    views
        (H, W, 3) unit vectors to the camera.
    directions
        (N, 3) unit vectors.
    strengths
        (N,) or (N, 3); None = unknown, found up to a common factor.

    Raises
    ------
    InputError
        If there are fewer than three pictures or shapes do not fit.
    """
    data = Samples.of(samples, usable, mask)
    lamps = np.asarray(directions, np.float64)
    if lamps.shape != (data.pictures, 3):
        raise InputError(f"directions: expected {(data.pictures, 3)}, found {lamps.shape}")
    undetermined: tuple[str, ...] = ()
    if strengths is None:
        grey, undetermined = _strengths_of_known(data, lamps)
    else:
        grey = np.asarray(strengths, np.float64).reshape(data.pictures, -1).mean(axis=1)
    normals = pseudo_normals(data.relative, data.usable, lamps * grey[:, None])
    flat = _in_plane(lamps)
    rough = None
    if flat:
        rough = inflated(mask, views) if len(outline(mask, views)) else np.array(views, np.float64)
    figures = {"spread of samples": normals.scale}
    words = undetermined + flat
    return finished(
        data, views, _scaled(data, normals, np.eye(3)), lamps * grey[:, None], figures, words, rough
    )


def start_of_unknown_lamps(
    samples: Array,
    usable: Mask,
    mask: Mask,
    views: Array,
    fov: float = 0.0,
    places_max: int | None = None,
) -> LampStart:
    """Start with lamps of which nothing is known but that there is a far one in each picture.

    Parameters
    ----------
    samples, usable, mask, views
        As in `start_of_known_lamps`.
    fov
        Horizontal field of view in degrees; 0 = orthographic or unknown.
    places_max
        Pixels that cues look at, at most; None = `PLACES_MAX`.

    Raises
    ------
    InputError
        If there are fewer than three pictures or shapes do not fit.
    """
    data = Samples.of(samples, usable, mask)
    least = min(3, len(data.grey))
    seen = (data.usable & (data.relative >= DARK)).sum(axis=0) >= least
    if not seen.all():
        if seen.sum() < 3:
            raise InputError(
                f"pictures: expected three or more in which a lamp is seen, found {seen.sum()}"
            )
        some = np.asarray(samples)[seen], np.asarray(usable)[seen]
        return _with_black(start_of_unknown_lamps(*some, mask, views, fov, places_max), seen)
    rays = views if fov > 0 else np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    chosen = some_of(len(data.grey), FACTORED_MAX)
    product = factors(data.grey[chosen], data.usable[chosen])
    edge = outline(mask, views)
    if product.rank < 3:
        return _start_of_few(data, views, edge, product)
    lamps = product.lamps * product.sizes
    normals = pseudo_normals(data.relative, data.usable, lamps)
    most = places_max or PLACES_MAX
    places = chosen_places(data, rays, views, normals, lamps, edge, most)
    if not places.of.integrability.blocks or len(places.chosen) < PLACES_MIN:
        return _start_of_few(data, views, edge, product)
    rough = inflated(mask, views)[data.where] if len(edge) else None
    few = FEW * most // PLACES_MAX
    found = minima(places.of, None if rough is None else rough[places.chosen], few)
    best, undetermined = _decided(found, places.of, len(edge) > 0)
    scaled = _scaled(data, normals, best.normals)
    figures = {
        "spread of samples": normals.scale,
        **{f"size of direction {i + 1}": float(product.sizes[i]) for i in range(3)},
        **{f"cost of {name}": value for name, value in best.parts.items()},
    }
    return finished(data, views, scaled, lamps @ best.lamps, figures, undetermined)


def _with_black(start: LampStart, seen: Mask) -> LampStart:
    """The start with pictures (N,) in which no lamp was seen put back, of strength 0."""
    count = len(seen)
    along = np.tile([0.0, 0.0, 1.0], (count, 1))
    along[seen] = start.directions
    strengths = np.zeros((count, 3))
    strengths[seen] = start.strengths
    weights = np.zeros((count, *start.known.shape))
    weights[seen] = start.weights
    numbers = ", ".join(str(i + 1) for i in np.flatnonzero(~seen))
    words = f"Nothing is lit in picture {numbers}: where its lamp stands is not determined"
    return replace(
        start,
        directions=along,
        strengths=strengths,
        weights=weights,
        undetermined=(*start.undetermined, words),
    )


def _start_of_few(data: Samples, views: Array, edge: Outline, product: Factors) -> LampStart:
    """Start with lamps in a plane or a line: normals of a rough shape, corrected where lamps tell.

    A factorisation of rank 2 leaves more than a 3 × 3 matrix open. So lamps are those that suit
    given normals best, or those of the mask blown up as a balloon, or of a plane.
    """
    rough = inflated(data.mask, views) if len(edge) else np.array(views, np.float64)
    normals = rough[data.where]
    rows = np.clip(data.relative, 0.0, 2.0) * data.usable
    ridge = 1e-3 * len(normals) * np.eye(3)
    lamps = np.asarray(np.linalg.solve(normals.T @ normals + ridge, normals.T @ rows).T)
    if product.rank > 0:
        space = product.lamps[:, : product.rank]
        lamps = space @ (space.T @ lamps) / len(lamps)
    found = _scaled(data, pseudo_normals(data.relative, data.usable, lamps), np.eye(3))
    words = (
        f"The samples have rank {product.rank}, of few pixels or under lamps in a plane with the "
        "scene or too close to each other: normals are in part those of "
        "a rough shape from the mask",
    )
    figures = {"spread of samples": found.scale, "rank": float(product.rank)}
    return finished(data, views, found, lamps, figures, words, rough)


def _strengths_of_known(data: Samples, lamps: Array) -> tuple[Array, tuple[str, ...]]:
    """Strengths (N,) of lamps with known directions; equal ones, with a word, if nothing tells."""
    chosen = some_of(len(data.grey), FACTORED_MAX)
    product = factors(data.grey[chosen], data.usable[chosen])
    found = strengths_along(product.lamps * product.sizes, lamps) if product.rank == 3 else None
    if found is None:
        return np.ones(len(lamps)), (
            "The lamps' directions do not tell their strengths, which are taken as equal",
        )
    return found, ()


def _in_plane(lamps: Array) -> tuple[str, ...]:
    """Words on lamps (N, 3) that lie in a plane with the surface."""
    _, values, axes = np.linalg.svd(lamps, full_matrices=False)
    if values[2] >= FLAT * values[0]:
        return ()
    x, y, z = axes[2] * (1 if axes[2][2] >= 0 else -1)
    return (
        "All lamps lie in a plane with the scene: the part of a normal along "
        f"({x:.2f}, {y:.2f}, {z:.2f}) is not determined and taken from a smooth shape",
    )


def _scaled(data: Samples, normals: PseudoNormals, G: Array) -> PseudoNormals:
    """Pseudo-normals b G times the pixels' brightness, of those of relative samples.

    The precision becomes that of Gᵀ b and remains relative, so that dark and light pixels compare.
    """
    inverse = np.linalg.inv(G)
    precision = np.einsum("ij,pjk,lk->pil", inverse, normals.precision, inverse, optimize=True)
    vectors = normals.vectors @ G * data.brightness[:, None]
    return PseudoNormals(vectors, normals.weights, precision, normals.scale)


def _decided(found: list[Minimum], places: Places, told: bool) -> tuple[Minimum, tuple[str, ...]]:
    """The most likely minimum, and in words what others are as likely."""
    best = found[0]
    undetermined = []
    if not told:
        # The surface that is bulged the other way, with lamps from the other side: without
        # perspective no cue but the outline knows it from this one.
        flip = np.diag([-1.0, -1.0, 1.0])
        C = best.lamps * np.sign(np.linalg.det(best.lamps))
        twin = Minimum.at(C @ flip, places)
        height = float(unit_and_length(places.lamps @ best.lamps)[0][:, 1].mean())
        if twin is not None and twin.cost - best.cost < EQUALLY_LIKELY:
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
        apart = float(np.degrees(_angles(normals, elsewhere).mean()))
        if apart > SAME_DEGREES:
            undetermined.append(
                f"Another surface, {apart:.0f} degrees apart, is about as likely: the cues' "
                f"likelihoods differ by a factor of {np.exp(other.cost - found[0].cost):.1f}"
            )
            break
    return best, tuple(undetermined)


def _angles(first: Array, second: Array) -> Array:
    """Angles in radians between unit vectors (P, 3)."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(first - second, axis=1) / 2, 0, 1)))
