"""Stages: where walls, pieces and the camera stand, before they have any material.

A stage is a closed shell of six planes, the pieces inside it, and a camera. Scene space has Y up,
in metres. A stage never depends on the size or the field of view of a picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pbrfit.model.geometry import view_directions
from pbrfit.synthetic.geometry import Box, Cylinder, Plane, Primitive, Sphere, rotation, trace
from pbrfit.values.arrays import Array


@dataclass(frozen=True)
class Stage:
    """Six walls, the pieces between them, and a camera at `eye` whose axes are `turn`'s columns."""

    walls: Sequence[Primitive]
    pieces: Sequence[Primitive]
    eye: Array
    turn: Array

    @property
    def primitives(self) -> list[Primitive]:
        """Walls, then pieces."""
        return [*self.walls, *self.pieces]


def shell(low: Array, high: Array) -> list[Primitive]:
    """Floor, ceiling, left, right, back and front of a room, seen from inside."""
    middle = (low + high) / 2
    walls: list[Primitive] = []
    for axis, at, turn in (
        (1, low, np.eye(3)),
        (1, high, rotation(0, 180)),
        (0, low, rotation(2, -90)),
        (0, high, rotation(2, 90)),
        (2, low, rotation(0, 90)),
        (2, high, rotation(0, -90)),
    ):
        centre = middle.copy()
        centre[axis] = at[axis]
        walls.append(Plane(centre=centre, rotation=turn))
    return walls


_ROOM_LOW, _ROOM_HIGH = np.array([-2.2, 0.0, -4.7]), np.array([2.2, 2.6, 1.5])


def room_stage(rng: np.random.Generator) -> Stage:
    """Draw rooms until every piece covers at least 0.6 % of the picture; the best of 20 if none."""
    best, best_share = None, -1.0
    for _ in range(20):
        aside = rng.uniform(-0.9, 0.9)
        yaw = np.degrees(np.arctan2(aside, 3.6)) + rng.uniform(-4, 4)  # to the middle of the room
        stage = Stage(
            walls=shell(_ROOM_LOW, _ROOM_HIGH),
            pieces=_room_pieces(rng),
            eye=np.array([aside, rng.uniform(1.5, 1.75), 0.2]),
            turn=rotation(1, yaw) @ rotation(0, rng.uniform(-13, -9)),
        )
        # Of a 48 x 48 picture, that of the least visible piece.
        rays = -view_directions(48, 48, 60.0).reshape(-1, 3)
        hits = trace(stage.primitives, stage.eye, rays @ stage.turn.T)
        counts = np.bincount(hits.index, minlength=len(stage.primitives))
        share = float(counts[len(stage.walls) :].min() / len(rays))
        if share > best_share:
            best, best_share = stage, share
        if share >= 0.006:
            break
    assert best is not None
    return best


def _room_pieces(rng: np.random.Generator) -> list[Primitive]:
    """10 to 12 pieces: three things on stands, or two and a column, two on the floor, and more.

    The tall ones stand in a row at the back, the low ones before the gaps between them; a shelf
    with one or two small things hangs on the back wall, a lamp from the ceiling, and beside a
    column sometimes a panel on a side wall.
    """
    tall: list[list[Primitive]] = []
    for _ in range(3):
        stand = _stand(rng)
        item = _item(rng, rng.uniform(0.3, 0.38))
        tall.append([stand, moved(item, 0.0, 2 * stand.centre[1], 0.0)])
    with_column = rng.random() < 0.5
    if with_column:
        half = rng.uniform(0.75, 0.92)
        radius = rng.uniform(0.2, 0.3)
        tall[0] = [Cylinder(centre=np.array([0.0, half, 0.0]), radius=radius, half=half)]
    low = [[_item(rng, rng.uniform(0.34, 0.42))] for _ in range(2)]

    pieces: list[Primitive] = []
    row = [tall[i] for i in rng.permutation(3)]
    for x, z, group in zip(
        [-1.5, 0.0, 1.5, -0.65, 0.65], [-3.5, -3.5, -3.5, -2.3, -2.3], [*row, *low], strict=True
    ):
        x += rng.uniform(-0.06, 0.06)
        z += rng.uniform(-0.1, 0.1)
        pieces += [moved(piece, x, 0.0, z) for piece in group]

    board = np.array([0.7, 0.05, 0.25])
    x, y = rng.uniform(-1.0, 1.0), rng.uniform(1.68, 1.82)
    z = _ROOM_LOW[2] + board[2]
    pieces.append(Box(centre=np.array([x, y, z]), half=board))
    for side in (-0.35, 0.35)[: rng.integers(1, 3)]:
        small = _item(rng, rng.uniform(0.19, 0.22))
        pieces.append(moved(small, x + side, y + board[1], z + 0.05))

    radius, half = rng.uniform(0.26, 0.36), rng.uniform(0.18, 0.26)
    x, y, z = rng.uniform(-1.2, 1.2), _ROOM_HIGH[1], rng.uniform(-3.7, -3.4)
    if rng.random() < 0.5:
        pieces.append(Sphere(centre=np.array([x, y - radius, z]), radius=radius))
    else:
        pieces.append(Cylinder(centre=np.array([x, y - half, z]), radius=radius, half=half))

    if with_column and rng.random() < 0.5:
        panel = np.array([0.04, 0.4, 0.5])
        x = rng.choice([_ROOM_LOW[0] + panel[0], _ROOM_HIGH[0] - panel[0]])
        y, z = rng.uniform(1.5, 1.7), rng.uniform(-3.9, -3.5)
        pieces.append(Box(centre=np.array([x, y, z]), half=panel))
    return pieces


