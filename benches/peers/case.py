"""The data: the same for every peer, made anew in each process from one seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.lighting import BAND_OF
from pbrfit_evaluation.float32_model import (
    DIELECTRIC_F0,
    DIFFUSE,
    Float32,
    View,
    band_polynomials,
)

__all__ = ["BANDS", "BAND_OF", "DIELECTRIC_F0", "DIFFUSE", "Case", "Float32", "band_polynomials"]

BANDS = tuple(slice(band * band, (band + 1) ** 2) for band in range(4))
"""The coefficients of band l."""


@dataclass(frozen=True, eq=False)
class Case(View):
    """Pictures of one view, and the point at which the loss is wanted.

    Attributes
    ----------
    x
        The unknowns, float64: [albedo R | G | B | roughness | metallic (P each) | lights (N, 16,
        3)].
    """

    x: NDArray[np.float64]

    @classmethod
    def make(cls, pixels: int, pictures: int, seed: int = 0) -> Case:
        """Random materials, lights and pictures. All roughness values occur alike, 0 included."""
        rng = np.random.default_rng(seed)
        views = np.tile([0.0, 0.0, 1.0], (pixels, 1))
        views[:, :2] += rng.uniform(-0.3, 0.3, (pixels, 2))
        views /= np.linalg.norm(views, axis=1, keepdims=True)
        normals = views + rng.uniform(-0.6, 0.6, (pixels, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        images = rng.random((pictures, pixels, 3), dtype=np.float32)
        materials = rng.random(5 * pixels)
        materials[3 * pixels] = 0.0
        lights = rng.normal(0.0, 0.3, (pictures, 16, 3))
        lights[:, 0] += 1.0
        return cls(images, normals, views, np.concatenate([materials, lights.ravel()]))

    def unpack(self, dtype: Any = np.float32) -> tuple[NDArray[Any], ...]:
        """Albedo (3, P), roughness (P,), metallic (P,), lights (N, 16, 3) of x."""
        p = self.pixels
        x = self.x.astype(dtype)
        return (
            x[: 3 * p].reshape(3, p),
            x[3 * p : 4 * p],
            x[4 * p : 5 * p],
            x[5 * p :].reshape(-1, 16, 3),
        )
