"""The data: the same for every peer, made anew in each process from one seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

import pbrfit

Float32 = NDArray[np.float32]

BAND_OF = (0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3)
"""Band l of coefficient k."""

BANDS = tuple(slice(l * l, (l + 1) ** 2) for l in range(4))
"""The coefficients of band l."""

DIFFUSE = 9
"""Coefficients with a diffuse response: bands 0 to 2."""

DIELECTRIC_F0 = 0.04
MIN_COSINE = 1e-4
BAND_DEGREE = 16


@dataclass(frozen=True)
class Case:
    """Pictures of one view, and the point at which the loss is wanted.

    Attributes
    ----------
    images
        (N, P, 3) linear radiance.
    normals, views
        (P, 3) float64 unit vectors.
    x
        The unknowns, float64: [albedo R | G | B | roughness | metallic (P each) | lights (N, 16,
        3)].
    """

    images: Float32
    normals: NDArray[np.float64]
    views: NDArray[np.float64]
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

    @property
    def pixels(self) -> int:
        """P."""
        return len(self.normals)

    @property
    def pictures(self) -> int:
        """N."""
        return len(self.images)

    @cached_property
    def cosine(self) -> Float32:
        """n·v for masking and Fresnel, (P,)."""
        return np.maximum(self._cosine, MIN_COSINE).astype(np.float32)

    @cached_property
    def diffuse_basis(self) -> Float32:
        """A_l Y_k(n), (P, 9)."""
        transfer = np.array([math.pi, 2 * math.pi / 3, math.pi / 4])[list(BAND_OF[:DIFFUSE])]
        basis = pbrfit.sh_basis(self.normals)[:, :DIFFUSE]
        return np.asarray(transfer * basis, dtype=np.float32)

    @cached_property
    def mirror_basis(self) -> Float32:
        """Y_k(2 (n·v) n − v), (P, 16)."""
        mirror = 2 * self._cosine[:, None] * self.normals - self.views
        return np.asarray(pbrfit.sh_basis(mirror), dtype=np.float32)

    @property
    def _cosine(self) -> NDArray[np.float64]:
        return np.asarray(np.sum(self.normals * self.views, axis=1))

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


def band_polynomials() -> NDArray[np.float64]:
    """Coefficients of h_l(r) as polynomials in s = 2r − 1, (4, 17): h_l = Σ_j c_lj s^j.

    What peers use in place of the paper's closed forms, which lose everything in float32 near
    roughness 1. Off by at most 3e-6 over [0, 1]. One short branch-free polynomial is also the
    cheapest form for each of them, cheaper than what our own core evaluates in float64.
    """
    nodes = chebyshev.chebpts1(BAND_DEGREE + 1)
    weights = pbrfit.ggx_band_weights((nodes + 1) / 2)[0]
    series = np.linalg.solve(chebyshev.chebvander(nodes, BAND_DEGREE), weights)
    return np.stack([chebyshev.cheb2poly(of_band) for of_band in series.T])
