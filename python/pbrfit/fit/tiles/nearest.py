"""What the nearest pixel of a lattice is like, for each pixel of a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.tiles.part import Window
from pbrfit.model.materials import Materials


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
        normals: NDArray[np.float64],
    ) -> None:
        from scipy.ndimage import distance_transform_edt

        self._lattice, self._shape = lattice, valid.shape
        maps = [materials.albedo, materials.roughness[..., None], materials.metallic[..., None]]
        self._maps = np.concatenate([*maps, normals], axis=-1)
        missing = ~lattice.of(valid)
        if missing.any():
            nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
            self._maps = self._maps[tuple(nearest)]

    def at(self, window: Window) -> tuple[Materials, NDArray[np.float64]]:
        """Materials and normals (h, w, ...) of the pixels of a window."""
        rows = _nearest(self._shape[0], window.rows, self._lattice.rows)
        columns = _nearest(self._shape[1], window.columns, self._lattice.columns)
        maps = self._maps[np.ix_(rows, columns)]
        return Materials(maps[..., :3], maps[..., 3], maps[..., 4]), maps[..., 5:]


def _nearest(length: int, wanted: slice, lattice: slice) -> NDArray[np.intp]:
    """Which of the lattice's rows is nearest to each of the wanted rows, of `length`."""
    found = np.rint((np.arange(length)[wanted] - lattice.start) / lattice.step).astype(np.intp)
    last = len(range(lattice.start, length, lattice.step)) - 1
    nearest: NDArray[np.intp] = np.clip(found, 0, last)
    return nearest
