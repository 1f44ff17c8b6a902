"""A scene's surroundings, and what they do to the light of its pixels.

`Scenery` is geometry, made from depth; `Transport` is what a fit decided about it, and what a
result keeps; `PixelTransfer` are the tables that the core takes (docs/transport.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit.lazy import lazy
from pbrfit.model.geometry import positions, view_directions
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.transport.decision import Transport
from pbrfit.transport.extents import scale_of
from pbrfit.transport.room import room_axes
from pbrfit.transport.surroundings import (
    WALL,
    Extents,
    Surroundings,
    Wall,
    default_extents,
    find_walls,
    surroundings,
)

Array = NDArray[np.float64]

RAYS = 2048
"""Rays of a pixel, about. Tables are then within 1 % of those of ten times as many."""

BOUNCES = 3
"""How often light is reflected between surfaces that a picture shows under a new light. Each time
less than half of it is left in a room of ordinary paint."""

BOUNCE_RAYS = 512
"""Rays of a pixel that tell what surfaces bring it: within 2 % of those of many more."""

NAMED = 0.8
"""Cosine between a wall's normal and an axis of the room from which it is called by that axis."""

PIECE = 1 << 16
"""Pixels whose tables are held at once while pictures are rendered: 50 to 200 MB."""


@dataclass(frozen=True, eq=False)
class PixelTransfer:
    """What surroundings do to the light of P pixels."""

    rows: NDArray[np.float32]
    """(P, R, 16): rows in the place of the model's."""
    bounced: NDArray[np.float32] | None = None
    """(P, R, N, C): what they bring of each picture, in picture units; None = nothing."""
    gain: float = 1.0
    """What that is multiplied by."""

    def of(self, pixels: NDArray[np.uint64]) -> PixelTransfer:
        """Of some pixels."""
        bounced = None if self.bounced is None else self.bounced[pixels]
        return replace(self, rows=self.rows[pixels], bounced=bounced)

    def of_pictures(self, pictures: Sequence[int]) -> PixelTransfer:
        """Of some pictures."""
        if self.bounced is None:
            return self
        return replace(self, bounced=self.bounced[:, :, list(pictures)])

    def scaled(self, units: Array) -> NDArray[np.float32] | None:
        """(P, R, N·C): what is brought, in units of which a picture has so many; with the gain."""
        if self.bounced is None:
            return None
        by_picture = (self.gain / units).astype(np.float32)[:, None]
        pixels, rows = self.rows.shape[:2]
        return (self.bounced * by_picture).reshape(pixels, rows, -1)


