"""Where a fit of lamps begins where normals are given: lamps far away, or near ones.

Both take surfaces for matt, I = ρ c s with the shading s of a lamp, and alternate between the
albedo ρ of each pixel and the lamp of each picture, robustly: shadows and highlights are outliers.

**Far.** s = (n·ω)⁺ is linear in the lamp's vector l = c ω where it shines, so that each picture is
a weighted linear least-squares problem in three numbers.

**Near.** s = (n·ω)⁺/d² is not. Positions on a grid around the scene are tried, coarse to fine, and
judged by Σ|I − c ρ s|/Σ I with the c that makes it least, a weighted median of I/(ρ s).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.joint import ALBEDO_MEAN
from pbrfit.fit.lamps.problem import LampPixels
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.model.lamps import Lamps

Array = NDArray[np.float64]

ROUNDS = 25
"""Of albedo and lamps, far away: each costs two sums over the samples."""

NEAR_ROUNDS = 5
"""Of albedo and positions."""

NEAR_PIXELS = 400
"""That positions are judged by."""

GRID = (11, 9, 11)
"""Positions from left to right, bottom to top, and front to back."""

REFINEMENTS = 5
"""Times that the grid around the best position is halved: to 1/32 of a cell."""

OUTSIDE = 0.3
"""How far beyond what is seen lamps are sought, of its size; behind the camera as far as the median
distance."""

TINY = 1e-12


def far_lamps(pixels: LampPixels) -> tuple[Lamps, Array]:
    """A lamp far away for each picture, and albedos (P, 3), by the given normals."""
    grey = pixels.samples.mean(axis=-1)
    usable = (pixels.weights > 0).all(axis=-1) & (pixels.limits == 0).all(axis=-1)
    albedo = _typical(grey, usable)
    vectors = np.zeros((pixels.pictures, 3))
    weights = usable.astype(np.float64)
    for _ in range(ROUNDS):
        regressors = pixels.normals * albedo[:, None]
        for i in range(pixels.pictures):
            w = weights[:, i] * ((pixels.normals @ vectors[i] > 0) | (not vectors[i].any()))
            matrix = regressors.T @ (w[:, None] * regressors)
            ridge = 1e-9 * np.trace(matrix) + TINY
            vectors[i] = np.linalg.solve(
                matrix + ridge * np.eye(3), regressors.T @ (w * grey[:, i])
            )
        shading = np.maximum(pixels.normals @ vectors.T, 0)
        residual = grey - albedo[:, None] * shading
        spread = 1.4826 * np.median(np.abs(residual[usable])) + TINY
        weights = usable / (1 + (residual / (2 * spread)) ** 2)
        lit = weights * (shading > 0)
        albedo = (lit * grey * shading).sum(axis=1) / ((lit * shading**2).sum(axis=1) + TINY)
        albedo = np.maximum(albedo, 0) + TINY
    strength = np.maximum(np.linalg.norm(vectors, axis=-1), TINY)
    directions = np.where(strength[:, None] > 2 * TINY, vectors / strength[:, None], [0.0, 0, 1])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    shading = np.maximum(pixels.normals @ directions.T, 0)
    return colored_by(
        pixels, Lamps(np.arange(pixels.pictures), directions), shading, weights * (shading > 0)
    )


def near_lamps(pixels: LampPixels, front: float = 1.0) -> tuple[Lamps, Array, float]:
    """A near lamp for each picture, albedos (P, 3), and how much they leave: Σ|I − c ρ s|/Σ I."""
    assert pixels.points is not None
    few = pixels.of_rows(evenly_spaced(len(pixels), NEAR_PIXELS).astype(np.intp))
    points = few.points
    assert points is not None
    grey = few.samples.mean(axis=-1)
    usable = (few.weights > 0).all(axis=-1) & (few.limits == 0).all(axis=-1)
    albedo = _typical(grey, usable)
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    size = high - low
    low, high = low - OUTSIDE * size, high + OUTSIDE * size
    low[2], high[2] = low[2], front * float(np.median(np.linalg.norm(points, axis=-1)))
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, GRID, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    cell = np.array([axis[1] - axis[0] for axis in axes])
    places = np.zeros((pixels.pictures, 3))
    left = np.zeros(pixels.pictures)
    everywhere = _shading(few, grid)
    corners = np.stack(np.meshgrid(*[[-0.5, 0.0, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(NEAR_ROUNDS):
        shading = np.zeros_like(grey)
        for i in range(pixels.pictures):
            scores, colors = _judged(grey[:, i], albedo, everywhere, usable[:, i])
            best = int(np.argmin(scores))
            place, width = grid[best], cell
            for _ in range(REFINEMENTS):
                around = place + corners * width
                nearby = _shading(few, around)
                scores, colors = _judged(grey[:, i], albedo, nearby, usable[:, i])
                best = int(np.argmin(scores))
                place, width = around[best], width / 2
                left[i], shading[:, i] = scores[best], colors[best] * nearby[best]
            places[i] = place
        ratio = np.where(usable & (shading > 0), grey / np.maximum(shading, TINY), np.nan)
        with np.errstate(all="ignore"):
            found = np.nanmedian(ratio, axis=1)
        found = np.where(np.isfinite(found) & (found > 0), found, np.nanmedian(found))
        albedo = found * (albedo.mean() / found.mean())
    lamps = Lamps(np.arange(pixels.pictures), places, np.ones(pixels.pictures, bool))
    shading = _shading(pixels, places).T
    ordinary = (pixels.weights > 0).all(axis=-1) & (pixels.limits == 0).all(axis=-1)
    lamps, of_all = colored_by(pixels, lamps, shading, ordinary * (shading > 0))
    return lamps, of_all, float(left.mean())


def _shading(pixels: LampPixels, places: Array) -> Array:
    """(G, P): (n·ω)⁺/d² of lamps at G places."""
    assert pixels.points is not None
    away = places[:, None] - pixels.points
    squared = np.maximum((away**2).sum(axis=-1), TINY)
    cosine = np.einsum("gpx,px->gp", away, pixels.normals)
    return np.maximum(cosine, 0) / (squared * np.sqrt(squared))


def _judged(
    grey: Array, albedo: Array, shading: Array, usable: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """(G,) each: what lamps leave of a picture, and their colours."""
    shown = albedo[usable] * shading[:, usable]
    grey = grey[usable]
    ratio = grey / np.maximum(shown, TINY)
    order = np.argsort(ratio, axis=1)
    heavy = np.cumsum(np.take_along_axis(shown, order, axis=1), axis=1)
    middle = (heavy < 0.5 * heavy[:, -1:]).sum(axis=1)
    middle = np.minimum(middle, ratio.shape[1] - 1)
    at = np.take_along_axis(order, middle[:, None], axis=1)
    color = np.take_along_axis(ratio, at, axis=1)
    color = np.where(heavy[:, -1:] > 0, color, 0.0)
    return np.abs(grey - color * shown).sum(axis=1) / max(grey.sum(), TINY), color[:, 0]


def _typical(grey: Array, usable: NDArray[np.bool_]) -> Array:
    """(P,): brightness over the pictures, each over its mean: an albedo to begin with."""
    count = np.maximum(usable.sum(axis=0), 1)
    mean = np.maximum((grey * usable).sum(axis=0) / count, TINY)
    found = (grey / mean * usable).sum(axis=1) / np.maximum(usable.sum(axis=1), 1)
    return np.maximum(found, 0) + TINY


def colored_by(
    pixels: LampPixels, lamps: Lamps, shading: Array, weights: Array
) -> tuple[Lamps, Array]:
    """Lamps with colours, and albedos (P, 3), by shading (P, K) and weights of the samples."""
    count = len(lamps)
    colors = np.ones((count, 3))
    albedo = np.ones((len(pixels), 3))
    data = weights[..., None] * pixels.samples[:, lamps.pictures]
    squares = weights * shading**2
    for _ in range(10):
        of_pixels = np.einsum("pic,pi,ic->pc", data, shading, colors)
        albedo = np.maximum(of_pixels / (squares @ colors**2 + TINY), 0) + TINY
        of_lamps = np.einsum("pic,pi,pc->ic", data, shading, albedo)
        colors = np.maximum(of_lamps / (squares.T @ albedo**2 + TINY), 0) + TINY
    # What both share: the tint, so that the lamps are grey on the whole, as of pictures whose white
    # was balanced, and the scale, so that the mean albedo is what it mostly is.
    tint = np.exp(np.log(colors).mean(axis=0))
    albedo, colors = albedo * tint, colors / tint
    mean = max(float(albedo.mean()), TINY) / ALBEDO_MEAN
    found = Lamps(
        lamps.pictures, lamps.places, lamps.near, colors * mean, lamps.axes, lamps.exponents
    )
    return found, np.clip(albedo / mean, 0.01, 0.95)
