"""A scene's surroundings, and what they do to the light of its pixels.

`Scenery` is geometry, made from depth; `PixelTransfer` are the tables that the core takes. What a
fit decides about both is a `Transport` (docs/fit.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.lazy import lazy
from pbrfit.model.geometry import positions, unit, view_directions
from pbrfit.model.materials import Materials, nearest_inside
from pbrfit.model.reflection import Model
from pbrfit.transport.decision import Extents, Transport
from pbrfit.transport.relief import Relief, rays, relief
from pbrfit.transport.room import counted, default_extents, name_of, rectangles
from pbrfit.transport.sheet import sheets, triangles, widths
from pbrfit.transport.walls import Wall, find_walls
from pbrfit.values.arrays import Array, Mask

RAYS = 2048
"""Rays of a pixel, about. Tables are then within 1 % of those of ten times as many."""

BOUNCES = 5
"""How often light is reflected between surfaces that a picture shows under a new light. Each time
less than half of it is left in a room of ordinary paint: after five 1 % of a picture is missing."""

BOUNCE_RAYS = 512
"""Rays of a pixel that tell what surfaces bring it: within 2 % of those of many more."""

PIECE = 1 << 16
"""Pixels whose tables are held at once while pictures are rendered: 50 to 200 MB."""

FRONT, BACK, SIDE, WALL = range(4)
"""Kinds of triangle: seen; unseen behind that; between both; wall, floor, ceiling, behind."""

MOST_POINTS = 66_000
"""Points of the front, at most, unless said otherwise: all pixels of a picture of 256 x 256."""

LIFT = 0.02
"""How far above the surface rays start, in the distance to the next point: beyond rounding."""


@dataclass(frozen=True, eq=False)
class PixelTransfer:
    """What surroundings do to the light of P pixels."""

    rows: NDArray[np.float32]
    """(P, R, 16): rows in the place of the model's."""
    bounced: NDArray[np.float32] | None = None
    """(P, R, N, C): what they bring of each picture, in picture units; None = nothing."""

    def of(self, pixels: NDArray[np.uint64]) -> PixelTransfer:
        """Of some pixels."""
        bounced = None if self.bounced is None else self.bounced[pixels]
        return PixelTransfer(self.rows[pixels], bounced)

    def of_pictures(self, pictures: Sequence[int]) -> PixelTransfer:
        """Of some pictures."""
        if self.bounced is None:
            return self
        return replace(self, bounced=self.bounced[:, :, list(pictures)])

    def scaled(self, units: Array) -> NDArray[np.float32] | None:
        """(P, R, N·C): what is brought, in units of which a picture has so many."""
        if self.bounced is None:
            return None
        by_picture = (1 / units).astype(np.float32)[:, None]
        return (self.bounced * by_picture).reshape(*self.rows.shape[:2], -1)


