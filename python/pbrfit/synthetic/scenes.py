"""Three procedural scenes: a furnished room, a case of spheres, and a room of textured things.

A scene is a closed shell of six planes and the pieces inside it, each with a surface: one paint,
or two paints blended by a pattern in the piece's object space. Scene space has Y up, in metres;
the camera looks into it from a rotated frame, and everything `build` returns is in camera space.

The stage (shell, pieces and camera) is drawn before the surfaces, and never depends on the size or
the field of view of the picture: the same generator state gives the same scene in any resolution,
and "room" and "textured" share their geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.geometry import view_directions
from pbrfit.materials import Materials
from pbrfit.synthetic.geometry import (
    Box,
    Cylinder,
    Plane,
    Primitive,
    Sphere,
    rotation,
    trace,
)

Array = NDArray[np.float64]
Pattern = Callable[[Array], Array]
SceneKind = Literal["room", "spheres", "textured"]


@dataclass(frozen=True)
class RayCast:
    """What the camera sees, before any light.

    Attributes
    ----------
    normals
        (H, W, 3) exact unit normals in camera space (X right, Y up, Z towards the viewer).
    segments
        (H, W) ids from 1, one for each piece and each wall.
    materials
        Ground truth; albedo in linear Rec.709.
    mask
        (H, W), or None when every pixel is valid.
    fov
        Horizontal field of view in degrees.
    """

    normals: Array
    segments: NDArray[np.uint16]
    materials: Materials
    mask: NDArray[np.bool_] | None
    fov: float


def build(kind: SceneKind, size: int, rng: np.random.Generator, fov: float = 60.0) -> RayCast:
    """Draw a scene and cast one ray through every pixel centre.

    Parameters
    ----------
    kind
        "room": furniture of constant materials, at least a third of the pieces metal.
        "spheres": a grid, roughness growing from left to right, metal and dielectric rows.
        "textured": the room with patterns in albedo, roughness and, on some pieces, metallic.
    size
        Width and height of the picture in pixels.
    rng
        Source of randomness; the same state gives the same scene at every size.
    fov
        Horizontal field of view in degrees, 0 < fov < 180.

    Returns
    -------
    RayCast
        Every pixel valid (`mask` None) and facing the camera.

    Raises
    ------
    InputError
        When `kind` is unknown, `size` is below 1, or `fov` is outside its range.
    """
    if kind not in get_args(SceneKind):
        raise InputError(f"kind: expected one of {', '.join(get_args(SceneKind))}, found {kind!r}")
    if size < 1:
        raise InputError(f"size: expected at least 1 pixel, found {size}")
    if not 0 < fov < 180:
        raise InputError(f"fov: expected degrees between 0 and 180, found {fov}")
    if kind == "spheres":
        columns, rows = rng.integers(4, 6, size=2)
        stage = _case_stage(rows, columns, rng)
        surfaces = _case_surfaces(rows, columns, rng)
    else:
        stage = _room_stage(rng)
        surfaces = (_textured_surfaces if kind == "textured" else _plain_surfaces)(
            len(stage.pieces), rng
        )

    rays = -view_directions(size, size, fov).reshape(-1, 3)
    hits = trace(stage.primitives, stage.eye, rays @ stage.turn.T)
    albedo, roughness, metallic = np.empty((size * size, 3)), *np.empty((2, size * size))
    for i in np.unique(hits.index):
        here = hits.index == i
        albedo[here], roughness[here], metallic[here] = surfaces[i].at(hits.local[here])
    return RayCast(
        normals=(hits.normals @ stage.turn).reshape(size, size, 3),
        segments=(hits.index + 1).astype(np.uint16).reshape(size, size),
        materials=Materials(
            albedo=albedo.reshape(size, size, 3),
            roughness=roughness.reshape(size, size),
            metallic=metallic.reshape(size, size),
        ),
        mask=None,
        fov=fov,
    )


# ---------------------------------------------------------------------------------------- stages


@dataclass(frozen=True)
class _Stage:
    """Six walls, the pieces between them, and a camera at `eye` whose axes are `turn`'s columns."""

    walls: Sequence[Primitive]
    pieces: Sequence[Primitive]
    eye: Array
    turn: Array

    @property
    def primitives(self) -> list[Primitive]:
        return [*self.walls, *self.pieces]

    def smallest_share(self) -> float:
        """Share of a 48 x 48 picture that the least visible piece covers."""
        rays = -view_directions(48, 48, 60.0).reshape(-1, 3)
        hits = trace(self.primitives, self.eye, rays @ self.turn.T)
        counts = np.bincount(hits.index, minlength=len(self.walls) + len(self.pieces))
        return float(counts[len(self.walls) :].min() / len(rays))


