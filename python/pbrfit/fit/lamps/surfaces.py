"""The surfaces of all pixels under lamps that were found: shadows, metals, deviations.

**Shadows.** Whether a sample is an outlier is judged with its neighbours where it is too dark: a
cast shadow covers more than a pixel. The log odds of being ordinary are averaged over 3 × 3 pixels
there. What is too bright is judged alone: highlights are as narrow as they are.

**Metals.** A surface is a dielectric or a metal, and never a half of each, whose highlights neither
has. Each pixel is fitted as both, to some of the pictures; what these show wrong in the others
decides, for of what the model does not have highlights of metals make up in pictures that they are
fitted to. With S the squares of n pictures that a kind leaves, of a variance that nobody knows,

    ln p(y | metal) − ln p(y | dielectric) = (n/2) ln (S_dielectric / S_metal).

Log odds are averaged over 3 × 3 pixels, none as more than 5. The share of metals of each label is
found by expectation and maximisation. Matt neighbours tell nothing of a metal's roughness, so a
metal has a prior of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.joint import (
    UNKNOWNS,
    Freedom,
    JointLamps,
    SurfacePrior,
    fit_surfaces,
    unknowns_of,
)
from pbrfit.fit.lamps.problem import LampPixels, LampState, by_pieces, radiance, surface_of
from pbrfit.fit.lamps.sample_noise import Noise, kept_and_judged, probability, seen_error
from pbrfit.fit.pixels import NEIGHBOURS
from pbrfit.fit.sampling import beside
from pbrfit.model.geometry import unit
from pbrfit.values.arrays import Array, Mask

STEPS = 12
"""Of each pixel in a round."""

METAL_SHARE = 0.05
"""Share of metals that each label is expected to have before it was looked at."""


@dataclass(frozen=True, eq=False)
class Band:
    """What was found of some pixels of a scene."""

    state: LampState
    variance: Array
    marginal: Array
    """(P, 7) each: of offsets, albedo, roughness, metallic by the data alone, with the lights held
    and with the lights as uncertain as they are."""
    squares: float
    total: float
    """Weighted sum of squared residuals, and sum of the scene's weights."""


def bands(valid: Mask, at_most: int = 40_000) -> Iterator[slice]:
    """Ranges of the valid pixels that make up whole rows: some 100 MB with 12 pictures."""
    size, start = 0, 0
    for count in valid.sum(axis=1).tolist():
        if size and size + count > at_most:
            yield slice(start, start + size)
            start, size = start + size, 0
        size += count
    if size:
        yield slice(start, start + size)


def neighbour_means(
    values: Array, places: NDArray[np.intp], width: int, labels: NDArray[np.intp] | None = None
) -> Array:
    """(P, ...): means over the 3 × 3 pixels around each: of those that are there, of its label."""
    found, counts = np.zeros_like(values), np.zeros(len(values))
    around = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    for other in beside(places, width, around):
        alike = other >= 0
        if labels is not None:
            alike &= labels[other] == labels
        found[alike] += values[other[alike]]
        counts += alike
    return found / counts.reshape(-1, *[1] * (values.ndim - 1))


@dataclass(frozen=True, eq=False)
class SurfaceFit:
    """Pixels under lights that are known, how their samples are off, and what is likely of them."""

    pixels: LampPixels
    noise: Noise
    prior: SurfacePrior
    free_normals: bool

    def of_rows(self, rows: NDArray[np.intp]) -> SurfaceFit:
        """Of some of the pixels."""
        return replace(self, pixels=self.pixels.of_rows(rows), prior=self.prior.of_rows(rows))

    def surprise(self, state: LampState) -> Array:
        """(P,): −ln of the posterior of each pixel's surface, up to a constant."""
        away = unknowns_of(self.pixels, state) - self.prior.mean[:, :UNKNOWNS]
        squares = self.prior.precision[:, :UNKNOWNS] * away**2
        likelihoods = self.noise.judged(self.pixels, state).likelihoods
        return np.asarray(0.5 * squares.sum(axis=-1) - likelihoods)

    def fitted(
        self, state: LampState, weights: Array, *, free_roughness: bool = True
    ) -> tuple[LampState, Array]:
        """The best surfaces by weights of the samples (P, N, 3), and their costs."""
        free = {"free_normals": self.free_normals, "free_roughness": free_roughness}
        return fit_surfaces(self.pixels, state, weights, self.prior, iterations=STEPS, **free)

    def robust(
        self,
        state: LampState,
        rounds: int = 1,
        *,
        free_roughness: bool = True,
        width: int | None = None,
    ) -> tuple[LampState, Array]:
        """Weights and surfaces in turn.

        With the `width` of the picture samples are judged with their neighbours.
        """
        weights = np.zeros(0)
        for _ in range(rounds):
            judged, odds = self.noise.judged(self.pixels, state), None
            if width is not None:
                around = np.clip(judged.odds, -20, 20)
                around = neighbour_means(around, self.pixels.places, width)
                # Infinite where not too dark.
                odds = np.where(np.isfinite(judged.odds), around, judged.odds)
            weights = judged.weighed(odds)
            state, _ = self.fitted(state, weights, free_roughness=free_roughness)
        return state, weights


