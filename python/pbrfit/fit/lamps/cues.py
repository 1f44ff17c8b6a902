"""What tells a surface with its lamps from transformed ones: cues, negative log likelihoods.

The unknown is the matrix of cofactors C (3, 3) of `integrability`. Pseudo-normals b become those of
the surface, and lamps s those in front of it, by

    m = ± Cof(C)ᵀ b/√det C,    l = ± Cᵀ s/√det C,

the sign such that the surface faces the camera. The albedo is |m|.

Cues differ in how many places they look at, and neighbours err alike: gloss, shadows and light from
other surfaces change slowly across a picture. A hundred pixels are not a hundred observations. So
the picture is divided in blocks, and a cue that is a mean over places counts as one observation a
block that has any (clusters that err as one: Kish, "Survey sampling", Wiley 1965; Varin, Reid and
Firth, "An overview of composite likelihood methods", Statistica Sinica 21, 2011).

Costs take many transforms at once, (T, 3, 3), because slopes are differences: an array of ten
transforms takes hardly longer than one. Each gives (T, terms).

No spread of a cue is known beforehand: each is what makes its cue most likely, above a least one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0

from pbrfit.fit.lamps.integrability import Integrability

Array = NDArray[np.float64]

ALBEDO_SPREAD_MIN = 0.05
"""Least spread of the logarithm of albedo: lamps that are not quite far away, and light from other
surfaces, change it by about 5 % across an object, whatever its albedo."""

STRENGTH_SPREAD = 0.1
"""Spread of the logarithm of lamps' strengths that is expected: one lamp moved by hand at arm's
length with 5 % of change in its distance."""

STRENGTH_CERTAINTY = 4.0
"""Lamps that the expected spread counts as, beside those there are."""

AZIMUTH_CONCENTRATION = 15.0
"""κ of von Mises' distribution of the azimuth at the outline: a deviation of 15 degrees."""

CUT = 0.2
"""Share of the outline where nothing turns away: an edge of a table, of another thing."""

FACING_SPREAD = 0.5
"""Spread of the logarithm of n·v at the outline about that of a ball: radii that differ by a
factor of 2.7."""

FACING_MIN = 0.05
"""n·v, 87 degrees: what pixels show of steeper surfaces is less than half a pixel's own."""

SLOPE_MEAN, SLOPE_SPREAD = 0.70, 0.12
"""Mean of n·v over the pixels of a surface and the spread of this mean from surface to surface. A
ball's is 2/3; of reliefs it is larger."""

BEHIND = 0.1
"""Cosine of the angle to the camera's axis: how far lamps may be behind the picture's plane before
they cost as much as a deviation from a cue's own spread."""


VOLUME_MIN = 1e-12
"""Determinant of a C of length 1 from which on a matrix has these cofactors: below, normals would
be told by a millionth of the pictures."""


