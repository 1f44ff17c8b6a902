"""A ball in the pictures, mirror or matt, and the lamps that it shows.

The outline of a ball is a circle in the picture. In perspective the rays through it form a cone
around an axis c with the half angle α; with the radius as unit the centre is D c, sin α = 1/D, and
a ray u within the cone meets the ball where

    t = D c·u − √(1 − D² (1 − (c·u)²)),   n = t u − D c.

A far lamp shows in a mirror ball where l = 2 (n·v) n − v, v = −u. A matt ball has the radiance
b·n where that is positive and no other shadow falls: b by least squares over the pixels that the
lamp reaches tells its direction, b/|b|, and its colour, |b| over the ball's albedo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from pbrfit._core import InputError
from pbrfit.io.limits import Limits
from pbrfit.io.resampling import averaged, reduced_size
from pbrfit.model import geometry
from pbrfit.values.arrays import Array, Floats, Mask

BallKind = Literal["mirror", "matt"]

KINDS: tuple[BallKind, ...] = get_args(BallKind)

SEARCH_SIDE = 320
"""Longer side in pixels of the pictures that a ball is sought in."""

RADII = (0.03, 0.5)
"""Smallest and largest radius that is sought, as shares of the picture's shorter side."""

RADIUS_COUNT = 48
"""Radii between these that are tried, a constant factor apart."""

RADIUS_MIN = 4.0
"""Smallest radius in pixels from which directions can be told."""

SUPPORT_MIN = 0.5
"""Mean strength of the edges along a circle, of usual ones and 1 at most, of what may be a ball."""

STRONG = 3.0
"""Strength of an edge, in that of usual ones, above which its vote counts no more."""

CANDIDATES = 24
"""Circles whose outline is looked at."""

OUTLINE_ANGLES = 180
"""Directions from the centre in which the outline is sought."""

MIRROR_SHARE_MAX = 0.1
"""Share of a ball's disc at half of its largest brightness or more up to which it is a mirror: a
lamp of 60 degrees across takes 0.07 of a mirror ball, light on a matt one mostly 0.3 or more."""

HIGHLIGHT_RATIO_MIN = 3.0
"""Brightness of a highlight over the median of the ball, from which on it is one."""

HIGHLIGHT_LEVELS = (0.5, 0.8)
"""Shares of its largest brightness at which a highlight's middle is taken, and its certainty."""

REACHED_COSINE_MIN = 0.1
"""Cosine to the lamp from which on a pixel of a matt ball counts as reached."""

RIM_COSINE_MIN = 0.2
"""Cosine to the viewer below which pixels of a matt ball are left out: the rim is blurred."""

ROUNDS_MAX = 20


@dataclass(frozen=True)
class Ball:
    """The circle of a ball in the picture, in pixels."""

    x: float
    """Of the centre, from the left; the middle of the first column is 0."""
    y: float
    """From the top."""
    radius: float


@dataclass(frozen=True, eq=False)
class BallLights:
    """A far lamp for each of N pictures, as balls show it."""

    kind: BallKind
    directions: Array
    """(N, 3) unit vectors to the lamps, camera space."""
    colors: Array
    """(N, 3), radiance of a white ball facing the lamp times the albedo; NaN of mirror balls."""
    degrees: Array
    """(N,): how sure the directions are, by what half a pixel makes, and of a mirror ball the shape
    of the highlight, of a matt one half of the angle between what its brighter and its darker half
    say; of several balls at least half of the largest angle between theirs."""
    residuals: Array
    """(N,): RMS that light does not explain, relative to the brightest pixel; NaN of mirrors."""
    highlights: Array
    """(N, B, 2): x and y in pixels of the highlight in each of B mirror balls, of a matt one where
    it faces the lamp, NaN where that is not seen."""