class Scenery:
    """What light meets: triangles of a scene, and where rays of its pixels start.

    Things are what is seen of them, pushed back along the view by their own width, and closed at
    their sides. Walls, floor and ceiling are rectangles. A ray that meets none of these leaves the
    scene.

    All but the last two arguments are as of a `Scene`; points outside the mask block light, too.
    `extents` are what no picture shows; None = by default. At most `most` points are of the front:
    of larger pictures every second, third, ... pixel. Raises InputError if no depth is known, or
    `extents` were made for another number of walls.

    Attributes
    ----------
    points
        (H, W, 3) what the pixels show: camera space, NaN where nothing is known to be.
    unit
        Their median depth: the unit of extents.
    walls, extents
        What was found of walls, those that do not block light too, and what is assumed.
    triangles
        (T, 3, 3) float32, camera space, in the unit of depth.
    kind
        (T,) uint8: FRONT, BACK, SIDE or WALL. Each two of WALL are a rectangle: the first three of
        its corners, in a circle, and the first, third and fourth.
    starts
        (H, W, 3) float32: where rays of each pixel start: its point, without the noise of its
        depth, lifted above its own surface; NaN where there is none.
    """

    def __init__(
        self,
        depth: NDArray[Any],
        normals: NDArray[Any],
        mask: Mask,
        segments: NDArray[np.integer] | None,
        fov: float,
        extents: Extents | None = None,
        most: int = MOST_POINTS,
    ) -> None:
        self.fov, self.mask, self.segments = fov, mask, segments
        self.normals = np.asarray(normals, np.float64)
        self.points = positions(depth, fov)
        # As a result keeps them, so that what is built from it is the same to the last bit.
        rounded = np.asarray(np.asarray(normals, np.float32), np.float64)
        self._relief = relief(self.points, rounded, mask, fov, most)
        self.unit = float(np.nanmedian(-self.points[..., 2]))
        self.walls: tuple[Wall, ...] = find_walls(self._relief, self.points, rounded, mask)
        self.starts = _starts(self.points, self._relief, self.walls)
        self._build(default_extents(self.unit, self.walls) if extents is None else extents)

    def _build(self, extents: Extents) -> None:
        if len(extents.blocks) != len(self.walls):
            raise InputError(
                f"extents: expected one entry of blocks for each of {len(self.walls)} walls that "
                f"the depth shows, found {len(extents.blocks)}; where another version made the "
                "result, fit the scene again"
            )
        self.extents, found = extents, self._relief
        things = found.here.copy()
        for wall in self.walls:
            things &= ~wall.pixels[np.ix_(found.rows, found.columns)]
        thickness = widths(found, things, self.segments, extents.thickness * self.unit)
        for wall in self.walls:  # nothing reaches through a wall
            towards = -(found.directions @ wall.normal)
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(towards > 0, wall.above(found.points) / towards, np.inf)
            thickness = np.where(things, np.clip(thickness, 0.0, np.maximum(room, 0.0)), 0.0)
        seen = self.points[np.isfinite(self.points).all(axis=-1)]
        of_room = list(rectangles(seen, self.walls, extents, self.unit))
        corners = np.array([one for one, _ in of_room]).reshape(-1, 4, 3)
        parts = *sheets(found, things, thickness), triangles(corners)
        self.kind = np.repeat(np.arange(4, dtype=np.uint8), [len(part) for part in parts])
        self.triangles = np.ascontiguousarray(np.concatenate(parts), np.float32)
        # Of which wall a triangle is, from 1 on: what is seen of a wall stands for what is not.
        surfaces = np.zeros(len(self.kind), np.uint8)
        surfaces[self.kind == WALL] = np.repeat([number for _, number in of_room], 2)
        self._core = _core.Surroundings(self.triangles, surfaces)

    @lazy
    def _nearest(self) -> NDArray[np.uint32]:
        """For each wall and pixel, flat, the pixel that shows the wall nearest to it."""
        places = np.arange(self.mask.size, dtype=np.uint32).reshape(self.mask.shape)
        found = [places[nearest_inside(wall.pixels)].ravel() for wall in self.walls]
        return np.concatenate(found) if found else np.empty(0, np.uint32)

    def with_extents(self, extents: Extents) -> Scenery:
        """The same with other extents."""
        found = object.__new__(Scenery)
        found.__dict__.update(self.__dict__)
        found._build(extents)
        return found

    def transfer(
        self,
        places: NDArray[np.intp],
        model: Model,
        *,
        rays: int = RAYS,
        threads: int = 0,
        images: NDArray[np.float32] | None = None,
        normals: Array | None = None,
    ) -> PixelTransfer:
        """Tables of pixels, whose places are counted row by row; without depth nothing is blocked.

        `images` (H, W, N, C) in picture units tell what blocked rays bring; None = nothing.
        """
        shape = self.mask.shape
        normals = self.normals.reshape(-1, 3)[places] if normals is None else normals
        starts = self.starts.reshape(-1, 3)[places].astype(np.float64)
        # Far from all, and so unblocked, where nobody knows where a pixel is.
        far = 1e6 * (1 + np.nanmax(np.abs(starts), initial=1.0))
        given: dict[str, Any] = {}
        if images is not None:
            given = {
                "radiance": images.reshape(*shape, -1),
                "half_width": math.tan(math.radians(self.fov) / 2),
                "nearest": self._nearest[: self._core.last_surface * self.mask.size],
            }
        rows, bounced = self._core.transfer(
            np.where(np.isnan(starts), far, starts),
            unit(normals),
            views(shape, self.fov, places),
            places.astype(np.uint64),
            rays=rays,
            model=model,
            threads=threads,
            **given,
        )
        if images is not None and bounced is not None:
            bounced = bounced.reshape(*rows.shape[:2], *images.shape[2:])
        return PixelTransfer(rows, bounced)

    def render(
        self,
        materials: Materials,
        normals: NDArray[Any],
        lighting: ArrayLike,
        transport: Transport,
        *,
        model: Model,
        threads: int = 0,
    ) -> Array:
        """Pictures of materials among these surroundings under SH light.

        Light that surfaces reflect goes on from picture to picture: what a picture without it shows
        is what surfaces send to others, and so on, `BOUNCES` times, where `transport` says so.

        Maps are (H, W, ...), NaN outside the mask, and lighting (16, 3) or (N, 16, 3), linear
        Rec.709. Returns (H, W, 3) or (N, H, W, 3) float64, likewise.
        """
        given = np.asarray(lighting, np.float64)
        lights = given.reshape(-1, *given.shape[-2:])
        shape, count, places = self.mask.shape, len(lights), np.flatnonzero(self.mask)

        def shown(light: Array, rays: int, images: NDArray[np.float32] | None = None) -> Array:
            """(N, H, W, 3): under SH light, and what pictures (H, W, N, 3) show of surfaces."""
            pictures = np.full((count, self.mask.size, 3), np.nan)
            for start in range(0, len(places), PIECE):
                piece = places[start : start + PIECE]
                n, albedo, roughness, metallic = (
                    np.ascontiguousarray(one.reshape(self.mask.size, -1)[piece], np.float64)
                    for one in (normals, materials.albedo, materials.roughness, materials.metallic)
                )
                n = unit(n)
                tables = self.transfer(
                    piece, model, rays=rays, threads=threads, images=images, normals=n
                )
                bounced = tables.scaled(np.ones(count))
                of = n, views(shape, self.fov, piece), albedo, roughness[:, 0], metallic[:, 0]
                pictures[:, piece] = _core.render(*of, light, threads, model, tables.rows, bounced)
            return pictures.reshape(count, *shape, 3)

        direct = pictures = shown(lights, RAYS)
        for _ in range(BOUNCES if transport.kind == "bounce" else 0):
            sent = filled(pictures.transpose(1, 2, 0, 3), self.mask)
            pictures = direct + shown(np.zeros_like(lights), BOUNCE_RAYS, sent)
        return pictures.reshape(*given.shape[:-2], *shape, 3)

    def open_to(
        self, light: ArrayLike, places: NDArray[np.intp] | None = None, *, near: bool = False
    ) -> NDArray[np.bool_]:
        """(P,): whether light of a lamp meets nothing before a pixel, or nobody knows where it is.

        `light` (3,) in camera space is the unit vector from the surface to a lamp that is far away,
        or the place of a `near` one, in the unit of depth. `places` (P,) are pixels, counted row by
        row; None = those of the mask.
        """
        places = np.flatnonzero(self.mask) if places is None else places
        starts = self.starts.reshape(-1, 3)[places].astype(np.float64)
        found: Mask = np.asarray(np.isnan(starts).any(axis=-1))
        away = np.asarray(light, np.float64) - starts[~found] * float(near)
        length = np.maximum(np.linalg.norm(away, axis=-1), np.finfo(np.float64).tiny)
        met = self._core.distances(starts[~found], away / length[:, None])
        found[~found] = np.isinf(met) | (near & (met >= length))
        return found

    def in_words(self, transport: Transport) -> str:
        """What a fit supposes, for people; lengths in median depths."""
        extents, names = self.extents, [name_of(wall, self.walls) for wall in self.walls]
        parts = [f"things up to {extents.thickness:.2g} deep"]
        for verb, one_verb, blocks in (
            ("block light", "blocks light", True),
            ("let it through", "lets it through", False),
        ):
            these = [n for n, b in zip(names, extents.blocks, strict=True) if b == blocks]
            if these:
                verb = verb if len(these) > 1 else one_verb
                parts.append(f"{counted(these)} {verb}")
        if extents.height is not None:
            parts.append(f"walls {extents.height:.2g} high")
            if "ceiling" not in names:
                parts.append("a ceiling supposed" if extents.ceiling else "open above")
        if any(extents.blocks):
            parts.append(
                f"open behind the camera from {extents.reach:.2g} on"
                if extents.behind is None
                else f"a wall {extents.behind:.2g} behind the camera"
            )
        what = "block light" if transport.kind == "occlusion" else "block and reflect light"
        return f"{what} ({transport.why}): {', '.join(parts)}; in median depths"


