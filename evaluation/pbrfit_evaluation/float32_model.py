"""What any float32 array library needs to evaluate the objective: constants of model and view.

For the peers that this package is compared with. They get the cheapest sound forms: SH bases and
n·v are made beforehand, and band weights are one short polynomial.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from pbrfit.fit.scale import IRRADIANCE
from pbrfit.model.reflection import ggx_band_weights, sh_basis

Float32 = NDArray[np.float32]

DIFFUSE = 9
"""Coefficients with a diffuse response: bands 0 to 2."""

DIELECTRIC_F0 = 0.04
MIN_COSINE = 1e-4
BAND_DEGREE = 16


@dataclass(frozen=True, eq=False)
class View:
    """Pictures of P pixels, and what of the model depends on the view alone."""

    images: Float32
    """(N, P, 3) linear radiance."""
    normals: NDArray[np.float64]
    views: NDArray[np.float64]
    """`normals` and `views`: (P, 3) float64 unit vectors."""

    @property
    def pixels(self) -> int:
        """P."""
        return len(self.normals)

    @cached_property
    def cosine(self) -> Float32:
        """n·v for masking and Fresnel, (P,)."""
        return np.maximum(self._cosine, MIN_COSINE).astype(np.float32)

    @cached_property
    def diffuse_basis(self) -> Float32:
        """A_l Y_k(n), (P, 9)."""
        basis = sh_basis(self.normals)[:, :DIFFUSE]
        return np.asarray(IRRADIANCE[:DIFFUSE] * basis, dtype=np.float32)

    @cached_property
    def mirror_basis(self) -> Float32:
        """Y_k(2 (n·v) n − v), (P, 16)."""
        mirror = 2 * self._cosine[:, None] * self.normals - self.views
        return np.asarray(sh_basis(mirror), dtype=np.float32)

    @property
    def _cosine(self) -> NDArray[np.float64]:
        return np.asarray(np.sum(self.normals * self.views, axis=1))


def band_polynomials() -> NDArray[np.float64]:
    """Coefficients of h_l(r) as polynomials in s = 2r − 1, (4, 17): h_l = Σ_j c_lj s^j.

    What peers use in place of the paper's closed forms, which lose everything in float32 near
    roughness 1. Off by at most 3e-6 over [0, 1]. One short branch-free polynomial is also the
    cheapest form for each of them, cheaper than what our own core evaluates in float64.
    """
    nodes = chebyshev.chebpts1(BAND_DEGREE + 1)
    weights = ggx_band_weights((nodes + 1) / 2)[0]
    series = np.linalg.solve(chebyshev.chebvander(nodes, BAND_DEGREE), weights)
    return np.stack([chebyshev.cheb2poly(of_band) for of_band in series.T])