def find_ball(images: Floats) -> Ball:
    """Find the circle of a ball in pictures (N, H, W, 3).

    Edges that lie in the same place in all pictures vote for the centres of circles; the best
    candidates are fitted to the outline, first in small pictures, then in those at full size.
    Raises InputError if no circle has an outline all around.
    """
    size = images.shape[1:3]
    small = reduced_size(size, SEARCH_SIDE)
    means = (image.mean(axis=-1, dtype=np.float64) for image in images)
    planes = [np.nan_to_num(mean, posinf=0.0, neginf=0.0) for mean in means]
    strength, angle = _edges([averaged(plane, small) for plane in planes])
    outlines = [_outlined(one, strength, angle) for one in _candidates(strength, angle)]
    outlines = [one for one in outlines if one.support >= SUPPORT_MIN]
    if not outlines:
        raise InputError(
            "ball: expected a circle with an outline all around in the pictures, found none; "
            "--circle X,Y,R says where it is"
        )
    scale = size[1] / small[1]
    ball = max(outlines, key=lambda one: one.weight).ball
    ball = Ball((ball.x + 0.5) * scale - 0.5, (ball.y + 0.5) * scale - 0.5, ball.radius * scale)
    if small == size:
        return ball
    # At full size in a window around it.
    top, left = (max(0, int(at - 1.5 * ball.radius)) for at in (ball.y, ball.x))
    bottom, right = (int(at + 1.5 * ball.radius) + 2 for at in (ball.y, ball.x))
    strength, angle = _edges([plane[top:bottom, left:right] for plane in planes])
    fitted = _outlined(Ball(ball.x - left, ball.y - top, ball.radius), strength, angle).ball
    return Ball(fitted.x + left, fitted.y + top, fitted.radius)


def checked_ball(x: float, y: float, radius: float, size: tuple[int, int]) -> Ball:
    """Check a circle that somebody gave; `size` is the (height, width) of the pictures."""
    height, width = size
    if not radius >= RADIUS_MIN:
        raise InputError(
            f"circle: expected a radius of {RADIUS_MIN:g} pixels or more, found {radius:g}"
        )
    if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        raise InputError(
            f"circle: expected a centre within {width} × {height} pixels, found {x:g},{y:g}"
        )
    return Ball(x, y, radius)


def sphere_normals(
    ball: Ball, size: tuple[int, int], fov: float, columns: Any, rows: Any
) -> tuple[Array, Array]:
    """Normals of a ball (..., 3), NaN outside it, and unit vectors to the viewer (..., 3).

    They are at `columns` and `rows` (...), x and y in pixels, of a picture of `size` (height,
    width) and a horizontal field of view `fov` in degrees, 0 = orthographic.
    """
    views = geometry.views_at(size, fov, columns, rows)
    if fov == 0:
        across = np.stack(np.broadcast_arrays(columns - ball.x, ball.y - rows), axis=-1)
        across /= ball.radius
        squared = 1 - (across**2).sum(axis=-1, keepdims=True)
        normals = np.concatenate([across, np.sqrt(np.maximum(squared, 0.0))], axis=-1)
        return np.where(squared >= 0, normals, np.nan), views
    around = np.linspace(0, 2 * np.pi, OUTLINE_ANGLES, endpoint=False)
    right, down = ball.radius * np.cos(around), ball.radius * np.sin(around)
    outline = -geometry.views_at(size, fov, ball.x + right, ball.y + down)
    # Rays of a cone end in a plane, whose normal is its axis.
    middle = outline.mean(axis=0)
    axis = np.linalg.svd(outline - middle)[2][2]
    axis *= np.sign(axis @ middle)
    distance = 1 / np.sqrt(1 - (axis @ middle) ** 2)
    along = -views @ axis
    with np.errstate(invalid="ignore"):
        t = distance * along - np.sqrt(1 - distance**2 * (1 - along**2))
    return np.asarray(-t[..., None] * views - distance * axis), views


def lights_of_balls(
    images: Floats,
    limits: Limits | None,
    names: Sequence[str],
    balls: Sequence[Ball],
    fov: float,
    kind: BallKind | None = None,
) -> BallLights:
    """Lamps of pictures (N, H, W, 3), from one or several balls of one kind.

    `limits` (N, H, W, 3) are those samples that only bound the radiance; a kind of None is told by
    how much of the balls is bright. Raises InputError if a picture shows no lamp.
    """
    pieces = [_Piece.of(images, limits, ball, fov) for ball in balls]
    if kind is None:  # a mirror ball has small highlights, a matt one is bright on a side
        planes = [plane for piece in pieces for plane in piece.brightness()[:, piece.inside]]
        shares = [np.mean(plane >= 0.5 * plane.max(initial=0.0)) for plane in planes]
        kind = "mirror" if np.median(shares) <= MIRROR_SHARE_MAX else "matt"
    find = _in_mirror if kind == "mirror" else _on_matt
    found = [[find(piece, i, name) for i, name in enumerate(names)] for piece in pieces]
    directions = np.array([[one.direction for one in row] for row in found])
    mean = geometry.unit(directions.sum(axis=0))
    apart = geometry.angles_between(directions[:, None], directions).max(axis=(0, 1)) / 2
    sure = np.sqrt(np.mean([[one.degrees**2 for one in row] for row in found], axis=0))
    return BallLights(
        kind,
        mean,
        np.mean([[one.color for one in row] for row in found], axis=0),
        np.maximum(apart, sure),
        np.mean([[one.residual for one in row] for row in found], axis=0),
        np.array([[one.place for one in row] for row in found]).swapaxes(0, 1),
    )


