"""Patterns: maps of object-space points (P, 3), in metres, to [0, 1].

Their finest detail, the soft edges apart, is some five pixels of a 128 x 128 picture at the usual
distance of 3.5 m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pbrfit.values.arrays import Array

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
            value = lattice(table[octave], position, lambda f: f * f * (3 - 2 * f))
            total += 1.4 * value / 2**octave
        return total

    return noise


def lattice(table: Array, position: Array, fade: Callable[[Array], Array]) -> Array:
    """Values (P,) of a periodic table (K, K, K) at positions (P, 3), joined by smooth steps."""
    cells = len(table)
    corner = np.floor(position)
    f = fade(position - corner)
    i, j, k = corner.astype(np.int64).T % cells
    ends = np.stack([1 - f, f])
    value = np.zeros(len(position))
    for a, b, c in np.ndindex(2, 2, 2):
        weight = ends[a, :, 0] * ends[b, :, 1] * ends[c, :, 2]
        value += weight * table[(i + a) % cells, (j + b) % cells, (k + c) % cells]
    return value
