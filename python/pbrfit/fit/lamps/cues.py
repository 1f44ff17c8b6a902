"""What tells surfaces with lamps from their transformed likes: cues, each a negative log likelihood.

The unknown is the matrix of cofactors C (3, 3) of `integrability`. Pseudo-normals b become those of
the surface, and lamps s those in front of it, by

    m = ± Cof(C)ᵀ b/√det C,    l = ± Cᵀ s/√det C,

the sign such that the surface faces the camera. The albedo is |m|.

Cues differ in how many places they look at, and neighbours err alike: gloss, shadows and light from
other surfaces change slowly across a picture. A hundred pixels are not a hundred observations. So
the picture is divided in blocks, and a cue that is a mean over places counts as one observation a
block that has any (clusters that err as one: Kish, "Survey sampling", Wiley 1965; Varin, Reid and
Firth, "An overview of composite likelihood methods", Statistica Sinica 21, 2011).

No spread of a cue is known beforehand: each is what makes its cue most likely, above a least one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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

GUIDE_CONCENTRATION = 30.0
"""κ of the distribution of normals about given ones: a deviation of 15 degrees."""

SLOPE_MEAN, SLOPE_SPREAD = 0.70, 0.12
"""Mean of n·v over the pixels of a surface and the spread of this mean from surface to surface. A
ball's is 2/3; of reliefs it is larger."""

BEHIND = 0.1
"""Cosine of the angle to the camera's axis: how far lamps may be behind the picture's plane before
they cost as much as a deviation from a cue's own spread."""


@dataclass(frozen=True, eq=False)
class Places:
    """Pixels that cues look at, and what the pictures say there.

    Attributes
    ----------
    vectors, views, blocks
        (P, 3) b, divided by brightness; (P, 3); (P,) numbers of blocks of the picture.
    brightness
        (P,) what b is multiplied by.
    pairs
        (R, 2) indices of pixels that may share an albedo.
    outline_vectors, outline_views, outward, facing, outline_blocks
        The same at the outline (E, ...); what is expected there, as in `outline`.
    guide
        (P, 3) given normals or None.
    lamps
        (N, 3) s.
    integrability
        Its equations.
    """

    vectors: Array
    views: Array
    blocks: NDArray[np.intp]
    brightness: Array
    pairs: NDArray[np.intp]
    outline_vectors: Array
    outline_views: Array
    outward: Array
    facing: Array
    outline_blocks: NDArray[np.intp]
    guide: Array | None
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
            blocks=self.blocks[used],
            brightness=self.brightness[used],
            guide=None if self.guide is None else self.guide[used],
            pairs=renamed.reshape(pairs.shape),
            outline_vectors=self.outline_vectors[::edge],
            outline_views=self.outline_views[::edge],
            outward=self.outward[::edge],
            facing=self.facing[::edge],
            outline_blocks=self.outline_blocks[::edge],
        )


@dataclass(frozen=True, eq=False)
class Transform:
    """C and what follows of it: `normals` and `lamps` are what b and s are multiplied by."""

    normals: Array
    lamps: Array

    @classmethod
    def of(cls, C: Array, places: Places) -> Transform | None:
        """None if no matrix has these cofactors: they need a determinant above 0."""
        C = C / np.linalg.norm(C)
        volume = float(np.linalg.det(C))
        if volume <= 1e-12:
            return None
        cofactors = np.linalg.inv(C).T * volume
        facing = np.einsum("pi,pi->p", places.vectors @ cofactors, places.views)
        sign = 1.0 if np.count_nonzero(facing > 0) * 2 >= len(facing) else -1.0
        # Cof(C) = G det G: with G for normals, lamps have G⁻ᵀ = C/det G.
        root = sign * np.sqrt(volume)
        return cls(cofactors / root, C / root)


def directions(vectors: Array) -> tuple[Array, Array]:
    """Unit vectors (P, 3) and lengths (P,), which are kept above 0."""
    length = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
    return vectors / length[:, None], length


def _cauchy_scale(residuals: Array, least: float) -> float:
    """Scale of Cauchy's distribution that makes residuals most likely: mean 1/(1 + (r/s)²) = 1/2."""
    squared = residuals**2
    scale = max(float(np.median(np.abs(residuals))), least)
    for _ in range(4):
        share = 1 / (1 + squared / scale**2)
        slope = float(np.mean(2 * share * (1 - share)))  # of the mean share by ln s
        scale *= float(np.exp(np.clip((0.5 - share.mean()) / max(slope, 1e-3), -1.0, 1.0)))
        scale = max(scale, least)
    return scale


def albedo_cost(transform: Transform, places: Places) -> Array:
    """Of each pair: pixels are of a few albedos, so differences of ln |m| are mostly small.

    Their density is Cauchy's, ln s + ln(1 + (r/s)²): its tails are for pairs of different albedos.
    The sum with the best s is the logarithm of a robust spread, and so close to an entropy
    (Alldrin, Mallick and Kriegman, "Resolving the generalized bas-relief ambiguity by entropy
    minimization", CVPR 2007).
    """
    length = np.log(directions(places.vectors @ transform.normals)[1] * places.brightness)
    difference = length[places.pairs[:, 0]] - length[places.pairs[:, 1]]
    scale = _cauchy_scale(difference, ALBEDO_SPREAD_MIN)
    return np.asarray(np.log(scale) + np.log1p((difference / scale) ** 2))