def _starts(points: Array, found: Relief, walls: Sequence[Wall]) -> NDArray[np.float32]:
    """Where rays of pixels start: on the plane of the nearest point of the grid, and above it."""
    height, width = points.shape[:2]
    near = np.ix_(
        *(
            np.clip((np.arange(n) - of[0] + found.step // 2) // found.step, 0, len(of) - 1)
            for n, of in ((height, found.rows), (width, found.columns))
        )
    )
    normal, footprint = found.normals[near], found.footprint[near]
    tangent = found.tangents[near]
    origins, directions = rays((height, width), found.fov, np.arange(height), np.arange(width))
    own = np.einsum("hwi,hwi->hw", points - origins, directions)
    on = np.einsum("hwi,hwi->hw", tangent, found.points[near] - origins)
    on = on / np.einsum("hwi,hwi->hw", tangent, directions)
    noise = found.noise * own
    # Beyond a jump it is of something else.
    on = np.where(np.abs(on - own) < 3 * (footprint + noise), on, own)
    lift = np.nan_to_num(LIFT * footprint + noise)
    start = origins + on[..., None] * directions + lift[..., None] * np.nan_to_num(normal)
    # Nothing starts behind a wall; what shows the wall starts on it.
    least = LIFT * np.nan_to_num(footprint)
    for wall in walls:
        above = wall.above(start)
        moved = np.where(wall.pixels | (above < least), least - above, 0.0)
        start = start + moved[..., None] * wall.normal
    return np.asarray(start, np.float32)


def views(shape: tuple[int, ...], fov: float, places: NDArray[np.intp]) -> Array:
    """(P, 3) unit vectors to the camera from pixels, whose places are counted row by row."""
    return np.ascontiguousarray(view_directions(shape[0], shape[1], fov).reshape(-1, 3)[places])


def filled(image: NDArray[Any], mask: Mask) -> NDArray[np.float32]:
    """(H, W, ...) in float32; where the mask has nothing, what the nearest pixel in it has."""
    found: NDArray[np.float32] = np.asarray(image, np.float32)[nearest_inside(mask)]
    return found
