"""What the nearest pixel of a lattice has, for each pixel of a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.materials import Materials
from pbrfit.tiles.part import Window

Array = NDArray[np.float64]


class Nearest:
    """Materials and normals of a lattice, looked up from anywhere in the picture.

    Parameters
    ----------
    lattice
        Which pixels of the picture they are of.
    valid
        (H, W): the pixels of the picture that are fitted.
    materials, normals
        Of the lattice; where it has none, the nearest pixel that has some is taken.
    """

    def __init__(
        self,
        lattice: Window,
        valid: NDArray[np.bool_],
        materials: Materials,
        normals: Array,
    ) -> None:
        from scipy.ndimage import distance_transform_edt

        self._lattice, self._shape = lattice, valid.shape
        maps = [materials.albedo, materials.roughness[..., None], materials.metallic[..., None]]
        self._maps = np.concatenate([*maps, normals], axis=-1).astype(np.float32)
        missing = ~lattice.of(valid)
        if missing.any():
            nearest = distance_transform_edt(
                missing, return_distances=False, return_indices=True
            )
            self._maps = self._maps[tuple(nearest)]

    def at(self, window: Window) -> tuple[Materials, Array]:
        """Materials and normals (h, w, ...) of the pixels of a window."""
        rows = _nearest(self._shape[0], window.rows, self._lattice.rows, self._maps.shape[0])
        columns = _nearest(
            self._shape[1], window.columns, self._lattice.columns, self._maps.shape[1]
        )
        maps = self._maps[np.ix_(rows, columns)].astype(np.float64)
        materials = np.clip(maps[..., :5], 0.0, 1.0)
        normals = maps[..., 5:]
        normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        return Materials(materials[..., :3], materials[..., 3], materials[..., 4]), normals


def _nearest(length: int, wanted: slice, lattice: slice, count: int) -> NDArray[np.intp]:
    first, _, step = lattice.indices(length)
    found = np.rint((np.arange(length)[wanted] - first) / step).astype(np.intp)
    return np.clip(found, 0, count - 1)
