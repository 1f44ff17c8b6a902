"""Windows of a scene: the subset that finds the lights, tiles, and scenes cut from a scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.sampling import stride
from pbrfit.fit.settings import COMPARE_SIDE
from pbrfit.io.color import Conversion
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.lazy import lazy
from pbrfit.model import geometry
from pbrfit.scene.arrays import SceneArrays, Truth, equal_channels
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array, Codes, Mask


@dataclass(frozen=True)
class Window:
    """Rows and columns of a picture, from where to where and in which steps."""

    rows: slice
    columns: slice

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """A view of (H, W, ...)."""
        return values[self.rows, self.columns]


@dataclass(frozen=True)
class Tile:
    """Windows of the whole picture: the pixels that are fitted, and those of them that are kept."""

    outer: Window
    inner: Window

    @property
    def inside(self) -> Window:
        """The pixels that are kept, in the outer window."""
        (top, left), inner = (self.outer.rows.start, self.outer.columns.start), self.inner
        return Window(
            slice(inner.rows.start - top, inner.rows.stop - top),
            slice(inner.columns.start - left, inner.columns.stop - left),
        )


def strided_window(valid: Mask, at_most: int) -> Window:
    """Every s-th row and column, with about so many of the valid pixels (H, W); see `stride`."""
    step, row, column = stride(valid, at_most)
    return Window(slice(row, None, step), slice(column, None, step))


def tiles(valid: Mask, margin: int, side: int) -> Iterator[Tile]:
    """Tiles of at most `side` rows and columns that have valid pixels, row by row."""
    height, width = valid.shape
    for rows, outer_rows in _pieces(height, margin, side):
        for columns, outer_columns in _pieces(width, margin, side):
            inner = Window(rows, columns)
            if inner.of(valid).any():
                yield Tile(Window(outer_rows, outer_columns), inner)


def _pieces(length: int, margin: int, side: int) -> list[tuple[slice, slice]]:
    """Equal pieces of a range that are no longer than `side`, and the same with a margin."""
    count = -(-length // side)
    return [
        (slice(first, end), slice(max(0, first - margin), min(length, end + margin)))
        for first, end in pairwise(length * i // count for i in range(count + 1))
    ]


@dataclass(frozen=True, eq=False)
class PartialScene(Scene):
    """Some rows and columns of a scene.

    It was checked with the whole, and shares its arrays. What is decided by all pixels (whether the
    pictures are grey, whether samples have different weights, which label a segment has) is as in
    the whole; so is the direction that each pixel is seen from.
    """

    whole: Scene = field(kw_only=True)
    window: Window = field(kw_only=True)

    def __post_init__(self) -> None:
        pass

    @property
    def views(self) -> Array:
        """(h, w, 3) unit vectors from the surface to the camera."""
        size, window = (self.whole.height, self.whole.width), self.window
        return geometry.view_directions(*size, self.fov, window.rows, window.columns)

    @lazy
    def grey(self) -> bool:
        """Whether the pictures, and the lights if they are known, have three equal channels."""
        return self.whole.grey and (self.lighting is None or equal_channels(self.lighting))

    @lazy
    def weighted(self) -> bool:
        """Whether samples of valid pixels have different weights."""
        return self.whole.weighted

    @lazy
    def labels(self) -> tuple[NDArray[np.intp], int] | None:
        """Labels of the valid pixels' segments, and how many the whole has."""
        of_whole = self.whole.labels
        if of_whole is None or self.segments is None:
            return None
        return self.segments[self.valid].astype(np.intp), of_whole[1]


def cut(scene: Scene, window: Window) -> PartialScene:
    """A window of a scene."""
    parts: dict[str, Any] = {one.name: getattr(scene, one.name) for one in fields(SceneArrays)}
    parts["segments"] = scene.label_map
    for name in ("normals", "depth", "mask", "segments", "normal_sigma"):
        parts[name] = None if parts[name] is None else window.of(parts[name])
    for name in ("images", "weights", "limits"):
        if parts[name] is not None:
            parts[name] = parts[name][:, window.rows, window.columns]
    if scene.truth is not None:
        parts["truth"] = Truth(scene.truth.materials.each(window.of))
    if scene.estimates is not None:
        parts["estimates"] = scene.estimates.each(window.of)
    return PartialScene(**parts, whole=scene, window=window)


def without_shape(scene: Scene) -> Scene:
    """Pictures averaged down to a longer side of `COMPARE_SIDE`, of a scene without normals."""
    size = reduced_size(scene.valid.shape, COMPARE_SIDE)
    if size == scene.valid.shape:
        return scene
    images = np.stack([averaged_channels(image, size) for image in scene.images])
    mask = averaged(scene.valid, size) > 1 - 1e-4
    if not mask.any():
        return scene
    limits: Codes = np.zeros(images.shape, np.uint8)
    if scene.limits is not None:
        limits = np.stack([Conversion("linear").of_limits(of, size) for of in scene.limits])
    weights = None
    if scene.weights is not None:
        weights = np.stack([averaged_channels(of, size) for of in scene.weights])
    return replace(
        scene,
        images=images,
        mask=mask,
        limits=limits,
        weights=weights,
        normals=None,  # type: ignore[arg-type]  # unknown, as before
        depth=None,
        segments=None,
        estimates=None,
        file_noise=None,
        normal_sigma=None,
        truth=None,
        fov=scene.fov if scene.fov_known else None,  # type: ignore[arg-type]  # unknown
    )
