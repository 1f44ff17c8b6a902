"""A part of a scene that is a scene itself: some rows and columns, seen by the same camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True, eq=False)
class Part(Scene):
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
            whole.height, whole.width, whole.fov, window.rows, window.columns
        )

    @lazy
    def grey(self) -> bool:
        """Whether the pictures, and the lights if they are known, have three equal channels."""
        lit = self.lighting is None or equal_channels(self.lighting)
        return lit and self.whole.grey

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


class Parts:
    """Cuts a scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._labels: NDArray[np.int32] | None = None
        if scene.labels is not None:
            self._labels = np.zeros(scene.valid.shape, np.int32)
            self._labels[scene.valid] = scene.labels[0]

    def cut(self, window: Window, lighting: NDArray[np.float64] | None = None) -> Part:
        """A part, with these lights known, or as the whole has them."""
        scene = self.scene
        return Part(
            images=scene.images[:, window.rows, window.columns],
            normals=window.of(scene.normals),
            fov=scene.fov,
            mask=None if scene.mask is None else window.of(scene.mask),
            segments=None if self._labels is None else window.of(self._labels),
            lighting=scene.lighting if lighting is None else lighting,
            weights=(
                None if scene.weights is None else scene.weights[:, window.rows, window.columns]
            ),
            normal_sigma=None if scene.normal_sigma is None else window.of(scene.normal_sigma),
            names=scene.names,
            truth=None if scene.truth is None else Truth(cut(scene.truth.materials, window)),
            model=scene.model,
            whole=scene,
            window=window,
        )


def cut(materials: Materials, window: Window) -> Materials:
    """Some rows and columns of maps."""
    return Materials(
        window.of(materials.albedo), window.of(materials.roughness), window.of(materials.metallic)
    )
