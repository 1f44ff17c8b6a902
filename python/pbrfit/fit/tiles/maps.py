"""Maps of a whole picture: those that fill tile by tile, and those that tiles start from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import uncertainty
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.tiles.windows import Tile, Window
from pbrfit.model.materials import Materials
from pbrfit.scene.scene import Scene


class TiledMaps:
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


class NearestMaps:
    """Materials and normals of a strided subset, looked up from anywhere in the picture.

    Parameters
    ----------
    subset
        Which pixels of the picture they are of.
    valid
        (H, W): the pixels of the picture that are fitted.
    materials, normals
        Of the subset; where it has none, the nearest pixel that has some is taken.
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
