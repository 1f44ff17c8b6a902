"""The maps of a whole picture, which fill tile by tile."""

from __future__ import annotations

import numpy as np

from pbrfit.fit import uncertainty
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.tiles.tiling import Tile
from pbrfit.model.materials import Materials
from pbrfit.scene.scene import Scene


class Canvas:
    """Maps of a picture, NaN until their tile is done.

    Attributes
    ----------
    materials, normals
        (H, W, ...).
    variances
        Of the valid pixels; None where nobody asked.
    """

    def __init__(self, scene: Scene, layout: ParameterLayout, *, uncertain: bool) -> None:
        shape = scene.valid.shape
        self.materials = Materials(
            np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
        )
        self.normals = np.array(scene.normals, dtype=np.float64)
        self.variances: uncertainty.Variances | None = None
        self._valid = scene.valid
        if uncertain:
            unknowns = layout.maps.stop // layout.pixels
            self.variances = uncertainty.Variances.empty(layout.pixels, unknowns)
            self._number = np.zeros(shape, np.int32)
            self._number[scene.valid] = np.arange(layout.pixels)

    def put(self, tile: Tile, part: Scene, materials: Materials) -> None:
        """Keep what a tile found inside: materials (h, w, ...), and the normals of its scene."""
        for kept, found in (
            (self.materials.albedo, materials.albedo),
            (self.materials.roughness, materials.roughness),
            (self.materials.metallic, materials.metallic),
            (self.normals, part.normals),
        ):
            tile.inner.of(kept)[...] = tile.inside.of(found)

    def put_variances(self, tile: Tile, part: Scene, found: uncertainty.Variances) -> None:
        """The same of variances."""
        assert self.variances is not None
        inside = np.zeros(part.valid.shape, bool)
        tile.inside.of(inside)[...] = True
        numbers = tile.inner.of(self._number)[tile.inner.of(self._valid)]
        self.variances.put(numbers.astype(np.intp), found, inside[part.valid])
