"""Arrangements: furniture along the walls of a room and about a table, and a camera.

Rooms differ in size, furniture, arrangement and camera. A room is drawn again until enough of its
furniture, and of what may be of metal, is in view.

A furnished room has a material for each part of its arrangement. A few of the materials are
exchanged until metal has its share of the picture: `METAL_SHARE`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.geometry import view_directions
from pbrfit.synthetic.geometry import Hits, Primitive, rotation, trace
from pbrfit.synthetic.stages import Stage, shell
from pbrfit.synthetic.surfaces import Spots, Surface
from pbrfit.synthetic.world import World
from pbrfit_evaluation.rooms import furniture
from pbrfit_evaluation.rooms.coverings import MAY_BE_METAL, metal, shell_coverings, unmetal
from pbrfit_evaluation.rooms.furniture import Piece
from pbrfit_evaluation.rooms.parts import Parts, placed, reach

Rng = np.random.Generator

METAL_SHARE = (0.13, 0.3, 0.45)
"""Share of the picture with metallic >= 0.5, at 48 x 48 and 60 degrees: its least value is drawn
between the first two, its largest is the third."""

_PROBE = 48


def draw_furnished(rng: Rng) -> tuple[World, list[str]]:
    """Draw a furnished room with its materials.

    Returns the world, and for each piece after the walls a tag: pieces of one have one material.
    """
    stage, parts = draw_room(rng)
    by_tag: dict[str, Surface] = {}
    for part in parts:
        if part.tag not in by_tag:
            by_tag[part.tag] = part.covering(rng, part.primitive)
    covers = shell_coverings(tuple(stage.walls), rng)
    _balance(by_tag, stage, parts, rng)
    tags = [part.tag for part in parts]
    world = World(
        primitives=tuple(stage.primitives),
        surfaces=(*covers, *(by_tag[tag] for tag in tags)),
        walls=len(stage.walls),
        eye=stage.eye,
        turn=stage.turn,
    )
    return world, tags


def _balance(by_tag: dict[str, Surface], stage: Stage, parts: Parts, rng: Rng) -> None:
    """Change materials, the largest first, until metal has its share of the picture."""
    hits = look(stage, _PROBE)
    first: dict[str, Primitive] = {}
    seen: dict[str, NDArray[np.intp]] = {}
    for i, part in enumerate(parts, start=len(stage.walls)):
        if part.covering in MAY_BE_METAL:
            first.setdefault(part.tag, part.primitive)
            here = np.flatnonzero(hits.index == i)
            seen[part.tag] = np.concatenate([seen.get(part.tag, here[:0]), here])
    order = sorted(seen, key=lambda tag: (-len(seen[tag]), tag))

    def share(tag: str) -> float:
        points = hits.local[seen[tag]]
        spots = Spots(points, hits.normals[seen[tag]], np.zeros(len(points)))
        return float(np.sum(by_tag[tag].at(spots).metallic >= 0.5)) / len(hits.index)

    least = rng.uniform(*METAL_SHARE[:2])
    shares = {tag: share(tag) for tag in order}
    for tag in order:
        total = sum(shares.values())
        if total > METAL_SHARE[2] and shares[tag] > 0:
            by_tag[tag] = unmetal(rng)
        elif total < least and shares[tag] < 0.5 * len(seen[tag]) / len(hits.index):
            by_tag[tag] = metal(rng, first[tag])
        shares[tag] = share(tag)


_GLANCE = 32  # side in pixels of the picture by which a room is judged
_LEAST_PIECES = 20  # to be seen, each in at least _LEAST_PIXELS of the glance
_LEAST_PIXELS = 2
_LEAST_FURNITURE = 0.36  # share of the glance
_LEAST_POSSIBLE_METAL = 0.19  # share of the glance that parts cover which may be of metal
_MOST_PARTS = 31, 39  # of a room: its limit is drawn between these
_GAP = 0.06  # metres between things that stand side by side


@dataclass
class _Plan:
    """The floor as it fills up."""

    walls: Sequence[Primitive]
    most: int  # parts
    taken: list[tuple[float, float, float, float]]
    parts: Parts = ()
    pieces: int = 0

    def is_free(self, x: float, z: float, half_x: float, half_z: float) -> bool:
        return all(
            abs(x - a) >= half_x + half_a + _GAP or abs(z - b) >= half_z + half_b + _GAP
            for a, b, half_a, half_b in self.taken
        )

    def place(self, piece: Piece, at: tuple[float, float, float], yaw: float) -> bool:
        """Add a piece that has its place, unless it would run into a wall or be too much."""
        parts = placed(piece.parts, at, yaw=yaw, tag=f"{self.pieces}")
        if len(self.parts) + len(parts) > self.most:
            return False
        for wall in self.walls:
            outwards = -wall.rotation[:, 1]
            if reach(parts, outwards) > wall.centre @ outwards + 1e-9:
                return False
        self.parts += parts
        self.pieces += 1
        return True

    def stand(self, piece: Piece, x: float, z: float, yaw: float) -> bool:
        """Stand a piece on the floor, unless something else is in its way."""
        c, s = abs(np.cos(np.radians(yaw))), abs(np.sin(np.radians(yaw)))
        half_x = c * piece.half[0] + s * piece.half[1]
        half_z = s * piece.half[0] + c * piece.half[1]
        if not self.is_free(x, z, half_x, half_z) or not self.place(piece, (x, 0.0, z), yaw):
            return False
        self.taken.append((x, z, half_x, half_z))
        return True


def draw_room(rng: Rng) -> tuple[Stage, Parts]:
    """Draw rooms until one shows enough; the best of 10 if none does.

    Returns walls, primitives of all furniture and the camera; and the furniture in the order of the
    stage's pieces, of which those with the same tag have the same material.
    """
    best, best_score = None, -1.0
    for _ in range(10):
        room = _arrange(rng)
        score = _score(*room)
        if score > best_score:
            best, best_score = room, score
        if score >= 1.0:
            break
    assert best is not None
    return best


def _score(stage: Stage, parts: Parts) -> float:
    """Least ratio of what a room shows to what it should: pieces, furniture, possible metal."""
    hits = look(stage, _GLANCE)
    pixels = np.bincount(hits.index, minlength=len(stage.primitives))[len(stage.walls) :]
    possible = np.array([part.covering in MAY_BE_METAL for part in parts])
    return min(
        float(np.sum(pixels >= _LEAST_PIXELS)) / _LEAST_PIECES,
        float(pixels.sum()) / len(hits.index) / _LEAST_FURNITURE,
        float(pixels[possible].sum()) / len(hits.index) / _LEAST_POSSIBLE_METAL,
    )


def look(stage: Stage, size: int) -> Hits:
    """Cast the rays of a square picture of 60 degrees."""
    rays = -view_directions(size, size, 60.0).reshape(-1, 3)
    return trace(stage.primitives, stage.eye, rays @ stage.turn.T)


def _arrange(rng: Rng) -> tuple[Stage, Parts]:
    width, depth, height = rng.uniform([3.2, 3.0, 2.4], [4.4, 3.9, 2.9])
    low, high = np.array([-width / 2, 0.0, -depth]), np.array([width / 2, height, 1.4])
    walls = shell(low, high)
    plan = _Plan(walls, most=int(rng.integers(*_MOST_PARTS)), taken=[])
    if rng.random() < 0.4:  # a wall of books, and less in the middle
        plan.stand(furniture.bookcase(rng), rng.uniform(-0.5, 0.5), 0.25 - depth, 0.0)
    _fill_middle(plan, rng, depth, height)
    _fill_back(plan, rng, width, depth)
    for side in rng.permutation([-1, 1]):
        _fill_side(plan, rng, int(side), width, depth)

    aside = rng.uniform(-0.3, 0.3) * width
    eye = np.array([aside, rng.uniform(1.25, 1.75), rng.uniform(0.0, 0.35)])
    target = np.array([rng.uniform(-0.35, 0.35), rng.uniform(0.72, 1.0), -0.65 * depth])
    x, y, z = target - eye
    yaw, pitch = np.degrees(np.arctan2(-x, -z)), np.degrees(np.arctan2(y, np.hypot(x, z)))
    stage = Stage(
        walls=walls,
        pieces=[part.primitive for part in plan.parts],
        eye=eye,
        turn=rotation(1, yaw) @ rotation(0, pitch),
    )
    return stage, plan.parts


def _fill_middle(plan: _Plan, rng: Rng, depth: float, height: float) -> None:
    """Stand a table with seats about it, on a rug and under a lamp or not."""
    x, z = rng.uniform(-0.3, 0.3), -0.56 * depth + rng.uniform(-0.1, 0.15)
    low = bool(rng.random() < 0.45)
    yaw = rng.uniform(-20, 20)
    plan.stand(furniture.table(rng, low=low), x, z, yaw)
    if rng.random() < 0.6:
        plan.place(furniture.carpet(rng), (x, 0.0, z), rng.uniform(-8, 8))
    seats = (furniture.stool, furniture.armchair) if low else (furniture.chair, furniture.stool)
    wanted = int(rng.integers(1, 3))
    for side in rng.permutation([-1, 1, -1, 1]):
        seat = seats[rng.integers(2)](rng)
        at = x + side * rng.uniform(0.85, 1.15)
        turn = -90 * side + rng.uniform(-25, 25)
        if wanted:
            wanted -= plan.stand(seat, at, z + rng.uniform(-0.25, 0.35), turn)
    if rng.random() < 0.5:
        lamp = furniture.pendant(rng, height, rng.uniform(1.5, 1.75))
        plan.place(lamp, (x + rng.uniform(-0.3, 0.3), 0.0, z - rng.uniform(0.0, 0.5)), 0.0)


_ALONG_WALLS: tuple[Callable[[Rng], Piece], ...] = (
    furniture.bookcase,
    furniture.sideboard,
    furniture.locker,
    furniture.chest,
    furniture.armchair,
    furniture.floor_lamp,
    furniture.potted_tree,
    furniture.urn,
)


def _fill_back(plan: _Plan, rng: Rng, width: float, depth: float) -> None:
    """Fill the back wall from left to right; hang pictures and shelves over what is low."""
    low: list[tuple[float, float, float]] = []  # middle, width, and height of what stands there
    left = -width / 2 + rng.uniform(0.05, 0.25)
    for i in rng.permutation(len(_ALONG_WALLS)):
        piece = _ALONG_WALLS[i](rng)
        x = left + piece.half[0]
        if x + piece.half[0] > width / 2 - 0.05:
            continue
        if plan.stand(piece, x, -depth + piece.half[1] + 0.02, 0.0):
            top = max(0.0, *(float(part.primitive.centre[1]) for part in piece.parts))
            right = left + 2 * piece.half[0]
            if max(top, piece.height) < 1.1:
                low.append(((left + right) / 2, right - left, max(top + 0.2, piece.height)))
            left += 2 * piece.half[0] + rng.uniform(_GAP + 0.01, 0.3)
    for x, free, height in low:
        hung = furniture.wall_shelf(rng) if rng.random() < 0.25 else furniture.picture(rng)
        y = max(height + 0.12 + hung.height / 2, rng.uniform(1.35, 1.6))
        if free > 1.6 * hung.half[0] and y < 1.9:
            plan.place(hung, (x, y, -depth), 0.0)


def _fill_side(plan: _Plan, rng: Rng, side: int, width: float, depth: float) -> None:
    """Stand one or two pieces along the left (-1) or right (1) wall; hang a picture above."""
    wall, yaw = side * width / 2, -90.0 * side
    for i in rng.permutation(len(_ALONG_WALLS))[:3]:
        piece = _ALONG_WALLS[i](rng)
        if len(plan.parts) > plan.most - 8 and len(piece.parts) > 5:
            continue
        z = rng.uniform(-depth + 0.6, -1.5)
        if plan.stand(piece, wall - side * (piece.half[1] + 0.02), z, yaw) and piece.height < 1.0:
            break
    if rng.random() < 0.6:
        hung = furniture.picture(rng)
        at = (wall, rng.uniform(1.5, 1.7), rng.uniform(-depth + 0.6, -1.8))
        tall = any(
            abs(z - at[2]) < half_z + hung.half[0] and abs(x - wall) < half_x + 0.2
            for x, z, half_x, half_z in plan.taken
        )
        if not tall:
            plan.place(hung, at, yaw)
