"""Things that stand on tables, shelves and cabinets. Each stands on y = 0 at the origin."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pbrfit_evaluation.rooms import coverings as of
from pbrfit_evaluation.rooms.parts import Parts, ball, box, cone, drum, pick, placed, reach

UP = np.array([0.0, 1.0, 0.0])
Thing = Callable[[np.random.Generator], tuple[Parts, float]]
"""Draws the parts of a thing, and the radius of the circle on which it stands."""


def bottle(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a body, and a neck that narrows."""
    radius, height = rng.uniform(0.065, 0.095), rng.uniform(0.17, 0.26)
    neck = rng.uniform(0.55, 0.8) * height
    return (
        drum(of.vessel, "glass", (0, 0, 0), radius, height),
        cone(of.vessel, "glass", (0, height, 0), radius, 0.35 * radius, neck),
    ), radius


def vase(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a belly that widens and a neck that narrows."""
    foot, belly = rng.uniform(0.06, 0.09), rng.uniform(0.12, 0.17)
    low, high = rng.uniform(0.12, 0.2), rng.uniform(0.1, 0.22)
    return (
        cone(of.vessel, "glaze", (0, 0, 0), foot, belly, low),
        cone(of.vessel, "glaze", (0, low, 0), belly, rng.uniform(0.4, 0.8) * belly, high),
    ), belly


def bowl(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a bowl, filled with fruit or not."""
    foot, rim, height = rng.uniform(0.07, 0.1), rng.uniform(0.16, 0.22), rng.uniform(0.09, 0.14)
    parts = [cone(of.vessel, "bowl", (0, 0, 0), foot, rim, height)]
    if rng.random() < 0.6:
        radius = rng.uniform(0.07, 0.085)
        start = rng.uniform(0, 2 * np.pi)
        for i in range(3):
            angle = start + 2 * np.pi * i / 3
            at = (0.085 * np.cos(angle), height + 0.5 * radius, 0.085 * np.sin(angle))
            parts.append(ball(of.leaves, "fruit", at, radius))
    return tuple(parts), rim


def globe(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a ball on a foot."""
    radius, foot = rng.uniform(0.12, 0.17), rng.uniform(0.03, 0.06)
    return (
        cone(of.frame, "foot", (0, 0, 0), 0.8 * radius, 0.5 * radius, foot),
        ball(of.vessel, "ball", (0, foot + 0.95 * radius, 0), radius),
    ), radius


def pot(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a cooking pot with a lid and a knob."""
    radius, height = rng.uniform(0.14, 0.19), rng.uniform(0.14, 0.2)
    return (
        drum(of.metal, "pot", (0, 0, 0), radius, height),
        cone(of.metal, "pot", (0, height, 0), 1.06 * radius, 0.45 * radius, 0.05),
        ball(of.frame, "knob", (0, height + 0.075, 0), 0.038),
    ), radius


def goblet(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a cup on a foot, of metal."""
    radius, height = rng.uniform(0.1, 0.13), rng.uniform(0.15, 0.2)
    return (
        cone(of.metal, "cup", (0, 0, 0), 0.8 * radius, 0.035, 0.11),
        cone(of.metal, "cup", (0, 0.11, 0), 0.045, radius, height),
    ), radius


def kettle(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a kettle: a cone with a domed lid."""
    radius, height = rng.uniform(0.14, 0.18), rng.uniform(0.18, 0.23)
    return (
        cone(of.metal, "kettle", (0, 0, 0), radius, 0.6 * radius, height),
        ball(of.metal, "kettle", (0, height - 0.02, 0), 0.5 * radius),
        ball(of.frame, "knob", (0, height + 0.5 * radius, 0), 0.03),
    ), radius


def casket(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a box with a lid."""
    half = rng.uniform([0.13, 0.06, 0.1], [0.2, 0.12, 0.14])
    lid = rng.uniform(0.012, 0.03)
    over = (half[0] + 0.012, lid, half[2] + 0.012)
    return (
        box(of.lacquer, "box", (0, half[1], 0), half),
        box(of.lacquer, "lid", (0, 2 * half[1] + lid, 0), over),
    ), float(np.hypot(half[0], half[2]))


def book_pile(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw two or three lying books."""
    parts: Parts = ()
    y = 0.0
    for i in range(rng.integers(2, 4)):
        half = rng.uniform([0.13, 0.025, 0.1], [0.18, 0.045, 0.13])
        book = box(of.paper, f"cover{i}", (0, half[1], 0), half)
        parts += placed([book], (0, y, 0), yaw=rng.uniform(-25, 25))
        y += 2 * half[1]
    return parts, 0.2


def cube(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a block of stone, paper or wood."""
    half = rng.uniform(0.09, 0.14) * rng.uniform(0.8, 1.2, size=3)
    part = box(pick(rng, of.stone, of.paper, of.wood), "block", (0, half[1], 0), half)
    return placed([part], yaw=rng.uniform(-30, 30)), float(np.hypot(half[0], half[2]))


def lamp(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a table lamp: foot, body and shade."""
    radius, rim = rng.uniform(0.1, 0.14), rng.uniform(0.19, 0.25)
    body = rng.uniform(0.16, 0.24)
    if rng.random() < 0.5:
        stem = ball(of.vessel, "body", (0, 0.03 + 0.9 * radius, 0), radius)
        top = 0.03 + 1.9 * radius
    else:
        stem = cone(of.vessel, "body", (0, 0.03, 0), 0.9 * radius, 0.04, body)
        top = 0.03 + body
    return (
        drum(of.frame, "foot", (0, 0, 0), radius, 0.03),
        stem,
        cone(of.shade, "shade", (0, top - 0.01, 0), rim, rng.uniform(0.45, 0.8) * rim, 0.26),
    ), rim


def plant(rng: np.random.Generator) -> tuple[Parts, float]:
    """Draw a small plant in a pot."""
    radius, height = rng.uniform(0.09, 0.12), rng.uniform(0.13, 0.18)
    crown = rng.uniform(0.13, 0.17)
    return (
        cone(of.vessel, "pot", (0, 0, 0), 0.75 * radius, radius, height),
        ball(of.leaves, "leaves", (0, height + 0.75 * crown, 0), crown),
    ), crown


TABLEWARE: tuple[Thing, ...] = (
    bottle, vase, bowl, globe, pot, goblet, kettle, casket, book_pile, cube, lamp, plant
)  # fmt: skip
SMALL = tuple(thing for thing in TABLEWARE if thing not in (pot, lamp))


def row(
    rng: np.random.Generator,
    things: tuple[Thing, ...],
    at: tuple[float, float, float],
    count: int,
    *,
    length: float,
    depth: float,
    ceiling: float = np.inf,
    tag: str = "top",
) -> Parts:
    """Stand up to `count` different things in a row along x, centred `at` a place.

    The row is no longer than `length`, no thing deeper than `depth` or higher than `ceiling`.
    """
    chosen: list[tuple[Parts, float]] = []
    for i in rng.permutation(len(things)):
        parts, radius = things[i](rng)
        used = sum(2 * r for _, r in chosen)
        fits = 2 * radius <= depth and used + 2 * radius <= length
        if fits and reach(parts, UP) <= ceiling and len(chosen) < count:
            chosen.append((placed(parts, tag=f"thing{len(chosen)}"), radius))
    slack = length - sum(2 * radius for _, radius in chosen)
    gaps = rng.dirichlet(np.full(len(chosen) + 1, 2.0)) * slack
    standing: Parts = ()
    x = -length / 2
    for (parts, radius), gap in zip(chosen, gaps, strict=False):
        x += gap + radius
        aside = max(depth / 2 - radius, 0.0)
        standing += placed(parts, (x, 0.0, rng.uniform(-aside, aside)))
        x += radius
    return placed(standing, at, tag=tag)
