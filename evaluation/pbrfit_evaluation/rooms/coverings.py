"""Coverings: what the furniture and the shell of a furnished room are made of.

A covering of furniture draws a surface for a primitive. Some are named for their use: `frame` is
for legs, poles and rails, `lacquer` for bodies of furniture.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbrfit.synthetic.geometry import Box, Cylinder, Primitive
from pbrfit.synthetic.patterns import (
    Pattern,
    checker,
    clouds,
    edge,
    grain,
    patches,
    planks,
    stripes,
    value_noise,
    veins,
)
from pbrfit.synthetic.surfaces import METALS, Layers, Paint, Surface, blend
from pbrfit_evaluation.arrays import Array


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


Rng = np.random.Generator

# Linear Rec.709. Oak, light oak, pine, cherry, walnut, mahogany, ebony.
WOODS = np.array(
    [
        [0.36, 0.21, 0.10],
        [0.50, 0.33, 0.18],
        [0.62, 0.44, 0.24],
        [0.40, 0.17, 0.08],
        [0.16, 0.085, 0.045],
        [0.22, 0.07, 0.035],
        [0.06, 0.045, 0.035],
    ]
)
# Lacquers, glazes and dyes: white, cream, brick, ochre, olive, sage, teal, navy, sky, plum, rose,
# charcoal, terracotta, mustard.
DYES = np.array(
    [
        [0.80, 0.79, 0.76],
        [0.74, 0.66, 0.50],
        [0.42, 0.09, 0.06],
        [0.62, 0.34, 0.08],
        [0.18, 0.19, 0.06],
        [0.33, 0.42, 0.30],
        [0.05, 0.26, 0.27],
        [0.035, 0.065, 0.20],
        [0.30, 0.48, 0.66],
        [0.20, 0.06, 0.16],
        [0.62, 0.31, 0.31],
        [0.045, 0.047, 0.05],
        [0.48, 0.17, 0.09],
        [0.66, 0.45, 0.05],
    ]
)
# Wall paints: chalk, linen, sage, dusk blue, clay, moss, blush, slate.
WALL_PAINTS = np.array(
    [
        [0.78, 0.76, 0.70],
        [0.66, 0.58, 0.45],
        [0.45, 0.53, 0.43],
        [0.28, 0.38, 0.50],
        [0.56, 0.34, 0.24],
        [0.17, 0.22, 0.14],
        [0.68, 0.48, 0.42],
        [0.20, 0.23, 0.27],
    ]
)
# Stones: white marble, beige limestone, grey granite, green marble, black marble, red marble.
STONES = np.array(
    [
        [0.76, 0.75, 0.73],
        [0.60, 0.51, 0.38],
        [0.30, 0.30, 0.31],
        [0.07, 0.15, 0.10],
        [0.035, 0.035, 0.04],
        [0.33, 0.10, 0.07],
    ]
)
LEAVES = np.array([[0.06, 0.17, 0.03], [0.16, 0.27, 0.05], [0.03, 0.10, 0.04], [0.30, 0.30, 0.06]])
FRUIT = np.array([[0.45, 0.05, 0.03], [0.68, 0.30, 0.03], [0.35, 0.45, 0.06], [0.70, 0.55, 0.08]])
RUST, VERDIGRIS = np.array([0.26, 0.085, 0.035]), np.array([0.17, 0.36, 0.28])
DARKEST, LIGHTEST = 0.014, 0.86  # of dielectrics, linear; sRGB 31 and 239 of 255
LIGHTEST_METAL = 0.98


def paint(color: Array, roughness: float, rng: Rng, spread: float = 0.2) -> Paint:
    """Draw a dielectric of about this colour and roughness."""
    light = rng.uniform(1 - spread, 1 + spread) * rng.uniform(0.93, 1.07, size=3)
    albedo = np.clip(color * light, DARKEST, LIGHTEST)
    return Paint(albedo, float(np.clip(roughness + rng.uniform(-0.06, 0.06), 0.12, 0.95)), 0.0)


def drawn(colors: Array, low: float, high: float, rng: Rng, spread: float = 0.2) -> Paint:
    """Draw a paint of one of the colours (K, 3), its roughness between these."""
    color = colors[rng.integers(len(colors))]
    return paint(color, rng.uniform(low, high), rng, spread)


def darker(paint: Paint, factor: float, rougher: float = 0.0) -> Paint:
    """Scale the albedo of a dielectric, and make it rougher."""
    return replace(
        paint,
        albedo=np.clip(paint.albedo * factor, DARKEST, LIGHTEST),
        roughness=float(np.clip(paint.roughness + rougher, 0.12, 0.95)),
    )


def metal(rng: Rng, primitive: Primitive) -> Surface:
    """Polished, brushed, worn, rusty or patinated metal; mostly bare."""
    kind = int(rng.integers(len(METALS)))
    color = np.clip(METALS[kind] * rng.uniform(0.94, 1.03), 0.0, LIGHTEST_METAL)
    bare = Paint(color, float(rng.uniform(0.15, 0.6)), 1.0)
    finish = rng.choice(["polished", "brushed", "worn", "corroded"], p=[0.25, 0.3, 0.25, 0.2])
    if finish == "polished":
        dull = replace(bare, roughness=bare.roughness + 0.12)
        return blend(bare, dull, clouds(rng, 0.2))
    if finish == "brushed":
        streaks = replace(bare, roughness=bare.roughness + 0.2, albedo=0.92 * color)
        axis = 1 if isinstance(primitive, Box) else 0
        return blend(bare, streaks, brushed(rng, axis))
    worn = replace(bare, roughness=min(bare.roughness + 0.25, 0.8), albedo=0.88 * color)
    smudges = (worn, patches(rng, 0.22))
    if finish == "worn":
        return Layers(bare, (smudges,))
    stain = paint(VERDIGRIS if kind in (1, 4, 5) else RUST, 0.8, rng)
    return Layers(bare, (smudges, (stain, chips(rng, 0.3, 0.35, 0.12))))


def wood(rng: Rng, primitive: Primitive) -> Surface:
    """Light and dark grain, along the height of what is tall."""
    light = drawn(WOODS, 0.3, 0.6, rng, 0.3)
    dark = darker(light, rng.uniform(0.4, 0.65), 0.12)
    # The grain runs along x; upright parts are longest along y.
    upright = isinstance(primitive, Box) and primitive.half[1] > primitive.half[0]
    rings, order = grain(rng, rng.uniform(0.08, 0.14)), [1, 0, 2] if upright else [0, 1, 2]
    return blend(light, dark, lambda p: rings(p[:, order]))


def lacquer(rng: Rng, primitive: Primitive) -> Surface:
    """Paint, whole or with bare metal where it came off; or metal."""
    if rng.random() < 0.3:
        return metal(rng, primitive)
    base = drawn(DYES, 0.2, 0.6, rng)
    if rng.random() < 0.3:  # paint that came off its metal
        bare = Paint(METALS[rng.integers(len(METALS))], float(rng.uniform(0.3, 0.6)), 1.0)
        return blend(base, bare, chips(rng, 0.25, 0.3, 0.1))
    return blend(base, darker(base, 0.85, 0.1), clouds(rng, 0.3))


def frame(rng: Rng, primitive: Primitive) -> Surface:
    """Metal, wood, or black or white paint."""
    choice = rng.random()
    if choice < 0.6:
        return metal(rng, primitive)
    if choice < 0.8:
        return wood(rng, primitive)
    return Layers(paint(DYES[rng.choice([0, 11])], 0.4, rng))


def vessel(rng: Rng, primitive: Primitive) -> Surface:
    """Metal, stone, or a glaze: plain, in bands or speckled."""
    choice = rng.random()
    if choice < 0.45:
        return metal(rng, primitive)
    if choice < 0.55:
        return stone(rng, primitive)
    first, second = rng.permutation(len(DYES))[:2]
    base = paint(DYES[first], rng.uniform(0.15, 0.5), rng)
    over = paint(DYES[second], rng.uniform(0.15, 0.6), rng)
    glaze = rng.choice(["plain", "bands", "speckled"])
    if glaze == "plain":
        return blend(base, darker(base, 0.8, 0.08), clouds(rng, 0.15))
    if glaze == "bands":
        return blend(base, over, stripes(rng, rng.uniform(0.09, 0.16), axis=1))
    return blend(base, over, patches(rng, 0.1))


def textile(rng: Rng, _: Primitive) -> Surface:
    """Cloth, plain or of two or three colours, or leather."""
    first, second, third = rng.permutation(len(DYES))[:3]
    base, over = (paint(DYES[i], rng.uniform(0.75, 0.9), rng) for i in (first, second))
    cloth = rng.choice(["plain", "stripes", "checked", "leather"])
    if cloth == "stripes":
        thin = (paint(DYES[third], 0.85, rng), bands(rng, 0.05, 0.12, 0.25))
        return Layers(base, ((over, stripes(rng, rng.uniform(0.12, 0.2), axis=0)), thin))
    if cloth == "checked":
        return blend(base, over, weave(rng, rng.uniform(0.14, 0.24)))
    if cloth == "leather":
        base = drawn(WOODS[[0, 3, 4, 6]], 0.35, 0.55, rng)
        return blend(base, darker(base, 0.6, 0.2), patches(rng, 0.2))
    return blend(base, darker(base, 0.7, 0.05), clouds(rng, 0.12))


def shade(rng: Rng, primitive: Primitive) -> Surface:
    """Metal, or pale cloth with stripes or without."""
    if rng.random() < 0.4:
        return metal(rng, primitive)
    base = paint(DYES[rng.choice([0, 1, 2, 3, 5, 13])], 0.8, rng)
    if rng.random() < 0.5:
        trim = darker(base, 0.45)
        return blend(base, trim, stripes(rng, 0.1, axis=1))
    return blend(base, darker(base, 0.8), clouds(rng, 0.1))


def stone(rng: Rng, _: Primitive) -> Surface:
    """Marble, or a stone with flecks."""
    base = drawn(STONES, 0.15, 0.5, rng)
    if rng.random() < 0.65:
        vein = _vein(base, rng)
        return blend(base, vein, veins(rng, rng.uniform(0.18, 0.3)))
    fleck = drawn(STONES, 0.2, 0.6, rng)
    return blend(base, fleck, patches(rng, 0.09))


def _vein(base: Paint, rng: Rng) -> Paint:
    """Of marble: dark, but white in a dark one."""
    return darker(base, 0.3) if base.albedo.mean() > 0.2 else paint(STONES[0], 0.3, rng)


def books(rng: Rng, _: Primitive) -> Surface:
    """Spines side by side, in four colours."""
    paints = [paint(DYES[i], rng.uniform(0.4, 0.8), rng) for i in rng.permutation(len(DYES))[:4]]
    return Layers(paints[0], tuple((of, bands(rng, 0.035, 0.075, 0.4)) for of in paints[1:]))


def paper(rng: Rng, _: Primitive) -> Surface:
    """One colour with a little wear."""
    base = drawn(DYES, 0.4, 0.85, rng)
    return blend(base, darker(base, 0.75), clouds(rng, 0.12))


def leaves(rng: Rng, primitive: Primitive) -> Surface:
    """Two greens; small balls are fruit."""
    small = getattr(primitive, "radius", 1.0) < 0.1
    colors = FRUIT if small else LEAVES
    first, second = rng.permutation(len(colors))[:2]
    base = paint(colors[first], 0.4 if small else rng.uniform(0.45, 0.7), rng)
    over = paint(colors[second], 0.45 if small else rng.uniform(0.4, 0.6), rng)
    return blend(base, over, patches(rng, 0.1))


def canvas(rng: Rng, _: Primitive) -> Surface:
    """Draw an abstract painting: four paints."""
    paints = [paint(DYES[i], rng.uniform(0.4, 0.8), rng) for i in rng.permutation(len(DYES))[:4]]
    shapes = patches(rng, 0.3), stripes(rng, rng.uniform(0.25, 0.5)), patches(rng, 0.18)
    return Layers(paints[0], tuple(zip(paints[1:], shapes, strict=True)))


def rug(rng: Rng, primitive: Primitive) -> Surface:
    """Draw a field with a figure, and two borders."""
    paints = [paint(DYES[i], 0.88, rng) for i in rng.permutation(len(DYES))[:4]]
    disc = isinstance(primitive, Cylinder)
    if isinstance(primitive, Cylinder):
        x = z = primitive.radius
    else:
        assert isinstance(primitive, Box)
        x, _, z = primitive.half.tolist()
    figure = rng.choice(["stripes", "checker", "patches"])
    if figure == "stripes":
        field = stripes(rng, 0.3, axis=int(rng.choice([0, 2])))
    else:
        field = checker(rng, 0.45) if figure == "checker" else patches(rng, 0.25)
    wide, thin = (border(x, z, *at, disc=disc) for at in ((-0.02, 0.17), (0.05, 0.05)))
    return Layers(paints[0], tuple(zip(paints[1:], (field, wide, thin), strict=True)))


MAY_BE_METAL = frozenset({lacquer, frame, vessel, shade, metal})
"""The other coverings never are of metal."""


def unmetal(rng: Rng) -> Surface:
    """Draw a lacquer on what was of metal."""
    base = drawn(DYES, 0.25, 0.6, rng)
    return blend(base, darker(base, 0.8, 0.1), clouds(rng, 0.25))


def shell_coverings(walls: tuple[Primitive, ...], rng: Rng) -> list[Surface]:
    """Floor, ceiling, and four walls: all of one paint, but the back one sometimes special."""
    first, second = rng.permutation(len(WALL_PAINTS))[:2]
    plain = paint(WALL_PAINTS[first], rng.uniform(0.6, 0.9), rng, 0.1)
    accent = paint(WALL_PAINTS[second], rng.uniform(0.5, 0.85), rng, 0.1)
    dado = rng.uniform(0.8, 1.1) if rng.random() < 0.3 else None
    special = rng.choice(["paint", "accent", "wallpaper", "brick", "tiles"])
    covers: list[Surface] = [_floor(rng), _ceiling(rng)]
    for i, wall in enumerate(walls[2:]):
        kind = special if i == 2 else "paint"
        up = wall.rotation.T @ np.array([0.0, 1.0, 0.0])
        foot = -float(wall.centre[1])  # of the floor, above the wall's middle
        base = accent if kind == "accent" else plain
        layers = [(darker(base, 0.88, 0.05), clouds(rng, 0.7))]
        sideways = 0 if abs(up[0]) < 0.5 else 2
        if kind == "wallpaper":
            layers.append((accent, stripes(rng, rng.uniform(0.2, 0.4), axis=sideways)))
        elif kind == "brick":
            clay = paint(DYES[rng.choice([0, 2, 12])], 0.85, rng)
            base = darker(clay, 0.65, 0.0)
            joint = joints(rng, 0.34, 0.16, running=True, joint=0.028)
            layers = [
                (clay, tile_tones(rng, 0.34, 0.16)),
                (paint(STONES[1], 0.9, rng), joint),
            ]
        elif kind == "tiles":
            glaze = drawn(DYES, 0.15, 0.35, rng)
            base, side = darker(glaze, 0.8, 0.0), rng.uniform(0.22, 0.34)
            joint = joints(rng, side, side, running=False, joint=0.026)
            grout = paint(STONES[rng.choice([0, 2])], 0.85, rng)
            layers = [(glaze, clouds(rng, 0.3)), (grout, joint)]
        if dado is not None and kind in ("paint", "accent", "wallpaper"):
            panel = darker(accent if kind != "accent" else plain, 0.7, -0.2)
            layers.append((panel, above(-up, -(foot + dado))))
        skirting = paint(DYES[rng.choice([0, 1])], 0.4, rng, 0.05)
        layers.append((skirting, above(-up, -(foot + 0.1))))
        covers.append(Layers(base, tuple(layers)))
    return covers


def _ceiling(rng: Rng) -> Surface:
    base = paint(DYES[0], 0.85, rng, 0.05)
    return blend(base, darker(base, 0.92), clouds(rng, 0.8))


def _floor(rng: Rng) -> Surface:
    kind = rng.choice(
        ["planks", "tiles", "checker", "marble", "concrete"], p=[0.4, 0.2, 0.15, 0.1, 0.15]
    )
    if kind == "planks":
        light = drawn(WOODS, 0.25, 0.55, rng, 0.25)
        width = rng.uniform(0.14, 0.22)
        rings = grain(rng, 0.09)
        boards = (darker(light, 0.55, 0.1), planks(rng, width))
        lines = (darker(light, 0.4, 0.2), lambda p: 0.4 * rings(p[:, [2, 0, 1]]))
        return Layers(light, (boards, lines))
    if kind == "concrete":
        base = paint(STONES[2], rng.uniform(0.4, 0.8), rng, 0.3)
        stain = (darker(base, 0.6, 0.1), patches(rng, 0.5))
        return Layers(base, ((darker(base, 0.8, -0.15), clouds(rng, 0.25)), stain))
    side = rng.uniform(0.3, 0.5)
    first, second = rng.permutation(len(STONES))[:2]
    base = paint(STONES[first], rng.uniform(0.15, 0.5), rng)
    grout = paint(STONES[2], 0.85, rng)
    joint = (grout, joints(rng, side, side, running=False))
    if kind == "tiles":
        return Layers(base, ((darker(base, 0.6, 0.1), tile_tones(rng, side, side)), joint))
    if kind == "checker":
        over = paint(STONES[second], rng.uniform(0.15, 0.4), rng)
        return blend(base, over, checker(rng, 2 * side))
    return Layers(base, ((_vein(base, rng), veins(rng, 0.4)), joint))