@dataclass(frozen=True, eq=False)
class Places:
    """Pixels that cues look at, and what the pictures say there.

    Attributes
    ----------
    vectors, views
        (P, 3) b, divided by brightness, and (P, 3).
    blocks
        Blocks of the picture that they lie in.
    brightness
        (P,) what b is multiplied by.
    pairs
        (R, 2) indices of pixels that may share an albedo.
    outline_vectors, outline_views, outline_blocks
        The same at the outline, (E, 3), (E, 3) and a number.
    outward, facing
        (E, 3) and (E,): what is expected there, as in `outline`.
    lamps
        (N, 3) s.
    integrability
        Its equations.
    """

    vectors: Array
    views: Array
    blocks: int
    brightness: Array
    pairs: NDArray[np.intp]
    outline_vectors: Array
    outline_views: Array
    outline_blocks: int
    outward: Array
    facing: Array
    lamps: Array
    integrability: Integrability

    def thinned(self, most: int) -> Places:
        """At most about so many places, evenly drawn; what they count as remains."""
        step = max(len(self.vectors) // most, 1)
        edge = max(len(self.outline_vectors) // most, 1)
        # Partners of pairs are anywhere, so pairs keep pixels of their own.
        pairs = self.pairs[::step]
        used, renamed = np.unique(pairs, return_inverse=True)
        return replace(
            self,
            vectors=self.vectors[used],
            views=self.views[used],
            brightness=self.brightness[used],
            pairs=renamed.reshape(pairs.shape),
            outline_vectors=self.outline_vectors[::edge],
            outline_views=self.outline_views[::edge],
            outward=self.outward[::edge],
            facing=self.facing[::edge],
        )


@dataclass(frozen=True, eq=False)
class Transforms:
    """Matrices C (T, 3, 3) and what follows of them.

    Attributes
    ----------
    normals, lamps
        (T, 3, 3): what b and s are multiplied by, in rows.
    possible
        (T,): whether any matrix has these cofactors, which takes a determinant above 0. Where not,
        the other two are as if it were just so.
    """

    normals: Array
    lamps: Array
    possible: NDArray[np.bool_]

    @classmethod
    def of(cls, C: Array, places: Places) -> Transforms:
        """Transforms of C (T, 3, 3)."""
        C = C / np.linalg.norm(C, axis=(1, 2), keepdims=True)
        first, second, third = np.moveaxis(C, 2, 0)
        cofactors = np.stack(
            [np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=2
        )
        volume = np.einsum("ti,ti->t", first, cofactors[..., 0])
        facing = np.einsum("tpi,pi->tp", places.vectors @ cofactors, places.views)
        sign = np.where((facing > 0).sum(axis=1) * 2 >= facing.shape[1], 1.0, -1.0)
        # Cof(C) = G det G: with G for normals, lamps have G⁻ᵀ = C/det G.
        root = (sign * np.sqrt(np.maximum(volume, VOLUME_MIN)))[:, None, None]
        return cls(cofactors / root, C / root, volume > VOLUME_MIN)


def unit_and_length(vectors: Array) -> tuple[Array, Array]:
    """Unit vectors (..., 3) and lengths (...), which are kept above 0."""
    squared = np.einsum("...i,...i->...", vectors, vectors)
    length: Array = np.sqrt(np.maximum(squared, 1e-24))
    return vectors / length[..., None], length


def _cauchy_scale(residuals: Array, least: float) -> Array:
    """Most likely scale (T, 1) of Cauchy's distribution for residuals (T, R).

    With it the mean of 1/(1 + (r/s)²) is 1/2.
    """
    squared = residuals**2
    scale: Array = np.maximum(np.median(np.abs(residuals), axis=1, keepdims=True), least)
    for _ in range(4):
        share = 1 / (1 + squared / scale**2)
        # Newton's method in ln s, of which the mean share has this slope.
        slope = np.mean(2 * share * (1 - share), axis=1, keepdims=True)
        step = (0.5 - share.mean(axis=1, keepdims=True)) / np.maximum(slope, 1e-3)
        scale = np.maximum(scale * np.exp(np.clip(step, -1.0, 1.0)), least)
    return scale


def albedo_cost(transforms: Transforms, places: Places) -> Array:
    """Of each pair: pixels are of a few albedos, so differences of ln |m| are mostly small.

    Their density is Cauchy's, ln s + ln(1 + (r/s)²): its tails are for pairs of different albedos.
    The sum with the best s is the logarithm of a robust spread, and so close to an entropy
    (Alldrin, Mallick and Kriegman, "Resolving the generalized bas-relief ambiguity by entropy
    minimization", CVPR 2007).
    """
    length = np.log(unit_and_length(places.vectors @ transforms.normals)[1] * places.brightness)
    difference = length[:, places.pairs[:, 0]] - length[:, places.pairs[:, 1]]
    scale = _cauchy_scale(difference, ALBEDO_SPREAD_MIN)
    return np.asarray(np.log(scale) + np.log1p((difference / scale) ** 2))


def integrability_cost(transforms: Transforms, places: Places) -> Array:
    """Equations are normal with a variance that is ν times that of their noise.

    With the best ν this is ½ ln(CᵀQC/CᵀNC) an observation.
    """
    squares, noise = places.integrability.ratios(transforms.lamps)
    tiny = np.finfo(np.float64).tiny
    return np.asarray(0.5 * np.log(np.maximum(squares, tiny) / np.maximum(noise, tiny)))[:, None]


def strength_cost(transforms: Transforms, places: Places) -> Array:
    """Of all lamps: they are equally strong but for a spread that is not known.

    Normal ln |l| whose variance has an inverse χ² distribution of `STRENGTH_CERTAINTY` degrees of
    freedom about `STRENGTH_SPREAD`² make Student's distribution, here of the deviations from their
    mean.
    """
    length = np.log(unit_and_length(places.lamps @ transforms.lamps)[1])
    deviation = np.sum((length - length.mean(axis=1, keepdims=True)) ** 2, axis=1, keepdims=True)
    free = STRENGTH_CERTAINTY
    spread = free * STRENGTH_SPREAD**2
    return np.asarray((free + length.shape[1] - 1) / 2 * np.log1p(deviation / spread))


def azimuth_cost(transforms: Transforms, places: Places) -> Array:
    """Of each pixel at the outline: the normal's azimuth is outwards, but at a share `CUT`."""
    normals, _ = unit_and_length(places.outline_vectors @ transforms.normals)
    across, _ = unit_and_length(
        normals - _towards(normals, places.outline_views)[..., None] * places.outline_views
    )
    cosine = np.einsum("tei,ei->te", across, places.outward)
    peak = float(i0(AZIMUTH_CONCENTRATION))
    density = (1 - CUT) * np.exp(AZIMUTH_CONCENTRATION * cosine) / peak + CUT
    return np.asarray(-np.log(density))


def facing_cost(transforms: Transforms, places: Places) -> Array:
    """Of each pixel at the outline: n·v is ln-normal about that of a ball, but at a share `CUT`."""
    normals, _ = unit_and_length(places.outline_vectors @ transforms.normals)
    towards = _towards(normals, places.outline_views)
    # Softly kept above 0, so that the slope of normals that face away leads back.
    softened = np.maximum(FACING_MIN, 0.5 * (towards + np.sqrt(towards**2 + FACING_MIN**2)))
    expected = np.maximum(places.facing, FACING_MIN)
    deviation = np.log(softened / expected) / FACING_SPREAD
    density = (1 - CUT) * np.exp(-0.5 * deviation**2) + CUT * FACING_SPREAD
    return np.asarray(-np.log(density))


def visible_cost(transforms: Transforms, places: Places) -> Array:
    """Of each pixel: what is seen faces the camera, n·v > 0 but for `FACING_MIN`."""
    normals, _ = unit_and_length(places.vectors @ transforms.normals)
    return np.asarray(np.logaddexp(0.0, -_towards(normals, places.views) / FACING_MIN))


def slope_cost(transforms: Transforms, places: Places) -> Array:
    """Of the surface: the mean of n·v is as of surfaces; a weak prior, of one observation."""
    normals, _ = unit_and_length(places.vectors @ transforms.normals)
    mean = _towards(normals, places.views).mean(axis=1, keepdims=True)
    return np.asarray(0.5 * ((mean - SLOPE_MEAN) / SLOPE_SPREAD) ** 2)


def front_cost(transforms: Transforms, places: Places) -> Array:
    """Of each lamp: it stands in front of the picture's plane, if only just."""
    along, _ = unit_and_length(places.lamps @ transforms.lamps)
    return np.asarray(np.logaddexp(0.0, -along[..., 2] / BEHIND))


def _towards(normals: Array, views: Array) -> Array:
    """n·v, (T, P)."""
    return np.asarray(np.einsum("tpi,pi->tp", normals, views))


@dataclass(frozen=True)
class Cue:
    """A cue, and how many observations it counts as; None = each of its terms is one."""

    name: str
    cost: Callable[[Transforms, Places], Array]
    blocks: Callable[[Places], int] | None

    def values(self, transforms: Transforms, places: Places) -> Array:
        """Negative log likelihood but for a constant, (T,): terms, or blocks times their mean."""
        terms = self.cost(transforms, places)
        if not terms.shape[1]:
            return np.zeros(len(terms))
        if self.blocks is None:
            return np.asarray(terms.sum(axis=1))
        return np.asarray(self.blocks(places) * terms.mean(axis=1))


CUES = (
    Cue("integrability", integrability_cost, lambda p: p.integrability.blocks),
    Cue("albedo", albedo_cost, lambda p: p.blocks),
    Cue("strengths", strength_cost, None),
    Cue("outline azimuth", azimuth_cost, lambda p: p.outline_blocks),
    Cue("outline slant", facing_cost, lambda p: p.outline_blocks),
    Cue("visible", visible_cost, lambda p: p.blocks),
    Cue("slope", slope_cost, None),
    Cue("lamps in front", front_cost, None),
)
"""In this order in every report."""