def better_of(
    state: LampState,
    surprising: Array,
    other: LampState,
    of_other: Array,
    rows: NDArray[np.intp] | slice = slice(None),
) -> tuple[LampState, Array]:
    """Surfaces of pixels, with others, of some rows, where these surprise less; and surprise."""
    less = of_other < surprising[rows]
    taken, surprising = np.arange(len(surprising))[rows][less], surprising.copy()
    surprising[taken] = of_other[less]
    surface = [values.copy() for values in surface_of(state)]
    for values, others in zip(surface, surface_of(other), strict=True):
        values[taken] = others[less]
    return state.with_surface(*surface), surprising


def mirroring(directions: Array, views: Array) -> Array:
    """(..., 3): normals that mirror lamps to the camera, half way between both unit vectors."""
    return unit(directions + views, 1e-9)


def facing_highlights(pixels: LampPixels, state: LampState) -> LampState:
    """The same surfaces, turned so that each mirrors the lamp of its brightest sample."""
    directions, strengths = state.incident(pixels)
    of_lamps = pixels.samples.mean(axis=-1)[:, state.lamps.pictures]
    lit = strengths * state.lamps.colors.mean(axis=-1)
    brightest = np.argmax(of_lamps / np.maximum(lit, 1e-12), axis=1)
    rows = np.arange(len(pixels)) if len(directions) > 1 else 0
    mirrors = mirroring(directions[rows, brightest], pixels.views)
    return state.with_surface(mirrors, state.albedo, state.roughness, state.metallic)


def fit_band(
    pixels: LampPixels,
    state: LampState,
    noise: Noise,
    prior: SurfacePrior,
    freedom: Freedom,
    width: int,
    *,
    metals: SurfacePrior | None,
    uncertain: Array | None,
    once: bool = False,
) -> Band:
    """Surfaces of some pixels; `uncertain`, the lights' covariance, where deviations are wanted.

    `metals` is the prior of those that are metals; None where metallic is known. `once` leaves
    surfaces as one fit finds them, dielectrics alone, in an eighth of the time.
    """
    given = SurfaceFit(pixels, noise, prior, freedom.normals)
    state, weights = given.robust(state)
    of_kind = state.metallic * (1 - state.metallic)
    if not once:
        state, weights, of_kind = _from_more_starts(given, state, width, metals)
    residual = pixels.residuals(radiance(pixels, state))
    variance = marginal = np.zeros((len(pixels), 7))
    if uncertain is not None:
        found = deviations(pixels, state, noise, weights, freedom, uncertain)
        variance, marginal = (np.column_stack([one, of_kind]) for one in found)
    squares = float((pixels.weights * residual**2).sum())
    return Band(state, variance, marginal, squares, float(pixels.weights.sum()))


def _from_more_starts(
    given: SurfaceFit, state: LampState, width: int, metals: SurfacePrior | None
) -> tuple[LampState, Array, Array]:
    """Surfaces, weights of samples and the variance of metallic, by fits from several starts."""
    pixels, free = given.pixels, given.free_normals

    def improved(begin: LampState, rows: NDArray[np.intp]) -> tuple[LampState, Array]:
        """With some pixels from another start, where that surprises less."""
        if not len(rows):
            return state, left
        some = given.of_rows(rows)
        found, _ = some.robust(begin.of_rows(rows))
        return better_of(state, left, found, some.surprise(found), rows)

    left = given.surprise(state)
    if free:
        moved, least = state, left
        # Surfaces of neighbours that surprise less there: one fits best where it was found.
        for other in beside(pixels.places, width, NEIGHBOURS):
            rows = np.flatnonzero((other >= 0) & (least[other] < least))
            if len(rows):
                trial = moved.of_rows(other[rows])
                told = given.of_rows(rows).surprise(trial)
                moved, least = better_of(moved, least, trial, told, rows)
        state, left = improved(moved, np.flatnonzero(least < left))
    else:
        for roughness in (0.15, 0.35, 0.75):  # a lobe that misses all samples has no slope
            begin = replace(state, roughness=np.full(len(pixels), roughness))
            state, left = improved(begin, np.arange(len(pixels)))
    # Shadows that hide behind a wrong normal show in the second round.
    state, weights = given.robust(state, 2, width=width)
    of_kind = state.metallic * (1 - state.metallic)
    if metals is not None:
        state, of_kind = _with_metals(given, metals, state, weights, width)
    if free:
        state = _as_seen(given, state)
    return state, weights, of_kind


def _as_seen(given: SurfaceFit, state: LampState) -> LampState:
    """The surfaces by least squares, from where robust fits have ended, roughness about as there.

    Samples that were taken to be in shadows count again. Among pictures that were left out of fits
    of eight objects this predicted all but one better, some by a quarter: of what is too dark much
    is no cast shadow but how surfaces are, and a normal that is a little off makes up for it.
    """
    mean = given.prior.mean.copy()
    mean[:, 5] = state.roughness
    around = replace(given.pixels, normals=state.normals)
    given = replace(given, pixels=around, prior=SurfacePrior(mean, given.prior.precision))
    # A deviation of 0.1 where the mean radiance is 0.4.
    return given.fitted(state, around.weights / 0.1**2)[0]


