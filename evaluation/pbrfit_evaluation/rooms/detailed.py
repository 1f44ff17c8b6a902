"""Detailed rooms: the furnished rooms with finer materials.

With texture maps, most of the pieces and walls take a set of maps: metallic if they are of metal,
else dielectric; walls, floor and ceiling only sets that repeat without a seam. Where there is no
set of that sort, for the rest, and without maps, the paints of the furnished room stay and gain
relief, grain and stains of several sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.model.geometry import unit
from pbrfit.synthetic.geometry import Plane, Primitive
from pbrfit.synthetic.patterns import edge, lattice
from pbrfit.synthetic.surfaces import METALS, Finish, Layers, Spots, Surface
from pbrfit.synthetic.world import World
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.rooms.coverings import DARKEST, LIGHTEST, LIGHTEST_METAL
from pbrfit_evaluation.rooms.textures import MaterialSet, chart

Rng = np.random.Generator
Relief = Callable[[Array, Array], Array]
"""(P,) in about [-1, 1] at object-space points (P, 3) for pixels of this width (P,) in metres."""

LEAST_ROUGHNESS = 0.12
"""Roughness is raised to this: below it, lights of order 3 look the same in every surface."""

_TEXTURED = 0.75  # share of the materials that take maps, where there are any


@dataclass(frozen=True)
class Textured(Surface):
    """Maps of a set on one primitive."""

    primitive: Primitive
    """What is covered; it decides how the maps are laid on."""
    maps: MaterialSet
    """The set."""
    tile: float
    """Metres that the maps are wide."""
    offset: Array
    """(2,) of the maps, in tiles."""
    quarter: int
    """By how many quarter turns the maps are turned counter-clockwise."""
    gain: Array
    """(3,) factors of the albedo."""

    def at(self, spots: Spots) -> Finish:
        """Look the maps up; see `Surface.at`."""
        on = chart(self.primitive, spots.points, spots.normals, self.tile)
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter % 4]
        u, v = c * on.u + s * on.v, c * on.v - s * on.u
        right, up = c * on.right + s * on.up, c * on.up - s * on.right
        texels = spots.width * on.squeeze * (len(self.maps.levels[0]) / self.tile)
        found = self.maps.sample(u + self.offset[0], v + self.offset[1], texels)
        normals = None
        if self.maps.relief:
            x, y, z = found[:, 5:, None].transpose(1, 0, 2)
            normals = unit(x * right + y * up + z * spots.normals)
        return Finish(
            albedo=np.clip(found[:, :3] * self.gain, DARKEST, LIGHTEST_METAL),
            roughness=np.clip(found[:, 3], LEAST_ROUGHNESS, 1.0),
            metallic=np.clip(found[:, 4], 0.0, 1.0),
            normals=normals,
        )


def _fractal(rng: Rng, scale: float, octaves: int = 5) -> Relief:
    """Sums of value noise from coarse to fine; what is finer than a pixel fades out.

    The coarsest cell is `scale` metres; each further octave has half of it, and 0.6 of the
    strength.
    """
    cells = 16
    tables = rng.uniform(-1, 1, size=(octaves, cells, cells, cells))
    offsets = rng.uniform(0, cells, size=(octaves, 3))

    def fractal(points: Array, width: Array) -> Array:
        total = np.zeros(len(points))
        for octave, (table, offset) in enumerate(zip(tables, offsets, strict=True)):
            cell = scale / 2**octave
            strength = 0.6**octave * edge(cell / np.maximum(width, 1e-9) - 2.0, 1.0)
            total += strength * lattice(table, points / cell + offset, fade)
        return total

    def fade(f: Array) -> Array:  # slopes are continuous, and so is the relief
        return f * f * f * (f * (6 * f - 15) + 10)

    return fractal


@dataclass(frozen=True)
class Weathered(Surface):
    """Another surface with relief, grain and stains."""

    base: Surface
    """The surface below."""
    relief: Relief
    """Height; its slope is `depth` at most, about."""
    grain: Relief
    """Changes of roughness and tone."""
    depth: float
    """Height in metres of the coarsest bumps."""
    tone: float
    dullness: float
    """`tone` and `dullness`: how far grain and hollows change the albedo, as a factor, and the
    roughness."""

    def at(self, spots: Spots) -> Finish:
        """Roughen the surface below; see `Surface.at`."""
        below = self.base.at(spots)
        height = self.relief(spots.points, spots.width)
        # The height field's gradient, one-sided over a third of the pixel or a millimetre.
        step = np.maximum(spots.width / 3, 1e-3)
        gradient = np.empty_like(spots.points)
        for axis in range(3):
            beside = spots.points.copy()
            beside[:, axis] += step
            gradient[:, axis] = (self.relief(beside, spots.width) - height) / step
        along = np.einsum("pi,pi->p", gradient, spots.normals)[:, None] * spots.normals
        normals = unit(spots.normals - self.depth * (gradient - along))
        grain = self.grain(spots.points, spots.width)
        tone = self.tone * (1 - 0.7 * below.metallic) * (0.6 * grain + 0.5 * height)
        lightest = LIGHTEST + (LIGHTEST_METAL - LIGHTEST) * below.metallic[:, None]
        roughness = below.roughness + self.dullness * (grain - height)
        return Finish(
            albedo=np.clip(below.albedo * (1 + tone[:, None]), DARKEST, lightest),
            roughness=np.clip(roughness, LEAST_ROUGHNESS, 0.95),
            metallic=below.metallic,
            normals=normals,
        )


def draw_detailed(
    world: World, tags: Sequence[str], sets: Sequence[MaterialSet], rng: Rng
) -> World:
    """Give a furnished room, as `draw_furnished` returns it, finer materials.

    By texture maps; without any, by procedural detail.
    """
    walls = [f"wall/{min(i, 2)}" if i != 4 else "wall/back" for i in range(world.walls)]
    choice: dict[str, Textured | Weathered] = {}
    surfaces: list[Surface] = []
    pieces = zip(world.primitives, world.surfaces, (*walls, *tags), strict=True)
    for primitive, surface, tag in pieces:
        assert isinstance(surface, Layers)
        if tag not in choice:
            bare = surface.base.metallic >= 0.5
            fitting = [one for one in sets if (one.metallic >= 0.3) == bare]
            if isinstance(primitive, Plane):
                fitting = [one for one in fitting if one.repeats]
            if fitting and rng.random() < _TEXTURED:
                choice[tag] = _textured(surface, primitive, fitting, rng)
            else:
                choice[tag] = _weathered(surface, rng)
        drawn = choice[tag]
        if isinstance(drawn, Weathered):
            surfaces.append(replace(drawn, base=surface))
        else:
            quarter = _upright(primitive, drawn.quarter)
            surfaces.append(replace(drawn, primitive=primitive, quarter=quarter))
    return replace(world, surfaces=tuple(surfaces))


def _upright(primitive: Primitive, quarter: int) -> int:
    """Quarter turns of maps on a primitive: on walls v grows along +y of the scene."""
    if not isinstance(primitive, Plane) or primitive.rotation[1, 1] ** 2 >= 0.5:
        return quarter
    up = primitive.rotation.T @ np.array([0.0, 1.0, 0.0])
    # On a plane, right is x and up is -z.
    return int(np.argmax([-up[2], up[0], up[2], -up[0]]))


def _textured(
    surface: Layers, primitive: Primitive, sets: Sequence[MaterialSet], rng: Rng
) -> Textured:
    """Draw a set, its scale and its place; half of the time its colour is that of the surface."""
    maps = sets[int(rng.integers(len(sets)))]
    if surface.base.metallic >= 0.5:
        whole = [one for one in sets if one.metallic >= 0.9]
        if whole and rng.random() < 0.6:
            maps = whole[int(rng.integers(len(whole)))]
    mean = np.maximum(maps.mean[:3], DARKEST)
    gain = np.ones(3)
    if maps.metallic >= 0.9:
        gain = METALS[rng.integers(len(METALS))] / mean
    elif maps.metallic < 0.1 and rng.random() < 0.5:
        gain = np.minimum(surface.base.albedo / mean, 6.0)
    large = isinstance(primitive, Plane)
    return Textured(
        primitive=primitive,
        maps=maps,
        tile=float(rng.uniform(1.2, 2.2) if large else rng.uniform(0.5, 1.0)),
        offset=rng.random(2),
        quarter=int(rng.integers(4)),
        gain=gain,
    )


def _weathered(surface: Layers, rng: Rng) -> Weathered:
    soft = surface.base.roughness > 0.7
    return Weathered(
        base=surface,
        relief=_fractal(rng, rng.uniform(0.15, 0.35)),
        grain=_fractal(rng, rng.uniform(0.1, 0.4)),
        depth=float(rng.uniform(0.006, 0.025 if soft else 0.012)),
        tone=float(rng.uniform(0.15, 0.4)),
        dullness=float(rng.uniform(0.04, 0.12)),
    )
