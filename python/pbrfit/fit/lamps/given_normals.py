"""Where a fit of lamps begins where normals are given: lamps far away, or near ones.

Both take surfaces for matt, I = ρ c s with the shading s of a lamp, and alternate between the
albedo ρ of each pixel and the lamp of each picture, robustly: shadows and highlights are outliers.

**Far.** s = (n·ω)⁺ is linear in the lamp's vector l = c ω where it shines, so that each picture is
a weighted linear least-squares problem in three numbers.

**Near.** s = (n·ω)⁺/d² is not. Positions on a grid around the scene are tried, coarse to fine, and
judged by the mean of |ln I − ln c ρ s|, of which no more than 1 counts, with the c that makes it
least, a median. A pixel that is dark and should not be, or the reverse, counts 1.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from pbrfit.fit.lamps.joint import ALBEDO_MEAN
from pbrfit.fit.lamps.photometric import DARK
from pbrfit.fit.lamps.problem import LampPixels
from pbrfit.fit.lamps.samples import grey_samples
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.model.geometry import unit
from pbrfit.model.lamps import Lamps
from pbrfit.values.arrays import Array, Mask

OUTSIDE = 0.3
"""How far beyond what is seen lamps are sought, of its size; behind the camera as far as the median
distance."""

FINAL_SCALE = 0.02
"""Scale of residuals, a logarithm, that weights end with: 2 %."""

TINY = 1e-12
"""Radiance, or what stands below a fraction, that counts as none."""


def far_lamps(pixels: LampPixels) -> tuple[Lamps, Array]:
    """A lamp far away for each picture, and albedos (P, 3), by the given normals."""
    grey, usable = grey_samples(pixels.samples, pixels.told)
    # To begin with brightness over the pictures, each over its mean.
    mean = (grey * usable).sum(axis=0) / np.maximum(usable.sum(axis=0), 1)
    albedo = (grey / np.maximum(mean, TINY) * usable).sum(axis=1)
    albedo = np.maximum(albedo / np.maximum(usable.sum(axis=1), 1), 0) + TINY
    vectors = np.zeros((pixels.pictures, 3))
    weights = usable.astype(np.float64)
    for _ in range(25):  # each costs two sums over the samples
        regressors = pixels.normals * albedo[:, None]
        for i in range(pixels.pictures):
            w = weights[:, i] * ((pixels.normals @ vectors[i] > 0) | (not vectors[i].any()))
            matrix = regressors.T @ (w[:, None] * regressors)
            matrix += (1e-9 * np.trace(matrix) + TINY) * np.eye(3)
            vectors[i] = np.linalg.solve(matrix, regressors.T @ (w * grey[:, i]))
        shading = np.maximum(pixels.normals @ vectors.T, 0)
        residual = grey - albedo[:, None] * shading
        spread = 1.4826 * np.median(np.abs(residual[usable])) + TINY
        weights = usable / (1 + (residual / (2 * spread)) ** 2)
        lit = weights * (shading > 0)
        albedo = (lit * grey * shading).sum(axis=1) / ((lit * shading**2).sum(axis=1) + TINY)
        albedo = np.maximum(albedo, 0) + TINY
    strength = np.maximum(np.linalg.norm(vectors, axis=-1), TINY)
    told = strength[:, None] > 2 * TINY
    directions = unit(np.where(told, vectors / strength[:, None], [0.0, 0, 1]))
    shading = np.maximum(pixels.normals @ directions.T, 0)
    lamps = Lamps(np.arange(pixels.pictures), directions)
    return colored_by(pixels, lamps, shading, weights * (shading > 0))


def near_lamps(pixels: LampPixels) -> tuple[Lamps, Array]:
    """A near lamp for each picture, and albedos (P, 3)."""
    few = pixels.of_rows(evenly_spaced(len(pixels), 400).astype(np.intp))  # judge positions
    points = few.points
    assert points is not None
    grey, usable = grey_samples(few.samples, few.told)
    # Not the mean brightness: it has the mean shading in it, to which lamps would then fit.
    albedo = np.full(len(few), ALBEDO_MEAN)
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    size = high - low
    low, high = low - OUTSIDE * size, high + OUTSIDE * size
    high[2] = float(np.median(np.linalg.norm(points, axis=-1)))
    counts = 11, 9, 11  # from left to right, bottom to top, and front to back
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    cell = np.array([axis[1] - axis[0] for axis in axes])
    places = np.zeros((pixels.pictures, 3))
    everywhere = _shading(few, grid)
    corners = np.stack(np.meshgrid(*[[-0.5, 0.0, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(8):  # of albedo and positions
        shading = np.zeros_like(grey)
        for i in range(pixels.pictures):
            scores, colors = _judged(grey[:, i], albedo, everywhere, usable[:, i])
            best = int(np.argmin(scores))
            place, width = grid[best], cell
            for _ in range(5):  # halved to 1/32 of a cell
                around = place + corners * width
                nearby = _shading(few, around)
                scores, colors = _judged(grey[:, i], albedo, nearby, usable[:, i])
                best = int(np.argmin(scores))
                place, width = around[best], width / 2
                shading[:, i] = colors[best] * nearby[best]
            places[i] = place
        bright = usable & (shading > 0) & (grey > DARK * grey.mean(axis=0))
        ratio = np.where(bright, np.log(np.maximum(grey, TINY) / np.maximum(shading, TINY)), np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # pixels that no lamp reaches
            found = np.nanmedian(ratio, axis=1)
        found = np.where(np.isfinite(found), found, np.nanmedian(found))
        albedo = np.exp(found - found.mean()) * ALBEDO_MEAN
    places = _refined(few, grey, usable, places, 1.0)
    grey, usable = grey_samples(pixels.samples, pixels.told)
    places = _refined(pixels, grey, usable, places, 0.1)
    lamps = Lamps(np.arange(pixels.pictures), places, np.ones(pixels.pictures, bool))
    shading = _shading(pixels, places).T
    return colored_by(pixels, lamps, shading, (shading > 0).astype(np.float64))


def _refined(few: LampPixels, grey: Array, usable: Mask, places: Array, first: float) -> Array:
    """Places by Gauss and Newton on logarithms.

    With a = ln ρ of each pixel and b = ln c of each lamp the residual ln I − a − b − ln s is linear
    in a and b, and ln s = ln n·(q−p) − 3 ln |q−p| has the slope n/(n·(q−p)) − 3 (q−p)/|q−p|² by q.
    Weights are those of Cauchy's distribution, whose scale falls from step to step, from `first`, a
    logarithm, so that shadows and highlights are left out in the end. The pixels' a are eliminated.
    """
    points, normals = few.points, few.normals
    assert points is not None
    count, lamps = grey.shape
    dark = grey < DARK * grey.mean(axis=0)
    logs = np.log(np.maximum(grey, TINY))
    a, b = np.zeros(count), np.zeros(lamps)
    for number in range(40):
        away = places[:, None] - points
        squared = np.maximum((away**2).sum(axis=-1), TINY)
        height = np.einsum("kpx,px->kp", away, normals)
        lit = (height > 0.02 * np.sqrt(squared)) & (usable & ~dark).T
        shade = np.log(np.maximum(height, TINY)) - 1.5 * np.log(squared)
        scale = max(first * 0.8**number, FINAL_SCALE)
        for _ in range(5 if number == 0 else 1):
            weights = lit / (1 + ((logs.T - a - b[:, None] - shade) / scale) ** 2)
            a = (weights * (logs.T - b[:, None] - shade)).sum(axis=0) / (weights.sum(axis=0) + TINY)
            b = (weights * (logs.T - a - shade)).sum(axis=1) / (weights.sum(axis=1) + TINY)
        residual = logs.T - a - b[:, None] - shade
        weights = lit / (1 + (residual / scale) ** 2)
        slope = normals / np.maximum(height, TINY)[..., None] - 3 * away / squared[..., None]
        slope = np.concatenate([slope, np.ones((lamps, count, 1))], axis=-1)
        slope = np.where(lit[..., None], slope, 0.0)
        own = weights.sum(axis=0) + 1e-6
        mixed = (weights[..., None] * slope).transpose(1, 0, 2).reshape(count, -1)
        matrix = np.zeros((4 * lamps, 4 * lamps))
        for k in range(lamps):
            block = slice(4 * k, 4 * k + 4)
            matrix[block, block] = slope[k].T @ (weights[k, :, None] * slope[k])
        gradient = np.einsum("kp,kpu->ku", weights * residual, slope).reshape(-1)
        gradient -= mixed.T @ ((weights * residual).sum(axis=0) / own)
        schur = matrix - mixed.T @ (mixed / own[:, None])
        schur += np.diag(0.02 * np.diag(matrix) + 1e-9)
        change = np.linalg.solve(schur, gradient).reshape(lamps, 4)
        length = np.linalg.norm(change[:, :3], axis=-1)
        longest = 0.3 * float(np.median(np.sqrt(squared)))
        places = places + change[:, :3] * np.minimum(1, longest / np.maximum(length, TINY))[:, None]
        b = b + change[:, 3]
    return places


def _shading(pixels: LampPixels, places: Array) -> Array:
    """(G, P): (n·ω)⁺/d² of lamps at G places."""
    assert pixels.points is not None
    away = places[:, None] - pixels.points
    squared = np.maximum((away**2).sum(axis=-1), TINY)
    cosine = np.einsum("gpx,px->gp", away, pixels.normals)
    return np.asarray(np.maximum(cosine, 0) / (squared * np.sqrt(squared)))


def _judged(grey: Array, albedo: Array, shading: Array, usable: Mask) -> tuple[Array, Array]:
    """(G,) each: what lamps leave of a picture, and their colours."""
    shown, lit = np.log(albedo * shading + TINY), shading > TINY
    there = usable & (grey > DARK * grey[usable].mean())
    both = lit & there
    ratio = np.where(both, np.log(np.maximum(grey, TINY)) - shown, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # lamps behind all that is seen
        color = np.nanmedian(ratio, axis=1)
    left = np.where(both, np.minimum(np.abs(ratio - color[:, None]), 1.0), lit != there)
    found = np.where(usable, left, 0.0).sum(axis=1) / max(int(usable.sum()), 1)
    known = np.isfinite(color)
    return np.where(known, found, np.inf), np.where(known, np.exp(np.where(known, color, 0)), 0.0)


def colored_by(
    pixels: LampPixels, lamps: Lamps, shading: Array, weights: Array
) -> tuple[Lamps, Array]:
    """Lamps with colours, and albedos (P, 3), by shading (P, K) and weights of the samples.

    As ln I = ln ρ + ln c + ln s, by weights of Cauchy's distribution whose scale falls: shadows and
    highlights are left out.
    """
    samples = pixels.samples[:, lamps.pictures]
    mean = np.maximum(pixels.samples.mean(axis=0)[lamps.pictures], TINY)
    lit = (weights > 0) & (shading > 0.05 * shading.max(axis=1, keepdims=True))
    usable = lit[..., None] & pixels.told[:, lamps.pictures] & (samples > DARK * mean)
    logs = np.log(np.maximum(samples, TINY)) - np.log(np.maximum(shading, TINY))[..., None]
    of_lamps = np.log(mean)
    of_pixels = np.zeros((len(pixels), 3))
    for number in range(30):
        scale = max(0.85**number, FINAL_SCALE)
        for _ in range(2):
            residual = logs - of_pixels[:, None] - of_lamps
            counted = usable / (1 + (residual / scale) ** 2)
            of_pixels = (counted * (logs - of_lamps)).sum(axis=1) / (counted.sum(axis=1) + TINY)
            residual = logs - of_pixels[:, None] - of_lamps
            counted = usable / (1 + (residual / scale) ** 2)
            step = (counted * residual).sum(axis=0) / (counted.sum(axis=0) + TINY)
            of_lamps = of_lamps + step
    known = usable.any(axis=1)
    middle = [np.median(of_pixels[known[:, c], c]) if known[:, c].any() else 0.0 for c in range(3)]
    albedo = np.exp(np.where(known, of_pixels, middle))
    return of_usual_scale(lamps, np.exp(of_lamps), albedo)


def of_usual_scale(lamps: Lamps, colors: Array, albedo: Array) -> tuple[Lamps, Array]:
    """Lamps with colours (K, 3), and albedos (P, 3), of which data tell the product a channel.

    On the whole lamps are grey, as in pictures whose white was balanced, and the mean albedo is
    `ALBEDO_MEAN`.
    """
    tint = np.exp(np.log(colors).mean(axis=0))
    albedo, colors = albedo * tint, colors / tint
    mean = max(float(albedo.mean()), TINY) / ALBEDO_MEAN
    return replace(lamps, colors=colors * mean), np.clip(albedo / mean, 0.01, 0.95)