def integrability_cost(transform: Transform, places: Places) -> Array:
    """Equations are normal with a variance that is ν times that of their noise.

    With the best ν this is ½ ln(CᵀQC/CᵀNC) an observation.
    """
    squares, noise = places.integrability.ratios(transform.lamps)
    tiny = np.finfo(np.float64).tiny
    return np.array([0.5 * np.log(max(squares, tiny) / max(noise, tiny))])


def strength_cost(transform: Transform, places: Places) -> Array:
    """Of all lamps: they are equally strong but for a spread that is not known.

    Normal ln |l| whose variance has an inverse χ² distribution of `STRENGTH_CERTAINTY` degrees of
    freedom about `STRENGTH_SPREAD`² make Student's distribution, here of the deviations from their
    mean.
    """
    length = np.log(directions(places.lamps @ transform.lamps)[1])
    deviation = np.sum((length - length.mean()) ** 2)
    free = STRENGTH_CERTAINTY
    spread = free * STRENGTH_SPREAD**2
    return np.array([(free + len(length) - 1) / 2 * np.log1p(deviation / spread)])


def azimuth_cost(transform: Transform, places: Places) -> Array:
    """Of each pixel at the outline: the normal's azimuth is outwards, but at a share `CUT`."""
    normals, _ = directions(places.outline_vectors @ transform.normals)
    towards = np.einsum("ei,ei->e", normals, places.outline_views)
    across, _ = directions(normals - towards[:, None] * places.outline_views)
    cosine = np.einsum("ei,ei->e", across, places.outward)
    peak = np.i0(AZIMUTH_CONCENTRATION)
    density = (1 - CUT) * np.exp(AZIMUTH_CONCENTRATION * cosine) / peak + CUT
    return np.asarray(-np.log(density))


def facing_cost(transform: Transform, places: Places) -> Array:
    """Of each pixel at the outline: n·v is about that of a ball, ln-normal, but at a share `CUT`."""
    normals, _ = directions(places.outline_vectors @ transform.normals)
    towards = np.einsum("ei,ei->e", normals, places.outline_views)
    # Softly kept above 0, so that the slope of normals that face away leads back.
    softened = np.maximum(FACING_MIN, 0.5 * (towards + np.sqrt(towards**2 + FACING_MIN**2)))
    expected = np.maximum(places.facing, FACING_MIN)
    deviation = np.log(softened / expected) / FACING_SPREAD
    density = (1 - CUT) * np.exp(-0.5 * deviation**2) + CUT * FACING_SPREAD
    return np.asarray(-np.log(density))


def visible_cost(transform: Transform, places: Places) -> Array:
    """Of each pixel: what is seen faces the camera, n·v > 0 but for `FACING_MIN`."""
    normals, _ = directions(places.vectors @ transform.normals)
    towards = np.einsum("pi,pi->p", normals, places.views)
    return np.asarray(np.logaddexp(0.0, -towards / FACING_MIN))


def slope_cost(transform: Transform, places: Places) -> Array:
    """Of the surface: the mean of n·v is as of surfaces; a weak prior, of one observation."""
    normals, _ = directions(places.vectors @ transform.normals)
    mean = float(np.einsum("pi,pi->", normals, places.views)) / len(normals)
    return np.array([0.5 * ((mean - SLOPE_MEAN) / SLOPE_SPREAD) ** 2])


def front_cost(transform: Transform, places: Places) -> Array:
    """Of each lamp: it stands in front of the picture's plane, if only just."""
    towards, _ = directions(places.lamps @ transform.lamps)
    return np.asarray(np.logaddexp(0.0, -towards[:, 2] / BEHIND))


def guide_cost(transform: Transform, places: Places) -> Array:
    """Of each pixel: its normal is about the given one, but at a share `CUT`."""
    if places.guide is None:
        return np.zeros(1)
    normals, _ = directions(places.vectors @ transform.normals)
    known = np.isfinite(places.guide).all(axis=1)
    cosine = np.einsum("pi,pi->p", normals, np.where(known[:, None], places.guide, normals))
    density = (1 - CUT) * np.exp(GUIDE_CONCENTRATION * (cosine - 1)) + CUT / GUIDE_CONCENTRATION
    return np.asarray(np.where(known, -np.log(density), 0.0))


@dataclass(frozen=True)
class Cue:
    """A cue, and what its terms are observations of; None = each term is one."""

    name: str
    cost: Callable[[Transform, Places], Array]
    blocks: Callable[[Places], int] | None

    def value(self, transform: Transform, places: Places) -> float:
        """Its negative log likelihood but for a constant: terms, or blocks times their mean."""
        terms = self.cost(transform, places)
        if not len(terms):
            return 0.0
        if self.blocks is None:
            return float(terms.sum())
        return self.blocks(places) * float(terms.mean())


def _surface(places: Places) -> int:
    return len(np.unique(places.blocks))


def _outline(places: Places) -> int:
    return len(np.unique(places.outline_blocks))


CUES = (
    Cue("integrability", integrability_cost, lambda p: p.integrability.blocks),
    Cue("albedo", albedo_cost, _surface),
    Cue("strengths", strength_cost, None),
    Cue("outline azimuth", azimuth_cost, _outline),
    Cue("outline slant", facing_cost, _outline),
    Cue("visible", visible_cost, _surface),
    Cue("slope", slope_cost, None),
    Cue("lamps in front", front_cost, None),
    Cue("guide", guide_cost, _surface),
)
"""In this order in every report."""