def _shell(low: Array, high: Array) -> list[Primitive]:
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


def _room_stage(rng: np.random.Generator) -> _Stage:
    """Draw rooms until every piece covers at least 0.6 % of the picture; the best of 20 if none."""
    best, best_share = None, -1.0
    for _ in range(20):
        aside = rng.uniform(-0.9, 0.9)
        yaw = np.degrees(np.arctan2(aside, 3.6)) + rng.uniform(-4, 4)  # to the middle of the room
        stage = _Stage(
            walls=_shell(_ROOM_LOW, _ROOM_HIGH),
            pieces=_furniture(rng),
            eye=np.array([aside, rng.uniform(1.5, 1.75), 0.2]),
            turn=rotation(1, yaw) @ rotation(0, rng.uniform(-13, -9)),
        )
        share = stage.smallest_share()
        if share > best_share:
            best, best_share = stage, share
        if share >= 0.006:
            break
    assert best is not None
    return best


def _furniture(rng: np.random.Generator) -> list[Primitive]:
    """10 to 12 pieces: three things on stands, or two and a column, two on the floor, and more.

    The tall ones stand in a row at the back, the low ones before the gaps between them; a shelf
    with one or two small things hangs on the back wall, a lamp from the ceiling, and beside a
    column sometimes a panel on a side wall.
    """
    tall: list[list[Primitive]] = []
    for _ in range(3):
        stand = _stand(rng)
        item = _item(rng, rng.uniform(0.3, 0.38))
        tall.append([stand, _moved(item, 0.0, 2 * stand.centre[1], 0.0)])
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
        pieces += [_moved(piece, x, 0.0, z) for piece in group]

    board = np.array([0.7, 0.05, 0.25])
    x, y = rng.uniform(-1.0, 1.0), rng.uniform(1.68, 1.82)
    z = _ROOM_LOW[2] + board[2]
    pieces.append(Box(centre=np.array([x, y, z]), half=board))
    for side in (-0.35, 0.35)[: rng.integers(1, 3)]:
        small = _item(rng, rng.uniform(0.19, 0.22))
        pieces.append(_moved(small, x + side, y + board[1], z + 0.05))

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


def _moved(piece: Primitive, x: float, y: float, z: float) -> Primitive:
    return replace(piece, centre=piece.centre + np.array([x, y, z]))


def _case_stage(rows: int, columns: int, rng: np.random.Generator) -> _Stage:
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
    return _Stage(
        walls=_shell(np.array([-2.6, -1.85, back]), np.array([2.6, 2.9, 1.0])),
        pieces=[*spheres, *shelves],
        eye=np.array([aside, above, before]),
        turn=rotation(1, to_the_middle[0]) @ rotation(0, to_the_middle[1]),
    )


# -------------------------------------------------------------------------------------- surfaces


@dataclass(frozen=True)
class _Paint:
    """One material; albedo (3,) in linear Rec.709."""

    albedo: Array
    roughness: float
    metallic: float


def _plain(points: Array) -> Array:
    return np.zeros(len(points))


