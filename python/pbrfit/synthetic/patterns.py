"""Patterns: maps of object-space points (P, 3), in metres, to [0, 1].

Their finest detail, the soft edges apart, is some five pixels of a 128 x 128 picture at the usual
distance of 3.5 m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pattern = Callable[[Array], Array]


def edge(signal: Array, softness: float = 0.25) -> Array:
    """0 below -softness, 1 above, and a smooth step between."""
    x = np.clip(signal / (2 * softness) + 0.5, 0.0, 1.0)
    return np.asarray(x * x * (3 - 2 * x))


def checker(rng: np.random.Generator, period: float) -> Pattern:
    """Cubes of half a period, filled in turn."""
    phase = np.array([rng.uniform(0, 2 * np.pi), np.pi / 2, rng.uniform(0, 2 * np.pi)])

    def pattern(points: Array) -> Array:
        waves = 2 * edge(np.sin(2 * np.pi / period * points + phase)) - 1
        return np.asarray((waves.prod(axis=-1) + 1) / 2)

    return pattern


def stripes(rng: np.random.Generator, period: float, axis: int | None = None) -> Pattern:
    """Bands across one object axis."""
    along = rng.integers(3) if axis is None else axis
    phase, bias = rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.3)
    return lambda points: edge(np.sin(2 * np.pi / period * points[:, along] + phase) + bias)


def clouds(rng: np.random.Generator, scale: float) -> Pattern:
    """Smooth, gentle variation."""
    noise = value_noise(rng, scale, octaves=2)
    return lambda points: edge(noise(points), 1.0)


def patches(rng: np.random.Generator, scale: float) -> Pattern:
    """Islands with a ragged outline over a bit less than half of the surface."""
    noise = value_noise(rng, scale, octaves=3)
    return lambda points: edge(noise(points) - 0.1, 0.12)


def veins(rng: np.random.Generator, period: float) -> Pattern:
    """Marble: thin dark sheets, bent by noise."""
    noise = value_noise(rng, 1.5 * period, octaves=3)
    tilt = rng.normal(size=3)
    tilt *= np.pi / (period * np.linalg.norm(tilt))

    def pattern(points: Array) -> Array:
        return np.asarray((1 - np.abs(np.sin(points @ tilt + 4.0 * noise(points)))) ** 2)

    return pattern


def grain(rng: np.random.Generator, period: float) -> Pattern:
    """Wood: year rings about a trunk along x that lies outside the object, bent by noise."""
    noise = value_noise(rng, 2 * period, octaves=2)
    heart = np.array([rng.uniform(0.6, 1.2), rng.uniform(-0.3, 0.3)])

    def pattern(points: Array) -> Array:
        stretched = points * [0.25, 1.0, 1.0]
        ring = np.linalg.norm(stretched[:, 1:] - heart, axis=-1) / period
        return np.asarray(0.5 + 0.5 * np.sin(2 * np.pi * (ring + 0.45 * noise(stretched))))

    return pattern


def planks(rng: np.random.Generator, width: float) -> Pattern:
    """Floor boards along z, each of its own tone, with a long grain."""
    noise = value_noise(rng, width, octaves=2)
    tones = rng.random(32)

    def pattern(points: Array) -> Array:
        x = points[:, 0] / width
        board = np.floor(x)
        seam = edge(x - board - 0.94, 0.04)  # the next board's tone sets in over the last tenth
        left = board.astype(np.int64)
        tone = (1 - seam) * tones[left % 32] + seam * tones[(left + 1) % 32]
        return np.asarray(np.clip(tone + 0.2 * noise(points * [1.0, 1.0, 0.2]), 0.0, 1.0))

    return pattern


def value_noise(rng: np.random.Generator, scale: float, octaves: int) -> Pattern:
    """Value noise in about [-1, 1]: random values on a lattice, joined by smooth steps.

    Each further octave has half the cell size and half the strength; `scale` is the first cell.
    """
    cells = 16
    table = rng.uniform(-1, 1, size=(octaves, cells, cells, cells))
    offset = rng.uniform(0, cells, size=(octaves, 3))

    def noise(points: Array) -> Array:
        total = np.zeros(len(points))
        for octave in range(octaves):
            position = points * (2**octave / scale) + offset[octave]
            corner = np.floor(position)
            f = position - corner
            f = f * f * (3 - 2 * f)
            i, j, k = corner.astype(np.int64).T % cells
            value = np.zeros(len(points))
            for a, b, c in np.ndindex(2, 2, 2):
                weight = np.prod(np.where([a, b, c], f, 1 - f), axis=-1)
                value += weight * table[octave, (i + a) % cells, (j + b) % cells, (k + c) % cells]
            total += 1.4 * value / 2**octave
        return total

    return noise


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


def frame(half_x: float, half_z: float, inset: float, width: float, *, disc: bool) -> Pattern:
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