# Where the ball is


def _edges(planes: Sequence[Array]) -> tuple[Array, Array]:
    """Strength (H, W) of edges that pictures share, and the angle across them, down from right.

    By the structure tensor, the sum of g gᵀ over the pictures' gradients g: what lies in the same
    place in all of them adds up, and highlights that wander do not.
    """
    from scipy.ndimage import gaussian_filter

    tensor = np.zeros((3, *planes[0].shape))
    for plane in planes:
        high = max(float(np.quantile(plane, 0.99)), 0.05 * float(plane.max()))  # small, on black
        if high <= 0:
            continue
        shown = np.sqrt(np.clip(plane / high, 0, 1))  # dim outlines count too
        down, right = (gaussian_filter(shown, 1.0, order=order) for order in ((1, 0), (0, 1)))
        tensor += right * right, down * down, right * down
    xx, yy, xy = tensor
    difference = np.hypot(xx - yy, 2 * xy)
    return np.sqrt((xx + yy + difference) / 2), 0.5 * np.arctan2(2 * xy, xx - yy)


def _candidates(strength: Array, angle: Array) -> list[Ball]:
    """Circles that edges vote for, each to both of its sides."""
    from scipy.ndimage import gaussian_filter

    height, width = strength.shape
    rows, columns = (np.asarray(of, np.intp) for of in np.indices(strength.shape))
    ridge, usual = _ridges(strength, angle)
    weights = np.minimum(strength[ridge] / usual, STRONG)
    rows_of, columns_of = rows[ridge], columns[ridge]
    cosine, sine = np.cos(angle[ridge]), np.sin(angle[ridge])
    short = min(height, width)
    low, high = max(RADIUS_MIN, RADII[0] * short), max(2 * RADIUS_MIN, RADII[1] * short)
    found = []
    for radius in np.geomspace(low, high, RADIUS_COUNT):
        votes = np.zeros(strength.shape)
        for side in (radius, -radius):
            x = np.asarray(np.rint(columns_of + side * cosine), np.intp)
            y = np.asarray(np.rint(rows_of + side * sine), np.intp)
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            np.add.at(votes, (y[inside], x[inside]), weights[inside])
        blur = max(1.0, 0.04 * radius)
        # About the sum within the blur, as a share of the circumference.
        votes = gaussian_filter(votes, blur, mode="constant") * blur**2 / radius
        for _ in range(2):
            row, column = divmod(int(votes.argmax()), width)
            found.append((float(votes[row, column]), Ball(column, row, float(radius))))
            votes[np.hypot(rows - row, columns - column) < radius / 2] = 0
    found.sort(key=lambda one: -one[0])
    return [ball for _, ball in found[:CANDIDATES]]


def _ridges(strength: Array, angle: Array) -> tuple[Mask, float]:
    """Where edges are strongest across themselves, and how strong they usually are there."""
    from scipy.ndimage import map_coordinates

    rows, columns = np.indices(strength.shape)
    ridge = strength > 0
    for side in (1, -1):
        beside = [rows + side * np.sin(angle), columns + side * np.cos(angle)]
        ridge &= strength >= map_coordinates(strength, beside, order=1, mode="nearest")
    usual = float(np.median(strength[ridge])) if ridge.any() else 0.0
    return ridge, max(usual, np.finfo(np.float64).tiny)


class _Outline(NamedTuple):
    """Edges along a circle; those across it count negative, so that edges at random are about 0."""

    ball: Ball
    support: float = 0.0
    """Mean over its directions of their strength, in that of usual edges and 1 at most."""
    weight: float = 0.0
    """How sure it is a ball's: small circles are found by chance, weak ones within balls."""


