"""Maps of a whole picture: those that fill tile by tile, and those that tiles start from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import uncertainty
from pbrfit.fit.parameters import ParameterLayout, pixel_index
from pbrfit.fit.tiles.windows import Tile, Window
from pbrfit.model.materials import Materials
from pbrfit.scene.scene import Scene


class TiledMaps:
    """Maps of a picture, NaN until their tile is done, with `spread` if somebody asked."""

    def __init__(self, scene: Scene, layout: ParameterLayout, *, uncertain: bool) -> None:
        shape = scene.valid.shape
        self.materials = Materials(
            np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
        )
        self.normals = np.array(scene.normals, dtype=np.float64)
        self.spread: uncertainty.Spread | None = None
        self._valid = scene.valid
        if uncertain:
            unknowns = layout.maps.stop // layout.pixels
            self.spread = uncertainty.Spread.empty(layout.pixels, unknowns, layout.channels)
            self._number = pixel_index(layout).astype(np.int32)

    def put(self, tile: Tile, part: Scene, materials: Materials) -> None:
        """Keep what a tile found inside: materials (h, w, ...), and the normals of its scene."""
        for name in ("albedo", "roughness", "metallic"):
            tile.inner.of(getattr(self.materials, name))[...] = tile.inside.of(
                getattr(materials, name)
            )
        tile.inner.of(self.normals)[...] = tile.inside.of(part.normals)

    def put_spread(self, tile: Tile, part: Scene, found: uncertainty.Spread) -> None:
        """The same of posteriors."""
        assert self.spread is not None
        inside = np.zeros(part.valid.shape, bool)
        tile.inside.of(inside)[...] = True
        numbers = tile.inner.of(self._number)[tile.inner.of(self._valid)]
        self.spread.put(numbers.astype(np.intp), found, inside[part.valid])


class NearestMaps:
    """Materials and normals of a strided subset, looked up from anywhere in the picture.

    Where the subset has none, those of its nearest pixel that has some are taken. `valid` (H, W)
    are the pixels of the picture that are fitted.
    """

    def __init__(
        self,
        subset: Window,
        valid: NDArray[np.bool_],
        materials: Materials,
        normals: NDArray[np.float64],
    ) -> None:
        from scipy.ndimage import distance_transform_edt

        self._subset, self._shape = subset, valid.shape
        maps = [materials.albedo, materials.roughness[..., None], materials.metallic[..., None]]
        self._maps = np.concatenate([*maps, normals], axis=-1)
        missing = ~subset.of(valid)
        if missing.any():
            nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
            self._maps = self._maps[tuple(nearest)]

    def at(self, window: Window) -> tuple[Materials, NDArray[np.float64]]:
        """Materials and normals (h, w, ...) of the pixels of a window."""
        rows = _nearest(self._shape[0], window.rows, self._subset.rows)
        columns = _nearest(self._shape[1], window.columns, self._subset.columns)
        maps = self._maps[np.ix_(rows, columns)]
        return Materials(maps[..., :3], maps[..., 3], maps[..., 4]), maps[..., 5:]


def _nearest(length: int, wanted: slice, subset: slice) -> NDArray[np.intp]:
    """Which of the subset's rows is nearest to each of the wanted rows, of `length`."""
    found = np.rint((np.arange(length)[wanted] - subset.start) / subset.step).astype(np.intp)
    last = len(range(subset.start, length, subset.step)) - 1
    nearest: NDArray[np.intp] = np.clip(found, 0, last)
    return nearest
