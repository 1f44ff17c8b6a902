"""Furniture, and things that stand on it.

Each piece stands on y = 0 at the origin, and its front faces +z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pbrfit_evaluation.rooms import coverings as of
from pbrfit_evaluation.rooms.parts import Part, Parts, ball, box, cone, drum, pick, placed, reach

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


@dataclass(frozen=True)
class Piece:
    """A piece of furniture with what stands on it."""

    parts: Parts
    """In the space of the piece."""
    half: tuple[float, float]
    """Half its width and half its depth: the rectangle of floor or wall that it takes."""
    height: float
    """Without what stands on it."""


def table(rng: np.random.Generator, *, low: bool) -> Piece:
    """Draw a table, round or not, with things on it."""
    height = rng.uniform(0.4, 0.5) if low else rng.uniform(0.68, 0.76)
    x, z = rng.uniform(0.5, 0.7), rng.uniform(0.36, 0.46)
    board = rng.uniform(0.025, 0.04)
    top = pick(rng, of.wood, of.stone, of.lacquer)
    parts: list[Part] = []
    if rng.random() < 0.35:
        x = z = rng.uniform(0.46, 0.58)
        parts.append(drum(top, "board", (0, height - 2 * board, 0), x, 2 * board))
        leg = height - 2 * board - 0.04
        parts.append(cone(of.frame, "legs", (0, 0.04, 0), 0.11, 0.06, leg))
        parts.append(drum(of.frame, "legs", (0, 0, 0), 0.6 * x, 0.04))
        length, depth = 1.5 * x, x
    else:
        parts.append(box(top, "board", (0, height - board, 0), (x, board, z)))
        half, leg = rng.uniform(0.03, 0.045), height - 2 * board
        round_legs = rng.random() < 0.5
        for i, j in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
            at = (i * (x - 1.6 * half), 0.0, j * (z - 1.6 * half))
            if round_legs:
                parts.append(cone(of.frame, "legs", at, 0.7 * half, 1.2 * half, leg))
            else:
                middle = (at[0], leg / 2, at[2])
                parts.append(box(of.frame, "legs", middle, (half, leg / 2, half)))
        length, depth = 1.8 * x, 1.7 * z
    count = int(rng.integers(3, 5))
    things = row(rng, TABLEWARE, (0, height, 0), count, length=length, depth=depth)
    return Piece((*parts, *things), (x, z), height)


def bookcase(rng: np.random.Generator) -> Piece:
    """Draw two sides, three boards, and books and things on them."""
    x, z = rng.uniform(0.42, 0.56), rng.uniform(0.17, 0.2)
    height, thick = rng.uniform(1.5, 1.8), 0.025
    cover = pick(rng, of.wood, of.lacquer, of.frame)
    inner, levels = 2 * (x - 2 * thick), np.linspace(0.08, height - thick, 4)
    half = (thick, height / 2, z)
    sides = [box(cover, "case", (i * (x - thick), height / 2, 0), half) for i in (-1, 1)]
    boards = [box(cover, "case", (0, at, 0), (x - 2 * thick, thick, z)) for at in levels]
    parts: Parts = (*sides, *boards)
    clear = float(levels[1] - levels[0]) - 2 * thick
    for i, level in enumerate(levels[:-1]):
        floor = float(level) + thick
        free, x_free, count = inner, 0.0, 2
        if rng.random() < 0.55:
            width, tall = rng.uniform(0.5, 0.75) * inner, rng.uniform(0.7, 0.92) * clear
            x_books = rng.choice([-1, 1]) * (inner - width) / 2
            at = (x_books, floor + tall / 2, 0.0)
            parts += (box(of.books, f"books{i}", at, (width / 2, tall / 2, 0.75 * z)),)
            free, x_free, count = inner - width, float(-np.sign(x_books) * width / 2), 1
        at, tag = (x_free, floor, 0.0), f"level{i}"
        parts += row(rng, SMALL, at, count, length=free, depth=2 * z, ceiling=clear, tag=tag)
    return Piece(parts, (x, z), height)


def sideboard(rng: np.random.Generator) -> Piece:
    """Draw a cabinet with two doors and knobs, and things on it."""
    x, z = rng.uniform(0.5, 0.7), rng.uniform(0.2, 0.25)
    height = rng.uniform(0.65, 0.85)
    cover, front = pick(rng, of.wood, of.lacquer, of.lacquer), pick(rng, of.wood, of.lacquer)
    over = pick(rng, of.wood, of.stone, cover)
    body, foot = height - 0.03, 0.08
    parts: Parts = (
        box(of.frame, "plinth", (0, foot / 2, 0), (0.92 * x, foot / 2, 0.9 * z)),
        box(cover, "body", (0, (body + foot) / 2, 0), (x, (body - foot) / 2, z)),
        box(over, "top", (0, body + 0.015, 0.01), (x + 0.02, 0.015, z + 0.02)),
    )
    half = (body - foot) / 2 - 0.03
    for side in (-1, 1):
        at = (side * x / 2, (body + foot) / 2, z)
        parts += (box(front, "doors", at, (x / 2 - 0.025, half, 0.018)),)
        knob = (side * 0.09, (body + foot) / 2 + 0.3 * half, z + 0.03)
        parts += (ball(of.metal, "knobs", knob, 0.035),)
    count = int(rng.integers(2, 4))
    things = row(rng, TABLEWARE, (0, height, 0), count, length=1.9 * x, depth=1.9 * z)
    return Piece((*parts, *things), (x + 0.02, z + 0.05), height)


def locker(rng: np.random.Generator) -> Piece:
    """Draw a refrigerator or steel cupboard: two doors, one above the other, and handles."""
    x, z, height = rng.uniform(0.3, 0.38), rng.uniform(0.27, 0.33), rng.uniform(1.4, 1.75)
    split = rng.uniform(0.55, 0.7) * height
    parts: Parts = (box(of.lacquer, "body", (0, height / 2, 0), (x, height / 2, z)),)
    for low, high in ((0.06, split - 0.012), (split + 0.012, height - 0.02)):
        middle, half = (low + high) / 2, (high - low) / 2
        parts += (
            box(of.lacquer, "doors", (0, middle, z), (x - 0.015, half, 0.025)),
            box(of.frame, "handles", (-0.75 * x, middle, z + 0.05), (0.022, 0.5 * half, 0.025)),
        )
    return Piece(parts, (x, z + 0.07), height)


def chest(rng: np.random.Generator) -> Piece:
    """Draw a trunk with metal bands."""
    x, z, height = rng.uniform(0.38, 0.52), rng.uniform(0.22, 0.28), rng.uniform(0.4, 0.55)
    lid = 0.3 * height
    parts: Parts = (
        box(of.wood, "body", (0, (height - lid) / 2, 0), (x, (height - lid) / 2, z)),
        box(of.wood, "lid", (0, height - lid / 2, 0), (x + 0.015, lid / 2, z + 0.015)),
    )
    for side in (-0.55, 0.55):
        at = (side * x, height / 2 + 0.004, 0.0)
        parts += (box(of.metal, "bands", at, (0.045, height / 2 + 0.004, z + 0.025)),)
    things = row(rng, SMALL, (0, height + 0.008, 0), 1, length=1.6 * x, depth=1.8 * z)
    return Piece((*parts, *things), (x + 0.02, z + 0.03), height)


def chair(rng: np.random.Generator) -> Piece:
    """Draw a chair."""
    half, seat, back = rng.uniform(0.2, 0.23), rng.uniform(0.42, 0.47), rng.uniform(0.38, 0.48)
    leg = rng.uniform(0.024, 0.034)
    cover = pick(rng, of.wood, of.textile, of.lacquer)
    parts: Parts = (box(cover, "seat", (0, seat - 0.03, 0), (half, 0.03, half)),)
    for i, j in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        top = seat + 0.6 * back if j < 0 else seat - 0.06
        at = (i * (half - leg), top / 2, j * (half - leg) - (0.07 if j < 0 else 0.0))
        parts += (box(of.frame, "legs", at, (leg, top / 2, leg)),)
    at = (0.0, seat + 0.65 * back, -half - 0.03)
    parts += (box(cover, "seat", at, (half + 0.01, 0.35 * back, 0.028)),)
    return Piece(parts, (half + 0.02, half + 0.1), seat + back)


def stool(rng: np.random.Generator) -> Piece:
    """Draw a round stool on a column, or a pouf."""
    radius, height = rng.uniform(0.19, 0.26), rng.uniform(0.4, 0.55)
    if rng.random() < 0.4:
        pouf = drum(of.textile, "pouf", (0, 0, 0), radius + 0.06, 0.8 * height)
        return Piece((pouf,), (radius + 0.06, radius + 0.06), 0.8 * height)
    parts = (
        drum(pick(rng, of.textile, of.wood, of.metal), "seat", (0, height - 0.08, 0), radius, 0.08),
        drum(of.frame, "foot", (0, 0.035, 0), 0.045, height - 0.115),
        cone(of.frame, "foot", (0, 0, 0), 0.9 * radius, 0.6 * radius, 0.035),
    )
    return Piece(parts, (radius, radius), height)


def _above_floor(tag: str, half: tuple[float, float], top: float, z: float) -> Part:
    """Upholstery from 5 cm above the floor to `top`."""
    middle, tall = (top + 0.05) / 2, (top - 0.05) / 2
    return box(of.textile, tag, (0, middle, z), (half[0], tall, half[1]))


def armchair(rng: np.random.Generator) -> Piece:
    """Draw an upholstered armchair or, wider, a sofa, with a cushion."""
    x = rng.uniform(0.36, 0.42) if rng.random() < 0.5 else rng.uniform(0.6, 0.72)
    z, seat, arm = 0.36, rng.uniform(0.36, 0.42), rng.uniform(0.54, 0.62)
    back = rng.uniform(0.78, 0.9)
    parts: Parts = (
        _above_floor("cover", (x - 0.09, z - 0.06), seat, 0.06),
        _above_floor("cover", (x - 0.09, 0.09), back, 0.09 - z),
    )
    for side in (-1, 1):
        at = (side * (x - 0.045), 0.05 + (arm - 0.05) / 2, 0.0)
        parts += (box(of.textile, "cover", at, (0.045, (arm - 0.05) / 2, z)),)
    parts += (box(of.frame, "base", (0, 0.025, 0), (0.9 * x, 0.025, 0.85 * z)),)
    side = rng.choice([-1, 1])
    pillow = box(of.textile, "cushion", (side * 0.4 * x, seat + 0.15, -0.05), (0.15, 0.15, 0.06))
    return Piece((*parts, pillow), (x, z), back)


def floor_lamp(rng: np.random.Generator) -> Piece:
    """Draw a lamp on a pole."""
    height, rim = rng.uniform(1.2, 1.5), rng.uniform(0.2, 0.27)
    parts = (
        cone(of.frame, "pole", (0, 0, 0), 0.17, 0.14, 0.04),
        drum(of.frame, "pole", (0, 0.04, 0), 0.032, height - 0.04),
        cone(of.shade, "shade", (0, height - 0.02, 0), rim, rng.uniform(0.5, 0.85) * rim, 0.3),
    )
    return Piece(parts, (rim, rim), height + 0.28)


def potted_tree(rng: np.random.Generator) -> Piece:
    """Draw a plant in a pot on the floor."""
    radius, height = rng.uniform(0.19, 0.25), rng.uniform(0.3, 0.4)
    stem, crown = rng.uniform(0.3, 0.5), rng.uniform(0.24, 0.3)
    top = height + stem
    parts = (
        cone(of.vessel, "pot", (0, 0, 0), 0.75 * radius, radius, height),
        drum(of.wood, "stem", (0, height, 0), 0.035, stem),
        ball(of.leaves, "leaves", (0.06, top + 0.5 * crown, 0), crown),
        ball(of.leaves, "leaves", (-0.16, top + 0.1 * crown, 0.08), 0.7 * crown),
    )
    return Piece(parts, (crown, crown), top + 1.5 * crown)


def urn(rng: np.random.Generator) -> Piece:
    """Draw a large vase on the floor."""
    foot, belly, lip = rng.uniform([0.13, 0.22, 0.1], [0.17, 0.28, 0.16])
    low, high = rng.uniform(0.3, 0.45), rng.uniform(0.22, 0.35)
    parts = (
        cone(of.vessel, "urn", (0, 0, 0), foot, belly, low),
        cone(of.vessel, "urn", (0, low, 0), belly, lip, high),
        cone(of.vessel, "urn", (0, low + high, 0), lip, 1.4 * lip, 0.1),
    )
    return Piece(parts, (belly, belly), low + high + 0.1)


def picture(rng: np.random.Generator) -> Piece:
    """Draw a framed picture or a mirror that hangs on a wall, the wall at z = 0."""
    x, y = rng.uniform(0.25, 0.42), rng.uniform(0.22, 0.32)
    border = rng.uniform(0.04, 0.06)
    inside = of.metal if rng.random() < 0.3 else of.canvas
    parts = (
        box(of.frame, "frame", (0, 0, 0.02), (x, y, 0.02)),
        box(inside, "inside", (0, 0, 0.024), (x - border, y - border, 0.024)),
    )
    return Piece(parts, (x, 0.05), 2 * y)


def wall_shelf(rng: np.random.Generator) -> Piece:
    """Draw a board on a wall with things on it, the wall at z = 0."""
    x, z = rng.uniform(0.4, 0.55), 0.19
    board = box(pick(rng, of.wood, of.lacquer, of.frame), "board", (0, 0, z), (x, 0.028, z))
    count = int(rng.integers(2, 4))
    things = row(rng, SMALL, (0, 0.028, z), count, length=1.9 * x, depth=1.9 * z)
    return Piece((board, *things), (x, z), 0.056)


def pendant(rng: np.random.Generator, ceiling: float, height: float) -> Piece:
    """Draw a lamp that hangs from the ceiling at y = `ceiling`, its rim at `height`."""
    rim = rng.uniform(0.24, 0.32)
    tall = rng.uniform(0.2, 0.3)
    if rng.random() < 0.4:
        head = ball(of.shade, "shade", (0, height + 0.75 * rim, 0), 0.75 * rim)
        top = height + 1.45 * rim
    else:
        head = cone(of.shade, "shade", (0, height, 0), rim, rng.uniform(0.15, 0.5) * rim, tall)
        top = height + tall
    cord = drum(of.frame, "cord", (0, top, 0), 0.025, ceiling - top)
    return Piece((head, cord), (rim, rim), ceiling)


def carpet(rng: np.random.Generator) -> Piece:
    """Draw a rug, round or not."""
    x, z = rng.uniform(0.9, 1.2), rng.uniform(0.65, 0.85)
    if rng.random() < 0.25:
        return Piece((drum(of.rug, "rug", (0, 0, 0), x, 0.015),), (x, x), 0.015)
    return Piece((box(of.rug, "rug", (0, 0.0075, 0), (x, 0.0075, z)),), (x, z), 0.015)