def _outlined(ball: Ball, strength: Array, angle: Array) -> _Outline:
    """The circle through the strongest edges around a ball."""
    from scipy.ndimage import map_coordinates

    around = np.linspace(0, 2 * np.pi, OUTLINE_ANGLES, endpoint=False)
    cosine, sine = np.cos(around), np.sin(around)
    usual = _ridges(strength, angle)[1]
    # Components of the doubled angle can be interpolated, the angle cannot.
    doubled = [strength * np.cos(2 * angle), strength * np.sin(2 * angle)]

    def radial(ball: Ball, radii: Array) -> Array:
        places = [ball.y + np.outer(sine, radii), ball.x + np.outer(cosine, radii)]
        right, down = (map_coordinates(one, places, order=1, cval=0.0) for one in doubled)
        return np.asarray(np.cos(2 * around)[:, None] * right + np.sin(2 * around)[:, None] * down)

    for reach in (0.2, 0.1, 0.05):
        band = max(2.0, reach * ball.radius)
        radii = ball.radius + np.linspace(-band, band, int(4 * band) + 1)
        found = radial(ball, radii)
        best = found.argmax(axis=1)
        seen = found[np.arange(len(best)), best] > 0.5 * usual
        if np.count_nonzero(seen) < OUTLINE_ANGLES // 4:
            return _Outline(ball)
        fitted = _circle_through(
            (ball.x + radii[best] * cosine)[seen], (ball.y + radii[best] * sine)[seen]
        )
        if not 0.5 * ball.radius <= fitted.radius <= 2 * ball.radius:
            return _Outline(ball)
        ball = fitted
    along = radial(ball, np.array([ball.radius - 0.5, ball.radius + 0.5])).mean(axis=1)
    support = float(np.clip(along / usual, -1, 1).mean())
    median = max(float(np.median(along / usual)), 0.0)
    return _Outline(ball, support, support * math.sqrt(ball.radius * median))


def _circle_through(x: Array, y: Array) -> Ball:
    """By least squares of x² + y² = 2 a x + 2 b y + c, and twice more without the farthest."""
    kept = np.ones(len(x), bool)
    for _ in range(3):
        rows = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=-1)[kept]
        (a, b, c), *_ = np.linalg.lstsq(rows, (x * x + y * y)[kept], rcond=None)
        radius = np.sqrt(max(c + a * a + b * b, 0.0))
        off = np.abs(np.hypot(x - a, y - b) - radius)
        kept = off <= max(3 * float(np.median(off)), 0.25)
        if np.count_nonzero(kept) < 8:
            break
    return Ball(float(a), float(b), float(radius))


# What it shows


@dataclass(frozen=True, eq=False)
class _Piece:
    """The part of all pictures that a ball is in."""

    ball: Ball
    size: tuple[int, int]
    fov: float
    left: int
    top: int
    images: Floats
    """(N, h, w, 3)."""
    free: Mask
    """(N, h, w): samples that are no bounds."""
    normals: Array
    """(h, w, 3), NaN outside the ball."""
    cosine: Array
    """(h, w): to the viewer, NaN outside the ball."""

    @classmethod
    def of(cls, images: Floats, limits: Limits | None, ball: Ball, fov: float) -> _Piece:
        height, width = images.shape[1:3]
        left, right = max(0, int(ball.x - ball.radius)), int(ball.x + ball.radius) + 2
        top, bottom = max(0, int(ball.y - ball.radius)), int(ball.y + ball.radius) + 2
        window = (slice(None), slice(top, bottom), slice(left, right))
        part = np.nan_to_num(images[window], posinf=0.0, neginf=0.0)
        rows, columns = np.indices(part.shape[1:3])
        normals, views = sphere_normals(ball, (height, width), fov, columns + left, rows + top)
        free: Mask = np.ones(part.shape[:3], bool)
        if limits is not None:
            free &= ~limits[window].any(axis=-1)
        cosine = np.einsum("hwx,hwx->hw", normals, views)
        return cls(ball, (height, width), fov, left, top, part, free, normals, cosine)

    @property
    def inside(self) -> Mask:
        """(h, w): of the ball."""
        return np.isfinite(self.cosine)

    def brightness(self) -> Array:
        """(N, h, w)."""
        return np.asarray(self.images.mean(axis=-1, dtype=np.float64))


class _Found(NamedTuple):
    """What a ball says of a picture's lamp, as `BallLights` has it."""

    direction: Array
    color: Array
    degrees: float
    residual: float
    place: tuple[float, float]


