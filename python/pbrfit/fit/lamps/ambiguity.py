"""The matrix that a factorisation leaves open: the most likely one by all cues.

The unknown is the matrix of cofactors C (3, 3) of `integrability`. Pseudo-normals b become those of
the surface, and lamps s those in front of it, by

    m = ± C⁻¹ b,    l = ± Cᵀ s,

up to their scales, on which no cue depends, with the sign for which the surface faces the camera.
The albedo is |m|. Cues are negative log likelihoods, whose sum is minimised over C by the method of
Broyden, Fletcher, Goldfarb and Shanno from several starts, because it has several minima: a surface
and the one that is bulged in where it was bulged out, and flatter and steeper ones.

Cues differ in how many places they look at, and neighbours err alike: gloss, shadows and light from
other surfaces change slowly across a picture. A hundred pixels are not a hundred observations. So
the picture is divided in blocks, and a cue that is a mean over places counts as one observation a
block that has any (clusters that err as one: Kish, "Survey sampling", Wiley 1965; Varin, Reid and
Firth, "An overview of composite likelihood methods", Statistica Sinica 21, 2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from pbrfit.fit.lamps.integrability import Integrability, equations
from pbrfit.fit.lamps.photometric import PseudoNormals
from pbrfit.fit.lamps.sample_noise import RELATIVE_MIN
from pbrfit.fit.lamps.samples import BAS_RELIEF, Samples, blocks_of, some_of
from pbrfit.fit.sampling import pixel_index
from pbrfit.scene.outline import Outline
from pbrfit.values.arrays import Array

KNOWN_MIN = 0.05
"""Least part of a pixel's information, in the direction it says least of, of the median pixel's,
with which its normal is its own and not its neighbours'."""

STRENGTH_SPREAD = 0.1
"""Spread of the logarithm of lamps' strengths that is expected: one lamp moved by hand at arm's
length with 5 % of change in its distance."""

STRENGTH_CERTAINTY = 4.0
"""Lamps that the expected spread counts as, beside those there are."""

CUT = 0.2
"""Share of the outline where nothing turns away: an edge of a table, of another thing."""

FACING_MIN = 0.05
"""n·v, 87 degrees: what pixels show of steeper surfaces is less than half a pixel's own."""

SQUARE_ON = np.radians(20.0)
"""Standard deviation of the angle between the mean normal and the camera's axis: who takes pictures
of a thing stands in front of it."""

BEHIND = 0.1
"""Cosine of the angle to the camera's axis: how far lamps may be behind the picture's plane before
they cost as much as a deviation from a cue's own spread."""


@dataclass(frozen=True, eq=False)
class Places:
    """Pixels that cues look at, and what the pictures say there.

    Attributes
    ----------
    chosen
        (P,) which of the mask's pixels they are.
    vectors, views
        (P, 3) b, divided by brightness, and (P, 3).
    blocks
        Blocks of the picture that they lie in.
    brightness
        (P,) what b is multiplied by.
    pairs
        (R, 2) indices of pixels that may share an albedo.
    outline_vectors, outline_blocks
        The same at the outline, (E, 3) and a number.
    of_ball
        (E, 3) normals that are expected there, as in `outline`.
    lamps
        (N, 3) s.
    integrability
        Its equations.
    """

    chosen: NDArray[np.intp]
    vectors: Array
    views: Array
    blocks: int
    brightness: Array
    pairs: NDArray[np.intp]
    outline_vectors: Array
    outline_blocks: int
    of_ball: Array
    lamps: Array
    integrability: Integrability

    @classmethod
    def of(
        cls,
        data: Samples,
        rays: Array,
        views: Array,
        normals: PseudoNormals,
        lamps: Array,
        edge: Outline,
    ) -> Places:
        """Places of pixels whose own samples tell their normals."""
        blocks = blocks_of(data.where)
        information = normals.information(np.eye(3), data.threads)[:, 0]
        least = KNOWN_MIN * float(np.median(information))
        good = information > least
        index = pixel_index(data.mask)

        def covariances(row: NDArray[np.intp], column: NDArray[np.intp]) -> Array:
            precision = normals.precision(index[row, column], np.eye(3))
            return np.asarray(np.linalg.inv(precision + (least + 1e-12) * np.eye(3)))

        known = data.plane(good, 0.0).astype(bool)
        of_block = data.plane(blocks.astype(np.float64), -1.0).astype(np.intp)
        planes = data.plane(np.where(good[:, None], normals.vectors, 0.0), 0.0)
        integrable = equations(planes, covariances, known, rays, of_block)
        candidates = np.flatnonzero(good)
        # The sampling error of a mean over so many, 2 %, is below that of the blocks, 12 %.
        chosen = candidates[some_of(len(candidates), 2500)]
        at_edge = np.flatnonzero(known[edge.rows, edge.columns])
        at_edge = at_edge[some_of(len(at_edge), 600)]
        where = (edge.rows[at_edge], edge.columns[at_edge])
        return cls(
            chosen=chosen,
            vectors=normals.vectors[chosen],
            views=views[data.where][chosen],
            blocks=len(np.unique(blocks[chosen])),
            brightness=data.brightness[chosen],
            pairs=_pairs(data, normals, chosen),
            outline_vectors=planes[where],
            of_ball=edge.normals[at_edge],
            outline_blocks=len(np.unique(of_block[where])),
            lamps=lamps,
            integrability=integrable,
        )