@dataclass(frozen=True)
class _Surface:
    """`base` where the pattern is 0, `over` where it is 1, a mixture between."""

    base: _Paint
    over: _Paint
    pattern: Pattern = _plain

    def at(self, points: Array) -> tuple[Array, Array, Array]:
        """Albedo (P, 3), roughness (P,) and metallic (P,) at object-space points (P, 3)."""
        w = self.pattern(points)
        base, over = self.base, self.over
        return (
            base.albedo + w[:, None] * (over.albedo - base.albedo),
            base.roughness + w * (over.roughness - base.roughness),
            base.metallic + w * (over.metallic - base.metallic),
        )


# Linear Rec.709. F0 of gold, copper, aluminium, steel, brass and bronze.
_METALS = np.array(
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
_COLORS = np.array(
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
_WALLS = np.array(
    [
        [0.72, 0.68, 0.60],
        [0.60, 0.66, 0.62],
        [0.50, 0.58, 0.68],
        [0.70, 0.52, 0.42],
        [0.36, 0.44, 0.40],
    ]
)
_FLOORS = np.array([[0.36, 0.22, 0.12], [0.16, 0.17, 0.19], [0.55, 0.47, 0.36]])
_RUST = np.array([0.32, 0.11, 0.05])


def _shade(color: Array, rng: np.random.Generator, spread: float = 0.15) -> Array:
    """Make the colour a little lighter or darker in each channel, within [0.05, 0.9]."""
    jitter = rng.uniform(1 - spread, 1 + spread) * rng.uniform(0.94, 1.06, size=3)
    return np.clip(color * jitter, 0.05, 0.9)


def _metal(rng: np.random.Generator) -> _Paint:
    """Draw a bare metal, roughness 0.15 to 0.7."""
    color = rng.choice(_METALS) * rng.uniform(0.92, 1.03)
    return _Paint(albedo=color, roughness=rng.uniform(0.15, 0.7), metallic=1.0)


def _dielectric(rng: np.random.Generator) -> _Paint:
    """Draw a paint or plastic, roughness 0.2 to 0.9."""
    color = _shade(rng.choice(_COLORS), rng)
    return _Paint(albedo=color, roughness=rng.uniform(0.2, 0.9), metallic=0.0)


def _wall_paints(rng: np.random.Generator) -> list[_Paint]:
    """Paints in the order of `_shell`: floor, ceiling, and four walls of two colours."""
    floor = _Paint(_shade(rng.choice(_FLOORS), rng), rng.uniform(0.25, 0.6), 0.0)
    ceiling = _Paint(_shade(_COLORS[0], rng, 0.05), rng.uniform(0.7, 0.9), 0.0)
    colors = [_shade(color, rng) for color in rng.permutation(_WALLS)[:3]]
    walls = [_Paint(color, rng.uniform(0.5, 0.9), 0.0) for color in colors]
    return [floor, ceiling, walls[0], walls[1], walls[2], walls[0]]


def _metal_pieces(count: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(count,): at least a third, at most half of the pieces."""
    metals = rng.integers(-(-count // 3), count // 2 + 1)
    return rng.permutation(count) < metals


def _plain_surfaces(count: int, rng: np.random.Generator) -> list[_Surface]:
    """Constant materials for the six walls and `count` pieces."""
    pieces = [_metal(rng) if metal else _dielectric(rng) for metal in _metal_pieces(count, rng)]
    return [_Surface(paint, paint) for paint in [*_wall_paints(rng), *pieces]]


def _case_surfaces(rows: int, columns: int, rng: np.random.Generator) -> list[_Surface]:
    """Every second row metal; roughness grows along each row, in the order of `_case_stage`."""
    roughness = np.linspace(0.15, 0.85, columns)
    metals, colors = rng.permutation(_METALS), rng.permutation(_COLORS)
    first_metal = rng.integers(2)
    paints = []
    for row in range(rows):
        metal = (row + first_metal) % 2 == 0
        color = metals[row] if metal else _shade(colors[row], rng)
        paints += [_Paint(color, float(r), float(metal)) for r in roughness]
    board = _Paint(_shade(rng.choice(_FLOORS), rng), rng.uniform(0.3, 0.7), 0.0)
    return [_Surface(p, p) for p in [*_wall_paints(rng), *paints, *[board] * rows]]


def _textured_surfaces(count: int, rng: np.random.Generator) -> list[_Surface]:
    """Patterned materials for the six walls and `count` pieces."""
    floor, ceiling, left, right, back, front = _wall_paints(rng)
    tiles = _checker(rng, 1.1) if rng.random() < 0.5 else _planks(rng, 0.3)
    other = _Paint(_shade(0.5 * floor.albedo, rng), rng.uniform(0.25, 0.7), 0.0)
    walls = [_Surface(floor, other, tiles), _Surface(ceiling, ceiling)]
    for paint in (left, right, back, front):
        other = _Paint(_shade(0.75 * paint.albedo, rng), rng.uniform(0.3, 0.9), 0.0)
        pattern = _stripes(rng, 0.5, axis=0) if rng.random() < 0.4 else _clouds(rng, 0.9)
        walls.append(_Surface(paint, other, pattern))
    metals = _metal_pieces(count, rng)
    first = int(np.argmax(metals))  # one piece is metal all over
    pieces = [
        (_worn_metal(rng, whole=i == first) if metal else _decorated(rng))
        for i, metal in enumerate(metals)
    ]
    return [*walls, *pieces]


def _worn_metal(rng: np.random.Generator, *, whole: bool) -> _Surface:
    """Smudged, rusty, chipped or inlaid metal; metallic is 1 everywhere on a `whole` one."""
    metal = _metal(rng)
    finish = "smudged" if whole else rng.choice(["smudged", "rusty", "chipped", "inlaid"])
    if finish == "smudged":
        rough = float(np.clip(metal.roughness + rng.choice([-0.3, 0.3]), 0.15, 0.7))
        return _Surface(metal, replace(metal, roughness=rough), _clouds(rng, 0.25))
    if finish == "rusty":
        rust = _Paint(_shade(_RUST, rng), rng.uniform(0.7, 0.9), 0.0)
        return _Surface(metal, rust, _patches(rng, 0.3))
    if finish == "chipped":
        return _Surface(_dielectric(rng), metal, _patches(rng, 0.3))
    return _Surface(_dielectric(rng), metal, _stripes(rng, 0.4, axis=1))


def _decorated(rng: np.random.Generator) -> _Surface:
    """Draw a dielectric: two paints in checks, stripes or patches, wood, or marble."""
    finish = rng.choice(["checker", "stripes", "patches", "wood", "marble"])
    base = _dielectric(rng)
    if finish == "wood":
        light = _shade(np.array([0.46, 0.27, 0.13]), rng, 0.3)
        base = _Paint(light, rng.uniform(0.3, 0.5), 0.0)
        dark = _Paint(_shade(0.4 * light, rng), rng.uniform(0.5, 0.8), 0.0)
        return _Surface(base, dark, _grain(rng, 0.2))
    if finish == "marble":
        over = _Paint(_shade(0.35 * base.albedo, rng), rng.uniform(0.2, 0.5), 0.0)
        return _Surface(base, over, _veins(rng, 0.3))
    pattern = {"checker": _checker, "stripes": _stripes, "patches": _patches}[finish]
    return _Surface(base, _dielectric(rng), pattern(rng, 0.35))


# -------------------------------------------------------------------------------------- patterns
#
# A pattern maps object-space points (P, 3) to [0, 1]. Lengths are in metres. Its finest detail, the
# soft edges apart, is some five pixels of a 128 x 128 picture at the usual distance of 3.5 m.


def _edge(signal: Array, softness: float = 0.25) -> Array:
    """0 below -softness, 1 above, and a smooth step between."""
    x = np.clip(signal / (2 * softness) + 0.5, 0.0, 1.0)
    return np.asarray(x * x * (3 - 2 * x))


def _checker(rng: np.random.Generator, period: float) -> Pattern:
    """Cubes of half a period, filled in turn."""
    phase = np.array([rng.uniform(0, 2 * np.pi), np.pi / 2, rng.uniform(0, 2 * np.pi)])

    def pattern(points: Array) -> Array:
        waves = 2 * _edge(np.sin(2 * np.pi / period * points + phase)) - 1
        return np.asarray((waves.prod(axis=-1) + 1) / 2)

    return pattern


def _stripes(rng: np.random.Generator, period: float, axis: int | None = None) -> Pattern:
    """Bands across one object axis."""
    along = rng.integers(3) if axis is None else axis
    phase, bias = rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.3)
    return lambda points: _edge(np.sin(2 * np.pi / period * points[:, along] + phase) + bias)


def _clouds(rng: np.random.Generator, scale: float) -> Pattern:
    """Smooth, gentle variation."""
    noise = _value_noise(rng, scale, octaves=2)
    return lambda points: _edge(noise(points), 1.0)


def _patches(rng: np.random.Generator, scale: float) -> Pattern:
    """Islands with a ragged outline over a bit less than half of the surface."""
    noise = _value_noise(rng, scale, octaves=3)
    return lambda points: _edge(noise(points) - 0.1, 0.12)


def _veins(rng: np.random.Generator, period: float) -> Pattern:
    """Marble: thin dark sheets, bent by noise."""
    noise = _value_noise(rng, 1.5 * period, octaves=3)
    tilt = rng.normal(size=3)
    tilt *= np.pi / (period * np.linalg.norm(tilt))

    def pattern(points: Array) -> Array:
        return np.asarray((1 - np.abs(np.sin(points @ tilt + 4.0 * noise(points)))) ** 2)

    return pattern


def _grain(rng: np.random.Generator, period: float) -> Pattern:
    """Wood: year rings about a trunk along x that lies outside the object, bent by noise."""
    noise = _value_noise(rng, 2 * period, octaves=2)
    heart = np.array([rng.uniform(0.6, 1.2), rng.uniform(-0.3, 0.3)])

    def pattern(points: Array) -> Array:
        stretched = points * [0.25, 1.0, 1.0]
        ring = np.linalg.norm(stretched[:, 1:] - heart, axis=-1) / period
        return np.asarray(0.5 + 0.5 * np.sin(2 * np.pi * (ring + 0.45 * noise(stretched))))

    return pattern


def _planks(rng: np.random.Generator, width: float) -> Pattern:
    """Floor boards along z, each of its own tone, with a long grain."""
    noise = _value_noise(rng, width, octaves=2)
    tones = rng.random(32)

    def pattern(points: Array) -> Array:
        x = points[:, 0] / width
        board = np.floor(x)
        seam = _edge(x - board - 0.94, 0.04)  # the next board's tone sets in over the last tenth
        left = board.astype(np.int64)
        tone = (1 - seam) * tones[left % 32] + seam * tones[(left + 1) % 32]
        return np.asarray(np.clip(tone + 0.2 * noise(points * [1.0, 1.0, 0.2]), 0.0, 1.0))

    return pattern


def _value_noise(rng: np.random.Generator, scale: float, octaves: int) -> Pattern:
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
            corner = np.floor(position)
            f = position - corner
            f = f * f * (3 - 2 * f)
            i, j, k = corner.astype(np.int64).T % cells
            value = np.zeros(len(points))
            for a, b, c in np.ndindex(2, 2, 2):
                weight = np.prod(np.where([a, b, c], f, 1 - f), axis=-1)
                value += weight * table[octave, (i + a) % cells, (j + b) % cells, (k + c) % cells]
            total += 1.4 * value / 2**octave
        return total

    return noise