def _in_mirror(piece: _Piece, picture: int, name: str) -> _Found:
    """By the middle of the highlight; what is in all pictures is no highlight."""
    from scipy.ndimage import center_of_mass, label

    planes, inside = piece.brightness(), piece.inside
    plane = planes[picture]
    if len(planes) > 1:
        alone = plane - planes.min(axis=0)
        # A lamp that stands in one place in all pictures is in what they share.
        if alone[inside].max() > 0.05 * plane[inside].max():
            plane = alone
    plane = np.where(inside, plane, 0.0)
    peak = float(plane.max())
    if peak <= 0 or peak < HIGHLIGHT_RATIO_MIN * float(np.median(plane[inside])):
        raise InputError(f"ball: expected a highlight in every picture, found none in {name}")
    parts, count = label(plane >= HIGHLIGHT_LEVELS[0] * peak)
    sums = np.bincount(parts.ravel(), plane.ravel(), count + 1)
    spot = np.where(parts == 1 + int(sums[1:].argmax()), plane, 0.0)
    places = []
    for level in HIGHLIGHT_LEVELS:
        row, column = center_of_mass(np.where(spot >= level * spot.max(), spot, 0.0))
        places.append((float(column) + piece.left, float(row) + piece.top))
    direction, other = (_reflected(piece, *place) for place in places)
    x, y = places[0]
    half = ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))
    beside = [_reflected(piece, x + dx, y + dy) for dx, dy in half]
    half_pixel = max(float(geometry.angles_between(direction, one)) for one in beside)
    degrees = float(np.hypot(half_pixel, geometry.angles_between(direction, other)))
    return _Found(direction, np.full(3, np.nan), degrees, float("nan"), places[0])


def _reflected(piece: _Piece, x: float, y: float) -> Array:
    """Direction that a place of a mirror ball shows; beyond its rim that of the rim there."""
    ball = piece.ball
    right, down = x - ball.x, y - ball.y
    share = min(1.0, 0.999 * ball.radius / max(math.hypot(right, down), 1e-9))
    normal, view = sphere_normals(
        ball, piece.size, piece.fov, ball.x + share * right, ball.y + share * down
    )
    direction = 2 * (normal @ view) * normal - view
    return np.asarray(direction / np.linalg.norm(direction))


def _on_matt(piece: _Piece, picture: int, name: str) -> _Found:
    """By least squares over the pixels that the lamp reaches."""
    with np.errstate(invalid="ignore"):
        usable = piece.free[picture] & (piece.cosine >= RIM_COSINE_MIN)
    normals, samples = piece.normals[usable], piece.images[picture][usable].astype(np.float64)
    bright = samples.mean(axis=-1)
    highest = np.quantile(bright, 0.99) if bright.size else 0.0
    reached = (bright > 0.1 * highest) & (highest > 0)
    for _ in range(ROUNDS_MAX):
        if np.count_nonzero(reached) < 8:
            raise InputError(
                f"ball: expected a side that a lamp reaches in every picture, found none in {name}"
            )
        slopes = np.linalg.lstsq(normals[reached], samples[reached], rcond=None)[0]
        direction = slopes.sum(axis=1)
        direction /= np.linalg.norm(direction)
        before, reached = reached, normals @ direction > REACHED_COSINE_MIN
        if (reached == before).all():
            break
    colors = np.maximum(direction @ slopes, 0.0)
    off = samples[reached] - normals[reached] @ slopes
    residual = float(np.sqrt(np.mean(off**2)) / max(float(colors.max()), 1e-30))
    cosine = normals @ direction
    middle = np.median(cosine[reached])
    sloped = np.array(
        [
            np.linalg.lstsq(normals[half], samples[half], rcond=None)[0].sum(axis=1)
            for half in (reached & (cosine >= middle), reached & (cosine < middle))
        ]
    )
    sloped /= np.maximum(np.linalg.norm(sloped, axis=1, keepdims=True), 1e-30)
    of_halves = float(geometry.angles_between(*sloped)) / 2
    degrees = float(np.hypot(of_halves, np.degrees(0.5 / piece.ball.radius)))
    return _Found(direction, colors, degrees, residual, _facing(piece, direction))


def _facing(piece: _Piece, direction: Array) -> tuple[float, float]:
    """Where the ball faces a direction; NaN where that is not seen."""
    alike = np.where(piece.inside, piece.normals @ direction, -1.0)
    row, column = divmod(int(alike.argmax()), alike.shape[1])
    if alike[row, column] < np.cos(np.radians(5)):
        return float("nan"), float("nan")
    return float(column + piece.left), float(row + piece.top)
