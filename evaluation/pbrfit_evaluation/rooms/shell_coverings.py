"""Coverings of the shell of a furnished room: floor, ceiling and walls."""

from __future__ import annotations

import numpy as np

from pbrfit.synthetic import patterns
from pbrfit.synthetic.geometry import Primitive
from pbrfit.synthetic.surfaces import Layers, Paint, Surface
from pbrfit_evaluation.rooms import patterns as room_patterns
from pbrfit_evaluation.rooms.palette import DYES, STONES, WALL_PAINTS, WOODS, darker, paint

Rng = np.random.Generator


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
        layers: list[tuple[Paint, patterns.Pattern]] = []
        base = accent if kind == "accent" else plain
        layers.append((darker(base, 0.88, 0.05), patterns.clouds(rng, 0.7)))
        sideways = 0 if abs(up[0]) < 0.5 else 2
        if kind == "wallpaper":
            layers.append((accent, patterns.stripes(rng, rng.uniform(0.2, 0.4), axis=sideways)))
        elif kind == "brick":
            clay = paint(DYES[rng.choice([0, 2, 12])], 0.85, rng)
            base = darker(clay, 0.65, 0.0)
            joint = room_patterns.joints(rng, 0.34, 0.16, running=True, joint=0.028)
            layers = [
                (clay, room_patterns.tile_tones(rng, 0.34, 0.16)),
                (paint(STONES[1], 0.9, rng), joint),
            ]
        elif kind == "tiles":
            glaze = paint(DYES[rng.integers(len(DYES))], rng.uniform(0.15, 0.35), rng)
            base, side = darker(glaze, 0.8, 0.0), rng.uniform(0.22, 0.34)
            joint = room_patterns.joints(rng, side, side, running=False, joint=0.026)
            grout = paint(STONES[rng.choice([0, 2])], 0.85, rng)
            layers = [(glaze, patterns.clouds(rng, 0.3)), (grout, joint)]
        if dado is not None and kind in ("paint", "accent", "wallpaper"):
            panel = darker(accent, 0.7, -0.2) if kind != "accent" else darker(plain, 0.7, -0.2)
            layers.append((panel, room_patterns.above(-up, -(foot + dado))))
        skirting = paint(DYES[rng.choice([0, 1])], 0.4, rng, 0.05)
        layers.append((skirting, room_patterns.above(-up, -(foot + 0.1))))
        covers.append(Layers(base, tuple(layers)))
    return covers


def _ceiling(rng: Rng) -> Surface:
    base = paint(DYES[0], 0.85, rng, 0.05)
    return Layers(base, ((darker(base, 0.92), patterns.clouds(rng, 0.8)),))


def _floor(rng: Rng) -> Surface:
    kind = rng.choice(
        ["planks", "tiles", "checker", "marble", "concrete"], p=[0.4, 0.2, 0.15, 0.1, 0.15]
    )
    if kind == "planks":
        light = paint(WOODS[rng.integers(len(WOODS))], rng.uniform(0.25, 0.55), rng, 0.25)
        width = rng.uniform(0.14, 0.22)
        grain = patterns.grain(rng, 0.09)
        return Layers(
            light,
            (
                (darker(light, 0.55, 0.1), patterns.planks(rng, width)),
                (darker(light, 0.4, 0.2), lambda p: 0.4 * grain(p[:, [2, 0, 1]])),
            ),
        )  # fmt: skip
    if kind == "concrete":
        base = paint(STONES[2], rng.uniform(0.4, 0.8), rng, 0.3)
        stain = (darker(base, 0.6, 0.1), patterns.patches(rng, 0.5))
        return Layers(base, ((darker(base, 0.8, -0.15), patterns.clouds(rng, 0.25)), stain))
    side = rng.uniform(0.3, 0.5)
    first, second = rng.permutation(len(STONES))[:2]
    base = paint(STONES[first], rng.uniform(0.15, 0.5), rng)
    grout = paint(STONES[2], 0.85, rng)
    joint = (grout, room_patterns.joints(rng, side, side, running=False))
    if kind == "tiles":
        return Layers(
            base, ((darker(base, 0.6, 0.1), room_patterns.tile_tones(rng, side, side)), joint)
        )
    if kind == "checker":
        over = paint(STONES[second], rng.uniform(0.15, 0.4), rng)
        return Layers(base, ((over, patterns.checker(rng, 2 * side)),))
    vein = darker(base, 0.3) if base.albedo.mean() > 0.2 else paint(STONES[0], 0.3, rng)
    return Layers(base, ((vein, patterns.veins(rng, 0.4)), joint))
