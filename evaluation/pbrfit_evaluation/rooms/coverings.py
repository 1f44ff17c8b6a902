"""Coverings of furniture: what each part of a furnished room is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pbrfit.synthetic import patterns
from pbrfit.synthetic.geometry import Box, Cylinder, Primitive
from pbrfit.synthetic.surfaces import METALS, Layers, Paint, Surface
from pbrfit_evaluation.rooms import patterns as room_patterns
from pbrfit_evaluation.rooms.palette import (
    DYES,
    FRUIT,
    LEAVES,
    LIGHTEST_METAL,
    RUST,
    STONES,
    VERDIGRIS,
    WOODS,
    darker,
    paint,
)
from pbrfit_evaluation.rooms.parts import Part

Rng = np.random.Generator


def metal(rng: Rng, primitive: Primitive) -> Surface:
    """Polished, brushed, worn, rusty or patinated metal; mostly bare."""
    kind = int(rng.integers(len(METALS)))
    color = np.clip(METALS[kind] * rng.uniform(0.94, 1.03), 0.0, LIGHTEST_METAL)
    bare = Paint(color, float(rng.uniform(0.15, 0.6)), 1.0)
    finish = rng.choice(["polished", "brushed", "worn", "corroded"], p=[0.25, 0.3, 0.25, 0.2])
    if finish == "polished":
        dull = replace(bare, roughness=bare.roughness + 0.12)
        return Layers(bare, ((dull, patterns.clouds(rng, 0.2)),))
    if finish == "brushed":
        streaks = replace(bare, roughness=bare.roughness + 0.2, albedo=0.92 * color)
        axis = 1 if isinstance(primitive, Box) else 0
        return Layers(bare, ((streaks, room_patterns.brushed(rng, axis)),))
    worn = replace(bare, roughness=min(bare.roughness + 0.25, 0.8), albedo=0.88 * color)
    smudges = (worn, patterns.patches(rng, 0.22))
    if finish == "worn":
        return Layers(bare, (smudges,))
    stain = paint(VERDIGRIS if kind in (1, 4, 5) else RUST, 0.8, rng)
    noise = patterns.value_noise(rng, 0.3, octaves=3)
    return Layers(bare, (smudges, (stain, lambda p: patterns.edge(noise(p) - 0.35, 0.12))))


def _wood(rng: Rng, primitive: Primitive) -> Surface:
    light = paint(WOODS[rng.integers(len(WOODS))], rng.uniform(0.3, 0.6), rng, 0.3)
    dark = darker(light, rng.uniform(0.4, 0.65), 0.12)
    # The grain runs along x; upright parts are longest along y.
    upright = isinstance(primitive, Box) and primitive.half[1] > primitive.half[0]
    grain, order = patterns.grain(rng, rng.uniform(0.08, 0.14)), [1, 0, 2] if upright else [0, 1, 2]
    return Layers(light, ((dark, lambda p: grain(p[:, order])),))


def _lacquer(rng: Rng, primitive: Primitive) -> Surface:
    if rng.random() < 0.3:
        return metal(rng, primitive)
    base = paint(DYES[rng.integers(len(DYES))], rng.uniform(0.2, 0.6), rng)
    if rng.random() < 0.3:  # paint that came off its metal
        bare = Paint(METALS[rng.integers(len(METALS))], float(rng.uniform(0.3, 0.6)), 1.0)
        noise = patterns.value_noise(rng, 0.25, octaves=3)
        return Layers(base, ((bare, lambda p: patterns.edge(noise(p) - 0.3, 0.1)),))
    return Layers(base, ((darker(base, 0.85, 0.1), patterns.clouds(rng, 0.3)),))


def _frame(rng: Rng, primitive: Primitive) -> Surface:
    choice = rng.random()
    if choice < 0.6:
        return metal(rng, primitive)
    if choice < 0.8:
        return _wood(rng, primitive)
    return Layers(paint(DYES[rng.choice([0, 11])], 0.4, rng))


def _vessel(rng: Rng, primitive: Primitive) -> Surface:
    choice = rng.random()
    if choice < 0.45:
        return metal(rng, primitive)
    if choice < 0.55:
        return _stone(rng, primitive)
    first, second = rng.permutation(len(DYES))[:2]
    base = paint(DYES[first], rng.uniform(0.15, 0.5), rng)
    over = paint(DYES[second], rng.uniform(0.15, 0.6), rng)
    glaze = rng.choice(["plain", "bands", "speckled"])
    if glaze == "plain":
        return Layers(base, ((darker(base, 0.8, 0.08), patterns.clouds(rng, 0.15)),))
    if glaze == "bands":
        return Layers(base, ((over, patterns.stripes(rng, rng.uniform(0.09, 0.16), axis=1)),))
    return Layers(base, ((over, patterns.patches(rng, 0.1)),))


def _textile(rng: Rng, _: Primitive) -> Surface:
    first, second, third = rng.permutation(len(DYES))[:3]
    base, over = (paint(DYES[i], rng.uniform(0.75, 0.9), rng) for i in (first, second))
    cloth = rng.choice(["plain", "stripes", "checked", "leather"])
    if cloth == "stripes":
        thin = (paint(DYES[third], 0.85, rng), room_patterns.bands(rng, 0.05, 0.12, 0.25))
        return Layers(base, ((over, patterns.stripes(rng, rng.uniform(0.12, 0.2), axis=0)), thin))
    if cloth == "checked":
        return Layers(base, ((over, room_patterns.weave(rng, rng.uniform(0.14, 0.24))),))
    if cloth == "leather":
        base = paint(WOODS[rng.choice([0, 3, 4, 6])], rng.uniform(0.35, 0.55), rng)
        return Layers(base, ((darker(base, 0.6, 0.2), patterns.patches(rng, 0.2)),))
    return Layers(base, ((darker(base, 0.7, 0.05), patterns.clouds(rng, 0.12)),))


def _shade(rng: Rng, primitive: Primitive) -> Surface:
    if rng.random() < 0.4:
        return metal(rng, primitive)
    base = paint(DYES[rng.choice([0, 1, 2, 3, 5, 13])], 0.8, rng)
    if rng.random() < 0.5:
        trim = darker(base, 0.45)
        return Layers(base, ((trim, patterns.stripes(rng, 0.1, axis=1)),))
    return Layers(base, ((darker(base, 0.8), patterns.clouds(rng, 0.1)),))


def _stone(rng: Rng, _: Primitive) -> Surface:
    base = paint(STONES[rng.integers(len(STONES))], rng.uniform(0.15, 0.5), rng)
    if rng.random() < 0.65:
        vein = darker(base, 0.3) if base.albedo.mean() > 0.2 else paint(STONES[0], 0.3, rng)
        return Layers(base, ((vein, patterns.veins(rng, rng.uniform(0.18, 0.3))),))
    fleck = paint(STONES[rng.integers(len(STONES))], rng.uniform(0.2, 0.6), rng)
    return Layers(base, ((fleck, patterns.patches(rng, 0.09)),))


def _books(rng: Rng, _: Primitive) -> Surface:
    """Spines side by side, in four colours."""
    paints = [paint(DYES[i], rng.uniform(0.4, 0.8), rng) for i in rng.permutation(len(DYES))[:4]]
    layers = [(cover, room_patterns.bands(rng, 0.035, 0.075, 0.4)) for cover in paints[1:]]
    return Layers(paints[0], tuple(layers))


def _paper(rng: Rng, _: Primitive) -> Surface:
    base = paint(DYES[rng.integers(len(DYES))], rng.uniform(0.4, 0.85), rng)
    return Layers(base, ((darker(base, 0.75), patterns.clouds(rng, 0.12)),))


def _leaves(rng: Rng, primitive: Primitive) -> Surface:
    small = getattr(primitive, "radius", 1.0) < 0.1
    colors = FRUIT if small else LEAVES
    first, second = rng.permutation(len(colors))[:2]
    base = paint(colors[first], 0.4 if small else rng.uniform(0.45, 0.7), rng)
    over = paint(colors[second], 0.45 if small else rng.uniform(0.4, 0.6), rng)
    return Layers(base, ((over, patterns.patches(rng, 0.1)),))


def _canvas(rng: Rng, _: Primitive) -> Surface:
    """Draw an abstract painting: four paints."""
    paints = [paint(DYES[i], rng.uniform(0.4, 0.8), rng) for i in rng.permutation(len(DYES))[:4]]
    shapes = [
        patterns.patches(rng, 0.3),
        patterns.stripes(rng, rng.uniform(0.25, 0.5)),
        patterns.patches(rng, 0.18),
    ]
    return Layers(paints[0], tuple(zip(paints[1:], shapes, strict=True)))


def _rug(rng: Rng, primitive: Primitive) -> Surface:
    """Draw a field with a figure, and two borders."""
    paints = [paint(DYES[i], 0.88, rng) for i in rng.permutation(len(DYES))[:4]]
    disc = isinstance(primitive, Cylinder)
    if isinstance(primitive, Cylinder):
        x = z = primitive.radius
    else:
        assert isinstance(primitive, Box)
        x, z = float(primitive.half[0]), float(primitive.half[2])
    figure = rng.choice(["stripes", "checker", "patches"])
    field = {
        "stripes": lambda: patterns.stripes(rng, 0.3, axis=int(rng.choice([0, 2]))),
        "checker": lambda: patterns.checker(rng, 0.45),
        "patches": lambda: patterns.patches(rng, 0.25),
    }[figure]()
    return Layers(
        paints[0],
        (
            (paints[1], field),
            (paints[2], room_patterns.frame(x, z, -0.02, 0.17, disc=disc)),
            (paints[3], room_patterns.frame(x, z, 0.05, 0.05, disc=disc)),
        ),
    )


_COVERINGS: dict[str, Callable[[Rng, Primitive], Surface]] = {
    "wood": _wood,
    "lacquer": _lacquer,
    "metal": metal,
    "frame": _frame,
    "vessel": _vessel,
    "textile": _textile,
    "shade": _shade,
    "stone": _stone,
    "books": _books,
    "paper": _paper,
    "leaves": _leaves,
    "canvas": _canvas,
    "rug": _rug,
}
MAY_BE_METAL = frozenset({"lacquer", "frame", "vessel", "shade", "metal"})


def covering(part: Part, rng: Rng) -> Surface:
    """Draw what a part is made of."""
    return _COVERINGS[part.role](rng, part.primitive)


def unmetal(rng: Rng) -> Surface:
    """Draw a lacquer on what was of metal."""
    base = paint(DYES[rng.integers(len(DYES))], rng.uniform(0.25, 0.6), rng)
    return Layers(base, ((darker(base, 0.8, 0.1), patterns.clouds(rng, 0.25)),))
