"""A scene's surroundings, and what they do to the light of its pixels.

`Scenery` is geometry, made from depth; `Transport` is what a fit decided about it, and what a result
keeps; `PixelTransfer` are the tables that the core takes (docs/transport.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit.io.json_files import number, table
from pbrfit.model.geometry import positions, view_directions
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model
from pbrfit.transport.extents import scale_of
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

Kind = Literal["none", "occlusion", "bounce"]
"""Whether surroundings do nothing, block light, or also bring the light that they reflect."""

RAYS = 2048
"""Rays of a pixel, about. Tables are then within 1 % of those of ten times as many."""

BOUNCES = 3
"""How often light is reflected between surfaces that a picture shows under a new light. Each time
less than half of it is left in a room of ordinary paint."""


@dataclass(frozen=True)
class Transport:
    """What a fit decided about surroundings, and why."""

    kind: Kind = "none"
    why: str = "no depth is given"
    extents: Extents | None = None
    gain: float = 1.0
    """What light from surfaces is multiplied by, beside what pictures show of them."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Mean of ln(residual²/radiance²) of pixels that lights were not fitted to: `left_out_none`,
    `left_out_occlusion`, `left_out_bounce`, as far as they were tried, and `left_out_pixels`."""

    @property
    def blocks(self) -> bool:
        """Whether surroundings do anything."""
        return self.kind != "none"

    def as_json(self) -> dict[str, Any]:
        """What `result.json` holds under `transport`."""
        return {
            "kind": self.kind,
            "why": self.why,
            "extents": None if self.extents is None else asdict(self.extents),
            "gain": self.gain,
            "figures": dict(self.figures),
        }

    @classmethod
    def from_json(cls, content: Any) -> Transport:
        """Undo `as_json`; ValueError if it is something else. None, of older results, is none."""
        if content is None:
            return cls(why="the fit knew no surroundings")
        values = table(content)
        kind = values.get("kind")
        if kind not in get_args(Kind):
            raise ValueError(f"transport kind {kind!r}")
        extents = None
        if values.get("extents") is not None:
            of_extents = table(values["extents"])
            of_extents["blocks"] = tuple(map(bool, of_extents["blocks"]))
            extents = Extents(**of_extents)
        return cls(
            kind,
            str(values["why"]),
            extents,
            number(values["gain"]),
            {name: number(value) for name, value in table(values["figures"]).items()},
        )


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
        self.points = positions(depth, fov)
        self.walls: tuple[Wall, ...] = find_walls(self.points, self.normals, mask, segments)
        self._build(default_extents(self.points, self.walls) if extents is None else extents)

    def _build(self, extents: Extents) -> None:
        self.extents = extents
        self.geometry: Surroundings = surroundings(
            self.points, self.normals, self.mask, self.segments, extents, self.walls
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
            on = (np.abs(wall.above(triangles)) < near).all(axis=-1) & of_walls
            if wall.pixels.any():
                found[on] = i
        return found

    @property
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
        places = np.flatnonzero(self.mask)
        n = np.asarray(normals, np.float64).reshape(-1, 3)[places]
        tables = self.transfer(places, model, threads=threads, normals=n)
        arguments = (
            n,
            views(self.mask.shape, self.fov, places),
            *(
                np.ascontiguousarray(of_map.reshape(len(self.mask.ravel()), -1)[places], np.float64)
                for of_map in (materials.albedo, materials.roughness, materials.metallic)
            ),
        )
        arguments = (*arguments[:3], arguments[3][:, 0], arguments[4][:, 0])
        count = len(lights)
        rendered = _core.render(*arguments, lights, threads, model, tables.rows)
        for _ in range(BOUNCES if transport.kind == "bounce" else 0):
            shown = np.zeros((*self.mask.shape, count * 3), np.float32)
            shown[self.mask] = rendered.transpose(1, 0, 2).reshape(len(places), -1)
            images = filled(shown, self.mask).reshape(*self.mask.shape, count, 3)
            tables = self.transfer(places, model, threads=threads, images=images, normals=n)
            bounced = replace(tables, gain=transport.gain).scaled(np.ones(count))
            rendered = _core.render(*arguments, lights, threads, model, tables.rows, bounced)
        pictures = np.full((count, *self.mask.shape, 3), np.nan)
        pictures[:, self.mask] = rendered
        return pictures.reshape(*given.shape[:-2], *self.mask.shape, 3)


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
    return found[rows, columns]