class Scenery:
    """Surroundings of a picture's pixels.

    Parameters
    ----------
    depth, normals, mask, segments, fov
        As of a `Scene`.
    extents
        What no picture shows; None = by default.
    """

    def __init__(
        self,
        depth: NDArray[Any],
        normals: NDArray[Any],
        mask: NDArray[np.bool_],
        segments: NDArray[np.integer] | None,
        fov: float,
        extents: Extents | None = None,
    ) -> None:
        self.fov, self.mask, self.segments = fov, mask, segments
        self.normals = np.asarray(normals, np.float64)
        # As a result keeps them, so that what is built from it is the same to the last bit.
        self._rounded = np.asarray(np.asarray(normals, np.float32), np.float64)
        self.points = positions(depth, fov)
        self.walls: tuple[Wall, ...] = find_walls(self.points, self._rounded, mask, segments)
        self._build(default_extents(self.points, self.walls) if extents is None else extents)

    def _build(self, extents: Extents) -> None:
        self.extents = extents
        self.geometry: Surroundings = surroundings(
            self.points, self._rounded, self.mask, self.segments, extents, self.walls
        )
        triangles = self.geometry.triangles
        self._core = _core.Surroundings(np.ascontiguousarray(triangles), self._surfaces(triangles))

    def _surfaces(self, triangles: NDArray[np.float32]) -> NDArray[np.uint8]:
        """(T,): from 1 on the number of the wall that a triangle is of; 0 where it is of none.

        What is seen of a wall stands for what is not, behind things and beyond the picture.
        """
        found = np.zeros(len(triangles), np.uint8)
        of_walls = self.geometry.kind == WALL
        near = 1e-4 * scale_of(self.points)
        for i, wall in enumerate(self.walls[:255], start=1):
            on = (np.abs(wall.above(triangles.astype(np.float64))) < near).all(axis=-1) & of_walls
            if wall.pixels.any():
                found[on] = i
        return found

    @lazy
    def _nearest(self) -> NDArray[np.uint32]:
        """For each surface and pixel, flat, the pixel that shows the surface nearest to it."""
        from scipy.ndimage import distance_transform_edt

        places = np.arange(self.mask.size, dtype=np.uint32).reshape(self.mask.shape)
        found = []
        for wall in self.walls[:255]:
            nearest = places
            if wall.pixels.any():
                nearest = places[
                    tuple(
                        distance_transform_edt(
                            ~wall.pixels, return_distances=False, return_indices=True
                        )
                    )
                ]
            found.append(nearest.ravel())
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
        rows, columns = np.divmod(places, shape[1])
        normals = self.normals[rows, columns] if normals is None else normals
        normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        starts = self.geometry.starts[rows, columns].astype(np.float64)
        known = np.isfinite(starts).all(axis=-1)
        given: dict[str, Any] = {}
        if images is not None:
            count = images.shape[2:]
            half_width = math.tan(math.radians(self.fov) / 2)
            nearest = self._nearest
            last = int(self._core.last_surface)
            given = {
                "radiance": images.reshape(*shape, -1),
                "half_width": half_width,
                "nearest": nearest[: last * self.mask.size],
            }
        # Far from all, and so unblocked, where nobody knows where a pixel is.
        starts[~known] = 1e6 * (1 + np.abs(starts[known]).max(initial=1.0))
        found, bounced = self._core.transfer(
            np.ascontiguousarray(starts),
            np.ascontiguousarray(normals),
            np.ascontiguousarray(views(shape, self.fov, places)),
            places.astype(np.uint64),
            rays=rays,
            model=model,
            threads=threads,
            **given,
        )
        if bounced is not None:
            bounced = bounced.reshape(*found.shape[:2], *count)
        return PixelTransfer(found, bounced)

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
        is what surfaces send to others, and so on, `BOUNCES` times.

        Parameters
        ----------
        materials, normals
            Maps (H, W, ...), NaN outside the mask.
        lighting
            (16, 3) or (N, 16, 3), linear Rec.709.
        transport
            Whether light is reflected between surfaces, and with which gain.

        Returns
        -------
        (H, W, 3) or (N, H, W, 3) float64, linear Rec.709; NaN outside the mask.
        """
        given = np.asarray(lighting, np.float64)
        lights = given.reshape(-1, *given.shape[-2:])
        shape, count = self.mask.shape, len(lights)
        pictures = np.full((count, *shape, 3), np.nan)
        flat = pictures.reshape(count, -1, 3)
        pieces = _pieces(np.flatnonzero(self.mask))
        of_pixels = [self._arguments(materials, normals, places) for places in pieces]
        rows = []
        for places, arguments in zip(pieces, of_pixels, strict=True):
            tables = self.transfer(places, model, threads=threads, normals=arguments[0])
            rendered = _core.render(*arguments, lights, threads, model, tables.rows)
            flat[:, places] = rendered
            # Of larger pictures they are not kept: rows are then from fewer rays.
            if transport.kind == "bounce" and len(pieces) == 1:
                rows.append(tables.rows)
        for _ in range(BOUNCES if transport.kind == "bounce" else 0):
            shown = pictures.transpose(1, 2, 0, 3).reshape(*shape, -1)
            images = filled(shown, self.mask).reshape(*shape, count, 3)
            for i, (places, arguments) in enumerate(zip(pieces, of_pixels, strict=True)):
                tables = self.transfer(
                    places,
                    model,
                    rays=BOUNCE_RAYS,
                    threads=threads,
                    images=images,
                    normals=arguments[0],
                )
                bounced = replace(tables, gain=transport.gain).scaled(np.ones(count))
                kept = rows[i] if rows else tables.rows
                flat[:, places] = _core.render(*arguments, lights, threads, model, kept, bounced)
        return pictures.reshape(*given.shape[:-2], *shape, 3)

    def open_to(
        self, direction: ArrayLike, places: NDArray[np.intp] | None = None
    ) -> NDArray[np.bool_]:
        """Whether light from far away, from one direction, meets nothing before a pixel.

        Parameters
        ----------
        direction
            (3,) unit vector in camera space from the surface to the light.
        places
            (P,) pixels, counted row by row; None = those of the mask.

        Returns
        -------
        (P,); True where nobody knows where a pixel is.
        """

        def towards(starts: Array) -> tuple[Array, Array]:
            directions = np.broadcast_to(np.asarray(direction, np.float64), starts.shape)
            return directions, np.full(len(starts), np.inf)

        return self._open(towards, places)

    def open_to_place(
        self, place: ArrayLike, places: NDArray[np.intp] | None = None
    ) -> NDArray[np.bool_]:
        """As `open_to`, of light from a place (3,) in camera space, in the unit of depth."""

        def towards(starts: Array) -> tuple[Array, Array]:
            away = np.asarray(place, np.float64) - starts
            lengths = np.maximum(np.linalg.norm(away, axis=-1), np.finfo(np.float64).tiny)
            return away / lengths[:, None], lengths

        return self._open(towards, places)

    def _open(
        self,
        towards: Callable[[Array], tuple[Array, Array]],
        places: NDArray[np.intp] | None,
    ) -> NDArray[np.bool_]:
        """Whether pixels' rays meet nothing; `towards` gives directions and lengths by starts."""
        places = np.flatnonzero(self.mask) if places is None else places
        starts = self.geometry.starts.reshape(-1, 3)[places].astype(np.float64)
        found = np.ones(len(places), bool)
        known = np.isfinite(starts).all(axis=-1)
        directions, lengths = towards(starts[known])
        met = self._core.distances(
            np.ascontiguousarray(starts[known]), np.ascontiguousarray(directions)
        )
        found[known] = np.isinf(met) | (met >= lengths)
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
        gain = f", {transport.gain:g} of what pictures show" if transport.gain != 1 else ""
        return f"{what}{gain} ({transport.why}): {', '.join(parts)}; in median depths"

    def _arguments(
        self, materials: Materials, normals: NDArray[Any], places: NDArray[np.intp]
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Normals, views, albedo, roughness and metallic of pixels, for the core."""
        albedo, roughness, metallic = (
            np.ascontiguousarray(of_map.reshape(self.mask.size, -1)[places], np.float64)
            for of_map in (materials.albedo, materials.roughness, materials.metallic)
        )
        n = np.asarray(normals, np.float64).reshape(-1, 3)[places]
        n = n / np.linalg.norm(n, axis=-1, keepdims=True)
        views_of = np.ascontiguousarray(views(self.mask.shape, self.fov, places))
        return np.ascontiguousarray(n), views_of, albedo, roughness[:, 0], metallic[:, 0]


def name_of(wall: Wall, walls: tuple[Wall, ...]) -> str:
    """What a wall is called by where it is in the room."""
    if wall.level:
        return "floor" if wall.level == 1 else "ceiling"
    right, up, ahead = room_axes(walls)
    along = {
        "left wall": right,
        "right wall": -right,
        "wall ahead": -ahead,
        "wall behind": ahead,
        "level surface": up,
    }
    name, closeness = max(
        ((name, float(wall.normal @ axis)) for name, axis in along.items()), key=lambda one: one[1]
    )
    return name if closeness > NAMED else "slanted wall"


def counted(names: Sequence[str]) -> str:
    """Names, each once with how many there are of it: "floor, 2 left walls"."""
    parts = []
    for name in dict.fromkeys(names):
        count = names.count(name)
        several = f"{count} {name.replace('wall', 'walls').replace('surface', 'surfaces')}"
        parts.append(several if count > 1 else name)
    return ", ".join(parts)


def _pieces(places: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Places in pieces of PIECE."""
    return [places[i : i + PIECE] for i in range(0, len(places), PIECE)]


def views(shape: tuple[int, ...], fov: float, places: NDArray[np.intp]) -> Array:
    """(P, 3) unit vectors to the camera from pixels, whose places are counted row by row."""
    return view_directions(shape[0], shape[1], fov).reshape(-1, 3)[places]


def filled(image: NDArray[Any], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W, C) in float32; where the mask has nothing, what the nearest pixel in it has."""
    from scipy.ndimage import distance_transform_edt

    found: NDArray[np.float32] = np.asarray(image, np.float32)
    if mask.all():
        return found
    rows, columns = distance_transform_edt(~mask, return_distances=False, return_indices=True)
    nearest: NDArray[np.float32] = found[rows, columns]
    return nearest