def _pairs(data: Samples, normals: PseudoNormals, chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """(R, 2) places, each beside the one of the likest colour of twelve at random."""
    count = len(chosen)
    if count < 2:
        return np.zeros((0, 2), np.intp)
    colors, told = data.colors(chosen)
    weights = normals.weights(chosen) * told.all(axis=2)
    sums = np.einsum("pn,pnc->pc", weights, colors)
    chroma = sums / np.maximum(sums.sum(axis=1, keepdims=True), 1e-12)
    others = np.random.default_rng(0).integers(0, count - 1, (count, 12))
    first = np.arange(count)
    others += others >= first[:, None]
    unlike = np.sum((chroma[others] - chroma[:, None]) ** 2, axis=2)
    return np.stack([first, others[first, unlike.argmin(axis=1)]], axis=1)


def unit_and_length(vectors: Array) -> tuple[Array, Array]:
    """Unit vectors (..., 3) and lengths (...), which are kept above 0."""
    squared = np.einsum("...i,...i->...", vectors, vectors)
    length: Array = np.sqrt(np.maximum(squared, 1e-24))
    return vectors / length[..., None], length


def _dot(first: Array, second: Array) -> Array:
    return np.asarray(np.einsum("pi,pi->p", first, second))


# Cues: each gives its negative log likelihood, but for a constant, and its slopes.


def albedo_cost(length: Array, places: Places) -> tuple[float, Array]:
    """Of each pair: pixels are of a few albedos, so differences of ln |m| are mostly small.

    Their density is Cauchy's, ln s + ln(1 + (r/s)²): its tails are for pairs of different albedos.
    The sum with the best s is the logarithm of a robust spread, and so close to an entropy
    (Alldrin, Mallick and Kriegman, "Resolving the generalized bas-relief ambiguity by entropy
    minimization", CVPR 2007). The slope is by ln |m|; the best s has none.
    """
    logs = np.log(length * places.brightness)
    first, second = places.pairs.T
    residual = logs[first] - logs[second]
    scale = _cauchy_scale(residual)
    cost = np.log(scale) + np.log1p((residual / scale) ** 2).mean()
    push = 2 * residual / (scale**2 + residual**2) / len(residual)
    slope = np.zeros(len(logs))
    np.add.at(slope, first, push)
    np.subtract.at(slope, second, push)
    return places.blocks * float(cost), places.blocks * slope


def _cauchy_scale(residuals: Array) -> float:
    """Most likely scale s of Cauchy's distribution for residuals: the mean of 1/(1 + (r/s)²) is ½.

    By Newton's method in ln s.
    """
    squared: Array = residuals**2
    scale = max(float(np.median(np.abs(residuals))), RELATIVE_MIN)
    for _ in range(6):
        share = scale**2 / (scale**2 + squared)
        step = (0.5 - float(np.mean(share))) / max(float(np.mean(2 * share * (1 - share))), 1e-3)
        scale = max(scale * float(np.exp(np.clip(step, -1.0, 1.0))), RELATIVE_MIN)
    return scale


def integrability_cost(C: Array, places: Places) -> tuple[float, Array]:
    """Equations are normal with a variance that is ν times that of their noise.

    With the best ν this is ½ ln(CᵀQC/CᵀNC) an observation. The slope is by C.
    """
    of = places.integrability
    c = C.T.ravel()
    by_squares, by_noise = of.squares @ c, of.noise @ c
    squares = max(float(c @ by_squares), 1e-300)
    noise = max(float(c @ by_noise), 1e-300)
    slope = of.blocks * (by_squares / squares - by_noise / noise)
    return 0.5 * of.blocks * float(np.log(squares / noise)), slope.reshape(3, 3).T


def strength_cost(length: Array) -> tuple[float, Array]:
    """Of all lamps: they are equally strong but for a spread that is not known.

    Normal ln |l| whose variance has an inverse χ² distribution of `STRENGTH_CERTAINTY` degrees of
    freedom about `STRENGTH_SPREAD`² make Student's distribution, here of the deviations from their
    mean. The slope is by ln |l|.
    """
    logs = np.log(length)
    deviation = logs - logs.mean()
    spread = STRENGTH_CERTAINTY * STRENGTH_SPREAD**2
    freedom = STRENGTH_CERTAINTY + len(logs) - 1
    total = spread + deviation @ deviation
    return freedom / 2 * float(np.log(total / spread)), freedom * deviation / total


def outline_cost(normals: Array, places: Places) -> tuple[float, Array]:
    """Of each pixel at the outline: the normal is as of a ball, but at a share `CUT`.

    The slope is by normals, as that of the next cue.
    """
    kappa = 15.0  # of von Mises' and Fisher's distribution: a deviation of 15 degrees
    peaked = (1 - CUT) * 2 * kappa * np.exp(kappa * (_dot(normals, places.of_ball) - 1))
    share = places.outline_blocks / len(normals)
    slope = -share * kappa * (peaked / (peaked + CUT))[:, None] * places.of_ball
    return -share * float(np.log(peaked + CUT).sum()), slope


def visible_cost(normals: Array, places: Places) -> tuple[float, Array]:
    """Of each pixel: what is seen faces the camera, n·v > 0 but for `FACING_MIN`."""
    away = -_dot(normals, places.views) / FACING_MIN
    share = places.blocks / len(normals)
    push = -share / FACING_MIN * expit(away)
    return share * float(np.logaddexp(0.0, away).sum()), push[:, None] * places.views


def square_on_cost(normals: Array) -> tuple[float, Array]:
    """Of all pixels as one observation: their mean normal faces the camera."""
    mean, length = unit_and_length(normals.mean(axis=0))
    axis = np.array([0.0, 0.0, 1.0])
    push = -(axis - mean[2] * mean) / (length * len(normals) * SQUARE_ON**2)
    return (1 - float(mean[2])) / SQUARE_ON**2, np.broadcast_to(push, normals.shape)


def front_cost(directions: Array) -> tuple[float, Array]:
    """Of each lamp: it stands in front of the picture's plane, if only just."""
    behind = -directions[:, 2] / BEHIND
    slope = np.zeros_like(directions)
    slope[:, 2] = -expit(behind) / BEHIND
    return float(np.logaddexp(0.0, behind).sum()), slope


@dataclass(frozen=True, eq=False)
class Minimum:
    """What the cues say of a C (3, 3).

    Attributes
    ----------
    normals, lamps
        (3, 3): what b and s are multiplied by, in rows.
    cost
        Negative log likelihood, but for a constant, of all cues.
    slope
        (3, 3), of it by C.
    """

    normals: Array
    lamps: Array
    cost: float
    slope: Array

    @classmethod
    def at(cls, C: Array, places: Places) -> Minimum:
        """What the cues say of C (3, 3)."""
        inverse = np.asarray(np.linalg.inv(C).T, np.float64)
        facing = _dot(places.vectors @ inverse, places.views)
        sign = 1.0 if (facing > 0).mean() >= 0.5 else -1.0
        normals, albedo = unit_and_length(sign * places.vectors @ inverse)
        directions, strengths = unit_and_length(sign * places.lamps @ C)
        of_surface, slope = integrability_cost(C, places)
        of_albedo, by_albedo = albedo_cost(albedo, places)
        of_strengths, by_strengths = strength_cost(strengths)
        of_visible, by_visible = visible_cost(normals, places)
        of_front, by_front = front_cost(directions)
        of_mean, by_mean = square_on_cost(normals)
        by_visible = by_visible + by_mean
        cost = of_surface + of_albedo + of_strengths + of_visible + of_front + of_mean
        by_inverse = places.vectors.T @ _by_vectors(normals, albedo, by_visible, by_albedo)
        by_lamps = places.lamps.T @ _by_vectors(directions, strengths, by_front, by_strengths)
        if len(places.outline_vectors):
            at_edge, length = unit_and_length(sign * places.outline_vectors @ inverse)
            of_edge, by_edge = outline_cost(at_edge, places)
            cost += of_edge
            by_edge = _by_vectors(at_edge, length, by_edge, np.zeros(len(length)))
            by_inverse = by_inverse + places.outline_vectors.T @ by_edge
        # d C⁻ᵀ = -C⁻ᵀ dCᵀ C⁻ᵀ
        slope = slope + sign * (by_lamps - inverse @ by_inverse.T @ inverse)
        return cls(sign * inverse, sign * C, cost, slope)


@dataclass(frozen=True, eq=False)
class Relief:
    """The cues by the bas-relief that turns normals n to M n, from those of a matrix C (3, 3)."""

    C: Array
    places: Places

    def __call__(self, M: Array) -> tuple[float, Array]:
        """Twice the negative log likelihood, and half its slope by G, M' = (1 + G) M, (3,).

        C⁻ᵀ bᵀ becomes M C⁻ᵀ bᵀ, so C becomes C M⁻¹.
        """
        here = Minimum.at(self.C @ np.linalg.inv(M), self.places)
        # C (1 + G)⁻¹ changes by −C G.
        slope = -np.einsum("gij,ki,kj->g", BAS_RELIEF, here.lamps, here.slope)
        return 2 * here.cost, slope

    def curvature(self, M: Array) -> Array:
        """(3, 3): half the second derivatives there, of which none is negative."""
        step = 0.02
        ends = [[self(M + sign * step * one @ M)[1] for sign in (1.0, -1.0)] for one in BAS_RELIEF]
        found = np.array([(up - down) / (2 * step) for up, down in ends])
        values, axes = np.linalg.eigh((found + found.T) / 2)
        return np.asarray((axes * np.maximum(values, 0.0)) @ axes.T)


def _by_vectors(unit: Array, length: Array, by_unit: Array, by_log: Array) -> Array:
    """Slopes (P, 3) by vectors of those by their unit vectors and by the logarithm of lengths."""
    along = by_log - _dot(unit, by_unit)
    return np.asarray((by_unit + along[:, None] * unit) / length[:, None])


def minima(places: Places, rough: Array | None) -> list[Minimum]:
    """Minima of the negative log likelihood that searches lead to, the least first.

    Parameters
    ----------
    places
        What cues look at.
    rough
        (P, 3) normals of a rough shape to start from beside other starts; None = there is none.
    """

    def cost_and_slope(c: Array) -> tuple[float, Array]:
        here = Minimum.at(c.reshape(3, 3), places)
        return here.cost, here.slope.ravel()

    # C, of length 1, changes the surface by a degree where an entry changes by about 0.02.
    found = [
        minimize(cost_and_slope, C.ravel(), jac=True, method="BFGS", options={"gtol": 0.1}).x
        for C in _starts(places, rough)
    ]
    return sorted((Minimum.at(c.reshape(3, 3), places) for c in found), key=lambda one: one.cost)


def _starts(places: Places, rough: Array | None) -> list[Array]:
    """Matrices C (3, 3) of length 1.

    c₁ and c₂ are as integrability has them, with either sign, and c₃ such that lamps stand about
    equally far in front; beside these, the matrix that makes the surface most like a rough one.
    """
    starts = []
    lamps = places.lamps
    null = places.integrability.null_vector()
    level = np.linalg.lstsq(lamps, np.ones(len(lamps)), rcond=None)[0]
    for sign in (1.0, -1.0):
        across = sign * null.T
        size = np.sqrt(np.mean(np.sum((lamps @ across) ** 2, axis=1)))
        # The tangent of the lamps' root mean square angle to the camera's axis is ½, 27 degrees.
        starts.append(np.column_stack([across, 2 * size * level]))
    if rough is not None:
        starts.append(_like(places.vectors, rough))
    starts = [C / np.linalg.norm(C) for C in starts if np.isfinite(C).all()]
    return [C for C in starts if abs(np.linalg.det(C)) > 1e-10]


def _like(vectors: Array, normals: Array) -> Array:
    """C of the G with which b G is most like albedo times given normals, in alternation."""
    G = np.linalg.lstsq(vectors, normals, rcond=None)[0]
    for _ in range(10):
        albedo = np.maximum(_dot(vectors @ G, normals), 0.0)
        weight = 1 / (albedo + 0.1 * albedo.mean() + 1e-12)
        G = np.linalg.lstsq(
            vectors * weight[:, None], normals * (albedo * weight)[:, None], rcond=None
        )[0]
        G /= max(np.linalg.norm(G), 1e-12)
    if np.linalg.matrix_rank(G, tol=1e-6) < 3:
        return np.full((3, 3), np.nan)
    return np.asarray(np.linalg.inv(G).T)