def _with_metals(
    given: SurfaceFit, metals: SurfacePrior, state: LampState, weights: Array, width: int
) -> tuple[LampState, Array]:
    """A state of dielectrics, with metals where these explain the samples better.

    `metals` is the prior of these. Also the variance of metallic (P,), never 0.
    """
    pixels, of_metals = given.pixels, replace(given, prior=metals)
    kept, judged = kept_and_judged(pixels.pictures)
    of_kept = weights * kept[None, :, None]
    count, number = len(pixels), np.count_nonzero(judged)

    def wrong(of: LampState) -> Array:
        """(P,): what is shown wrong."""
        return np.maximum(seen_error(pixels, of) @ judged, 1e-12)

    metal, of_metal = state, np.full(count, np.inf)
    for roughness in (0.35,) if given.free_normals else (0.35, 0.6):
        bright = np.clip(state.albedo * 1.5, 0.1, 1.0)
        begin = state.with_surface(state.normals, bright, np.full(count, roughness), np.ones(count))
        begin, cost = of_metals.fitted(begin, of_kept)
        metal, of_metal = better_of(metal, of_metal, begin, cost)
    dielectric, _ = given.fitted(state, of_kept)
    odds = 0.5 * number * np.log(wrong(dielectric) / wrong(metal))
    odds = neighbour_means(np.clip(odds, -5, 5), pixels.places, width, pixels.labels)
    share = metal_shares(odds, pixels.labels)
    odds += np.log(share / (1 - share))
    chance = probability(odds)
    rows = np.flatnonzero(chance > 0.5)
    if len(rows):
        found, _ = of_metals.of_rows(rows).fitted(metal.of_rows(rows), weights[rows])
        state, _ = better_of(state, chance, found, 1 - chance[rows], rows)
    return state, chance * (1 - chance)


def metal_shares(odds: Array, labels: NDArray[np.intp]) -> Array:
    """(P,): share of metals of each pixel's label.

    A segment is of one kind, which its pixels vote for, none with log odds of more than 3 and eight
    as one, as neighbours share what is left of them; some of its pixels may be of another: what is
    on it, or shines through. Of what is in no segment the share is found by expectation and
    maximisation.
    """
    found = np.full(len(odds), METAL_SHARE)
    for label in np.unique(labels):
        of = odds[labels == label]
        if label > 0:
            votes = float(np.clip(of, -3.0, 3.0).sum()) / 8
            total = votes + np.log(METAL_SHARE / (1 - METAL_SHARE))
            found[labels == label] = np.clip(probability(np.array(total)), 0.01, 0.95)
            continue
        share = METAL_SHARE
        for _ in range(30):
            chance = probability(of + np.log(share / (1 - share)))
            # One pixel's worth of the first share keeps it off 0 and 1.
            share = (float(chance.sum()) + METAL_SHARE) / (len(of) + 1)
        found[labels == label] = np.clip(share, 1e-4, 1 - 1e-4)
    return found


def deviations(
    pixels: LampPixels,
    state: LampState,
    noise: Noise,
    weights: Array,
    freedom: Freedom,
    covariance: Array,
) -> tuple[Array, Array]:
    """(P, 6) variances with lights held, and with lights as uncertain as `covariance`.

    At a bound they are those of the same curvature just inside: to the one side that is left.
    Infinite where samples tell nothing.
    """
    count = len(pixels)
    none = SurfacePrior(np.zeros((count, 7)), np.zeros((count, 7)))
    # Slopes of values at a bound are taken a little inside.
    albedo, rough = (np.clip(of, 1e-6, 1 - 1e-6) for of in (state.albedo, state.roughness))
    inside = replace(state, albedo=albedo, roughness=rough)
    # What is shared and known moves nothing.
    shared = np.flatnonzero(covariance.any(axis=0))
    of_shared = covariance[np.ix_(shared, shared)]

    def of(some: LampPixels, rows: slice) -> tuple[Array, Array]:
        fit = JointLamps(some, inside.of_rows(rows), noise, none.of_rows(rows), freedom)
        fit.weights = weights[rows]
        own, mixed = fit.pixel_system()
        np.einsum("puu->pu", own)[:] += 1e-9
        try:
            inverse = np.linalg.inv(own)
        except np.linalg.LinAlgError:  # sharp highlights tell so much that the rest is rounded off
            size = np.sqrt(np.einsum("puu,pvv->puv", own, own))
            inverse = np.linalg.inv(own / size + 1e-14 * np.eye(UNKNOWNS)) / size
        moved = mixed if len(shared) == mixed.shape[-1] else mixed[..., shared]
        moves = (inverse @ moved).reshape(UNKNOWNS * len(own), len(shared))
        more = ((moves @ of_shared) * moves).sum(axis=-1)
        held = np.einsum("puu->pu", inverse)
        return held, held + more.reshape(held.shape)

    variances = np.array(by_pieces(pixels, of))
    variances[~(variances > 0)] = np.inf  # singular but for rounding: the samples tell nothing
    return variances[0], variances[1]
