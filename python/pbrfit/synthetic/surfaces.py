"""Surfaces: what covers walls and pieces, as functions of points in the piece's object space."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.synthetic.patterns import (
    Pattern,
    checker,
    clouds,
    grain,
    patches,
    planks,
    stripes,
    veins,
)
from pbrfit.values.arrays import Array, Mask


@dataclass(frozen=True)
class Spots:
    """P points of a primitive that pixels look at."""

    points: Array
    normals: Array
    """(P, 3) positions and unit normals in object space; lengths in metres."""
    width: Array
    """(P,) square root of the area of surface that a pixel covers there, in metres: detail finer
    than this may be averaged away."""


@dataclass(frozen=True)
class Finish:
    """The material at P points of a surface."""

    albedo: Array
    """(P, 3), linear Rec.709; of a metal it is F0."""
    roughness: Array
    metallic: Array
    """(P,), in [0, 1]."""
    normals: Array | None = None
    """(P, 3) unit normals in object space where the surface has relief, None where it is smooth."""


class Surface(ABC):
    """A material that may vary over a primitive."""

    @abstractmethod
    def at(self, spots: Spots) -> Finish:
        """Material at P points of the primitive."""


@dataclass(frozen=True)
class Paint:
    """One material; albedo (3,) in linear Rec.709."""

    albedo: Array
    roughness: float
    metallic: float


@dataclass(frozen=True)
class Layers(Surface):
    """Paints over paints: each layer replaces what is below it to the degree of its pattern."""

    base: Paint
    layers: tuple[tuple[Paint, Pattern], ...] = ()

    def at(self, spots: Spots) -> Finish:
        """Mix the paints; see `Surface.at`."""
        count = len(spots.points)
        albedo = np.tile(self.base.albedo, (count, 1))
        roughness = np.full(count, self.base.roughness)
        metallic = np.full(count, self.base.metallic)
        for paint, pattern in self.layers:
            w = pattern(spots.points)
            albedo += w[:, None] * (paint.albedo - albedo)
            roughness += w * (paint.roughness - roughness)
            metallic += w * (paint.metallic - metallic)
        return Finish(albedo=albedo, roughness=roughness, metallic=metallic)


def blend(base: Paint, over: Paint, pattern: Pattern) -> Layers:
    """`base` where the pattern is 0, `over` where it is 1, a mixture between."""
    return Layers(base, ((over, pattern),))


# Linear Rec.709. F0 of gold, copper, aluminium, steel, brass and bronze.
METALS = np.array(
    [
        [0.95, 0.73, 0.33],
        [0.92, 0.60, 0.49],
        [0.90, 0.91, 0.92],
        [0.56, 0.56, 0.55],
        [0.88, 0.72, 0.40],
        [0.71, 0.44, 0.20],
    ]
)
# White, brick, ochre, leaf, teal, navy, plum, charcoal, rose, sky.
COLORS = np.array(
    [
        [0.80, 0.78, 0.74],
        [0.50, 0.14, 0.09],
        [0.68, 0.42, 0.10],
        [0.16, 0.34, 0.10],
        [0.08, 0.34, 0.34],
        [0.07, 0.11, 0.32],
        [0.28, 0.09, 0.24],
        [0.07, 0.07, 0.08],
        [0.70, 0.36, 0.36],
        [0.34, 0.52, 0.70],
    ]
)
# Wall paints, then floors: timber, slate, sand.
WALLS = np.array(
    [
        [0.72, 0.68, 0.60],
        [0.60, 0.66, 0.62],
        [0.50, 0.58, 0.68],
        [0.70, 0.52, 0.42],
        [0.36, 0.44, 0.40],
    ]
)
FLOORS = np.array([[0.36, 0.22, 0.12], [0.16, 0.17, 0.19], [0.55, 0.47, 0.36]])
RUST = np.array([0.32, 0.11, 0.05])


def tinted(color: Array, rng: np.random.Generator, spread: float = 0.15) -> Array:
    """Make the colour a little lighter or darker in each channel, within [0.05, 0.9]."""
    jitter = rng.uniform(1 - spread, 1 + spread) * rng.uniform(0.94, 1.06, size=3)
    return np.clip(color * jitter, 0.05, 0.9)


def bare_metal(rng: np.random.Generator) -> Paint:
    """Draw a bare metal, roughness 0.15 to 0.7."""
    color = rng.choice(METALS) * rng.uniform(0.92, 1.03)
    return Paint(albedo=color, roughness=rng.uniform(0.15, 0.7), metallic=1.0)


def dielectric(rng: np.random.Generator) -> Paint:
    """Draw a paint or plastic, roughness 0.2 to 0.9."""
    color = tinted(rng.choice(COLORS), rng)
    return Paint(albedo=color, roughness=rng.uniform(0.2, 0.9), metallic=0.0)


def wall_paints(rng: np.random.Generator) -> list[Paint]:
    """Paints in the order of `shell`: floor, ceiling, and four walls of two colours."""
    floor = Paint(tinted(rng.choice(FLOORS), rng), rng.uniform(0.25, 0.6), 0.0)
    ceiling = Paint(tinted(COLORS[0], rng, 0.05), rng.uniform(0.7, 0.9), 0.0)
    colors = [tinted(color, rng) for color in rng.permutation(WALLS)[:3]]
    walls = [Paint(color, rng.uniform(0.5, 0.9), 0.0) for color in colors]
    return [floor, ceiling, walls[0], walls[1], walls[2], walls[0]]


def _metal_pieces(count: int, rng: np.random.Generator) -> Mask:
    """(count,): at least a third, at most half of the pieces."""
    metals = rng.integers(-(-count // 3), count // 2 + 1)
    return rng.permutation(count) < metals


def plain_surfaces(count: int, rng: np.random.Generator) -> list[Surface]:
    """Constant materials for the six walls and `count` pieces."""
    pieces = [bare_metal(rng) if metal else dielectric(rng) for metal in _metal_pieces(count, rng)]
    return [Layers(paint) for paint in [*wall_paints(rng), *pieces]]


def case_surfaces(rows: int, columns: int, rng: np.random.Generator) -> list[Surface]:
    """Every second row metal; roughness grows along each row, in the order of `case_stage`."""
    roughness = np.linspace(0.15, 0.85, columns)
    metals, colors = rng.permutation(METALS), rng.permutation(COLORS)
    first_metal = rng.integers(2)
    paints = []
    for row in range(rows):
        metal = (row + first_metal) % 2 == 0
        color = metals[row] if metal else tinted(colors[row], rng)
        paints += [Paint(color, float(r), float(metal)) for r in roughness]
    board = Paint(tinted(rng.choice(FLOORS), rng), rng.uniform(0.3, 0.7), 0.0)
    return [Layers(p) for p in [*wall_paints(rng), *paints, *[board] * rows]]


def textured_surfaces(count: int, rng: np.random.Generator) -> list[Surface]:
    """Patterned materials for the six walls and `count` pieces."""
    floor, ceiling, left, right, back, front = wall_paints(rng)
    tiles = checker(rng, 1.1) if rng.random() < 0.5 else planks(rng, 0.3)
    other = Paint(tinted(0.5 * floor.albedo, rng), rng.uniform(0.25, 0.7), 0.0)
    walls: list[Surface] = [blend(floor, other, tiles), Layers(ceiling)]
    for paint in (left, right, back, front):
        other = Paint(tinted(0.75 * paint.albedo, rng), rng.uniform(0.3, 0.9), 0.0)
        pattern = stripes(rng, 0.5, axis=0) if rng.random() < 0.4 else clouds(rng, 0.9)
        walls.append(blend(paint, other, pattern))
    metals = _metal_pieces(count, rng)
    first = int(np.argmax(metals))  # one piece is metal all over
    pieces = [
        (_worn_metal(rng, whole=i == first) if metal else _decorated(rng))
        for i, metal in enumerate(metals)
    ]
    return [*walls, *pieces]


def _worn_metal(rng: np.random.Generator, *, whole: bool) -> Surface:
    """Smudged, rusty, chipped or inlaid metal; metallic is 1 everywhere on a `whole` one."""
    metal = bare_metal(rng)
    finish = "smudged" if whole else rng.choice(["smudged", "rusty", "chipped", "inlaid"])
    if finish == "smudged":
        rough = float(np.clip(metal.roughness + rng.choice([-0.3, 0.3]), 0.15, 0.7))
        return blend(metal, replace(metal, roughness=rough), clouds(rng, 0.25))
    if finish == "rusty":
        rust = Paint(tinted(RUST, rng), rng.uniform(0.7, 0.9), 0.0)
        return blend(metal, rust, patches(rng, 0.3))
    if finish == "chipped":
        return blend(dielectric(rng), metal, patches(rng, 0.3))
    return blend(dielectric(rng), metal, stripes(rng, 0.4, axis=1))


def _decorated(rng: np.random.Generator) -> Surface:
    """Draw a dielectric: two paints in checks, stripes or patches, wood, or marble."""
    finish = rng.choice(["checker", "stripes", "patches", "wood", "marble"])
    base = dielectric(rng)
    if finish == "wood":
        light = tinted(np.array([0.46, 0.27, 0.13]), rng, 0.3)
        base = Paint(light, rng.uniform(0.3, 0.5), 0.0)
        dark = Paint(tinted(0.4 * light, rng), rng.uniform(0.5, 0.8), 0.0)
        return blend(base, dark, grain(rng, 0.2))
    if finish == "marble":
        over = Paint(tinted(0.35 * base.albedo, rng), rng.uniform(0.2, 0.5), 0.0)
        return blend(base, over, veins(rng, 0.3))
    pattern = {"checker": checker, "stripes": stripes, "patches": patches}[finish]
    return blend(base, dielectric(rng), pattern(rng, 0.35))