def _stand(rng: np.random.Generator) -> Primitive:
    """Draw a plinth on the floor at the origin."""
    half = rng.uniform(0.22, 0.4)
    width = rng.uniform(0.32, 0.4)
    centre = np.array([0.0, half, 0.0])
    if rng.random() < 0.3:
        return Cylinder(centre=centre, radius=width, half=half)
    turn = rotation(1, rng.uniform(0, 90))
    return Box(centre=centre, rotation=turn, half=np.array([width, half, width]))


def _item(rng: np.random.Generator, size: float) -> Primitive:
    """Draw a sphere, box or cylinder of about `size` radius, resting on y = 0 at the origin."""
    shape = rng.choice(["sphere", "box", "drum", "roll"], p=[0.4, 0.25, 0.2, 0.15])
    turn = rotation(1, rng.uniform(0, 360))
    if shape == "sphere":  # turned anyhow, for the sake of its pattern
        turn = turn @ rotation(0, rng.uniform(0, 360))
        return Sphere(centre=np.array([0, size, 0]), rotation=turn, radius=size)
    if shape == "box":
        half = size * rng.uniform([0.7, 0.6, 0.7], [0.95, 1.2, 0.95])
        return Box(centre=np.array([0, half[1], 0]), rotation=turn, half=half)
    if shape == "drum":
        tall = size * rng.uniform(0.6, 1.2)
        radius = size * rng.uniform(0.6, 0.9)
        return Cylinder(centre=np.array([0, tall, 0]), rotation=turn, radius=radius, half=tall)
    radius = size * rng.uniform(0.7, 0.9)
    long = size * rng.uniform(0.8, 0.95)
    return Cylinder(
        centre=np.array([0, radius, 0]), rotation=turn @ rotation(0, 90), radius=radius, half=long
    )


def moved(piece: Primitive, x: float, y: float, z: float) -> Primitive:
    """Shift a piece by (x, y, z)."""
    return replace(piece, centre=piece.centre + np.array([x, y, z]))


def case_stage(rows: int, columns: int, rng: np.random.Generator) -> Stage:
    """Spheres on shelves before a wall, row by row from the top; the shelves come last."""
    radius, back = 1.45 / max(rows, columns), -4.2
    depth = 1.05 * radius
    x = 4.0 / columns * (np.arange(columns) - (columns - 1) / 2)
    y = 3.5 / rows * ((rows - 1) / 2 - np.arange(rows)) + 0.12
    spheres: list[Primitive] = [
        Sphere(centre=np.array([across, up, back + depth]), radius=radius)
        for up in y
        for across in x
    ]
    board = np.array([2.0, 0.035, depth])
    shelves: list[Primitive] = [
        Box(centre=np.array([0.0, up - radius - board[1], back + depth]), half=board) for up in y
    ]
    aside, above, before = rng.uniform(-0.7, 0.7), rng.uniform(-0.2, 0.5), 0.2
    to_the_middle = np.degrees(np.arctan2([aside, -above], before - back))
    return Stage(
        walls=shell(np.array([-2.6, -1.85, back]), np.array([2.6, 2.9, 1.0])),
        pieces=[*spheres, *shelves],
        eye=np.array([aside, above, before]),
        turn=rotation(1, to_the_middle[0]) @ rotation(0, to_the_middle[1]),
    )
