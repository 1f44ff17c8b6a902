"""Windows of a scene: the subset that finds the lights, tiles, and scenes cut from a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.lazy import lazy
from pbrfit.model import geometry
from pbrfit.model.materials import Materials
from pbrfit.scene.arrays import Truth, equal_channels
from pbrfit.scene.scene import Scene


@dataclass(frozen=True)
class Window:
    """Rows and columns of a picture, from where to where and in which steps."""

    rows: slice
    columns: slice

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """A view of (H, W, ...)."""
        return values[self.rows, self.columns]

    def place(self, column: float, row: float, value: float) -> tuple[float, float, float]:
        """A place in the picture, with a value there, as one in the window."""
        columns, rows = self.columns, self.rows
        return (column - columns.start) / columns.step, (row - rows.start) / rows.step, value


@dataclass(frozen=True)
class Tile:
    """A tile: the pixels that are fitted, and those of them that are kept."""

    outer: Window
    """Pixels that are fitted, in the whole picture."""
    inner: Window
    inside: Window
    """Pixels that are kept, in the whole picture and in the outer window."""


def strided_window(valid: NDArray[np.bool_], at_least: int, at_most: int) -> Window:
    """Every s-th row and column, with so many of the valid pixels (H, W).

    `at_most` is exceeded by up to `STRIDED_SUBSET_EXCESS`.
    """
    wanted = max(1, math.ceil(math.sqrt(np.count_nonzero(valid) / at_most)))
    # A mask may have stripes that a window hits or misses altogether: then the nearest step that
    # does neither.
    for step in sorted(range(1, 2 * wanted), key=lambda step: (abs(step - wanted), step)):
        window = Window(*(slice(step // 2, None, step) for _ in range(2)))
        count = np.count_nonzero(window.of(valid))
        if step == 1 or at_least <= count <= settings.STRIDED_SUBSET_EXCESS * at_most:
            break
    return window


def tiles(valid: NDArray[np.bool_], margin: int, side: int) -> Iterator[Tile]:
    """Tiles of at most `side` rows and columns that have valid pixels, row by row."""
    height, width = valid.shape
    rows, columns = (_cuts(length, side) for length in (height, width))
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            inner = Window(slice(top, bottom), slice(left, right))
            if not inner.of(valid).any():
                continue
            first_row, first_column = max(0, top - margin), max(0, left - margin)
            outer = Window(
                slice(first_row, min(height, bottom + margin)),
                slice(first_column, min(width, right + margin)),
            )
            inside = Window(
                slice(top - first_row, bottom - first_row),
                slice(left - first_column, right - first_column),
            )
            yield Tile(outer, inner, inside)


def _cuts(length: int, side: int) -> list[int]:
    """Borders of equal pieces that are no longer than `side`."""
    count = -(-length // side)
    return [length * i // count for i in range(count + 1)]


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
    def views(self) -> NDArray[np.float64]:
        """(h, w, 3) unit vectors from the surface to the camera."""
        whole, window = self.whole, self.window
        return geometry.view_directions(
            whole.height, whole.width, self.fov, window.rows, window.columns
        )

    def noise_floor(self, picture: int) -> NDArray[np.float32] | None:
        """(h, w, 3): standard deviation of what its file did to the samples of a picture."""
        noise = None if self.file_noise is None else self.file_noise[picture]
        if noise is None:
            return None
        return noise.deviation(self.images[picture], self.window.rows, self.window.columns)

    @lazy
    def radius_squared(self) -> NDArray[np.float64]:
        """(h, w): squared distance of pixels from the middle of the whole, 1 in its corners."""
        return self.window.of(self.whole.radius_squared)

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


class SceneCutter:
    """Cuts windows out of a scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._labels: NDArray[np.int32] | None = None
        if scene.labels is not None:
            self._labels = np.zeros(scene.valid.shape, np.int32)
            self._labels[scene.valid] = scene.labels[0]

    def cut(self, window: Window, lighting: NDArray[np.float64] | None = None) -> PartialScene:
        """A window of the scene, with these lights known, or as the whole has them."""

        def of(maps: NDArray[Any] | None) -> Any:
            return None if maps is None else window.of(maps)

        scene = self.scene
        weights, limits = scene.weights, scene.limits
        return PartialScene(
            images=scene.images[:, window.rows, window.columns],
            normals=window.of(scene.normals),
            depth=of(scene.depth),
            fov=scene.fov,
            fov_known=scene.fov_known,
            correction=scene.correction,
            mask=of(scene.mask),
            segments=of(self._labels),
            lighting=scene.lighting if lighting is None else lighting,
            weights=None if weights is None else weights[:, window.rows, window.columns],
            limits=None if limits is None else limits[:, window.rows, window.columns],
            file_noise=scene.file_noise,
            normal_sigma=of(scene.normal_sigma),
            names=scene.names,
            lamps=scene.lamps,
            normals_known=scene.normals_known,
            truth=None if scene.truth is None else Truth(cut_maps(scene.truth.materials, window)),
            model=scene.model,
            response=scene.response,
            whole=scene,
            window=window,
        )


def cut_maps(materials: Materials, window: Window) -> Materials:
    """Some rows and columns of maps."""
    return Materials(
        window.of(materials.albedo), window.of(materials.roughness), window.of(materials.metallic)
    )
