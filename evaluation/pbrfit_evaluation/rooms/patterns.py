"""Patterns of furnished rooms, beside those of `pbrfit.synthetic.patterns`."""

from __future__ import annotations

import numpy as np

from pbrfit.synthetic.patterns import Array, Pattern, edge, value_noise


def joints(
    rng: np.random.Generator, length: float, height: float, *, running: bool, joint: float = 0.03
) -> Pattern:
    """1 in the joints between tiles or bricks of the plane y = 0, 0 on them.

    Tiles are `length` along x and `height` along z; with `running`, every second row is shifted by
    half a tile.
    """
    phase = rng.random(2)

    def pattern(points: Array) -> Array:
        row = points[:, 2] / height + phase[1]
        column = points[:, 0] / length + phase[0]
        if running:
            column = column + 0.5 * (np.floor(row) % 2)
        # Distance from the nearest joint, in metres.
        across = (0.5 - np.abs(column - np.floor(column) - 0.5)) * length
        along = (0.5 - np.abs(row - np.floor(row) - 0.5)) * height
        return 1 - edge(np.minimum(across, along) / joint - 0.5, 0.25)

    return pattern


def tile_tones(rng: np.random.Generator, length: float, height: float) -> Pattern:
    """Squares of a lattice in the plane y = 0, each of its own tone, with soft seams."""
    tones = rng.random((8, 8))
    phase = rng.random(2)

    def pattern(points: Array) -> Array:
        x, z = points[:, 0] / length + phase[0], points[:, 2] / height + phase[1]
        i, j = np.floor(x), np.floor(z)
        u, v = edge(x - i - 0.95, 0.05), edge(z - j - 0.95, 0.05)
        a, b = i.astype(np.int64) % 8, j.astype(np.int64) % 8
        here = (1 - u) * tones[a, b] + u * tones[(a + 1) % 8, b]
        above = (1 - u) * tones[a, (b + 1) % 8] + u * tones[(a + 1) % 8, (b + 1) % 8]
        return np.asarray((1 - v) * here + v * above)

    return pattern


def above(direction: Array, level: float, softness: float = 0.01) -> Pattern:
    """1 where points reach beyond `level` along the unit vector `direction`, else 0."""
    return lambda points: edge((points @ direction - level) / softness, 1.0)


def border(half_x: float, half_z: float, inset: float, width: float, *, disc: bool) -> Pattern:
    """Draw a band of `width`, `inset` from the border of a rectangle or disc of the plane y = 0."""

    def pattern(points: Array) -> Array:
        if disc:
            inside = half_x - np.hypot(points[:, 0], points[:, 2])
        else:
            inside = np.minimum(half_x - np.abs(points[:, 0]), half_z - np.abs(points[:, 2]))
        return edge((width / 2 - np.abs(inside - inset - width / 2)) / 0.02, 0.5)

    return pattern


def bands(rng: np.random.Generator, thinnest: float, thickest: float, share: float) -> Pattern:
    """Bands of different widths across x, a random `share` of them 1, the others 0."""
    widths = rng.uniform(thinnest, thickest, size=64)
    borders = np.cumsum(widths) - widths.sum() / 2
    tones = (rng.random(65) < share).astype(np.float64)

    def pattern(points: Array) -> Array:
        x = points[:, 0]
        index = np.searchsorted(borders, x)
        nearest = borders[np.clip(index - 1, 0, 63)]
        blend = edge((x - nearest) / 0.008 - 0.5, 0.5)  # from the band before, past its border
        before = tones[np.clip(index - 1, 0, 64)]
        return np.asarray(before + blend * (tones[index] - before))

    return pattern


def chips(rng: np.random.Generator, scale: float, least: float, softness: float) -> Pattern:
    """Islands with a ragged outline where noise is more than `least`."""
    noise = value_noise(rng, scale, octaves=3)
    return lambda points: edge(noise(points) - least, softness)


def brushed(rng: np.random.Generator, axis: int) -> Pattern:
    """Streaks along one object axis."""
    noise = value_noise(rng, 0.05, octaves=2)
    stretch = np.ones(3)
    stretch[axis] = 0.06
    return lambda points: edge(noise(points * stretch), 0.9)


def weave(rng: np.random.Generator, period: float) -> Pattern:
    """Checked cloth: two crossing sets of soft stripes."""
    phase = rng.uniform(0, 2 * np.pi, size=3)

    def pattern(points: Array) -> Array:
        waves = edge(np.sin(2 * np.pi / period * points + phase), 0.4)
        return np.asarray(waves.sum(axis=-1) / 3)

    return pattern
