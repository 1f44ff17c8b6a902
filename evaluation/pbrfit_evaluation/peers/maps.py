"""What a peer finds in one picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.materials import Materials


@dataclass(frozen=True, eq=False)
class Maps:
    """Maps of a picture, linear: `albedo` (H, W, 3), `roughness` and `metallic` (H, W)."""

    albedo: NDArray[np.floating[Any]]
    roughness: NDArray[np.floating[Any]]
    metallic: NDArray[np.floating[Any]]

    def materials(self, valid: NDArray[np.bool_]) -> Materials:
        """As the materials of a scene: within [0, 1], NaN outside of `valid`."""

        def kept(plane: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
            where = valid if plane.ndim == 2 else valid[..., None]
            return np.where(where, np.clip(plane.astype(np.float64), 0, 1), np.nan)

        return Materials(kept(self.albedo), kept(self.roughness), kept(self.metallic))
