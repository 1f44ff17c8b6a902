"""What is thought likely of lights: bands no stronger than their mean, and their common scale.

Where pictures say little about lights, Gauss–Newton lets them go far: with a wrong field of view or
wrong normals band 3 grows to 100 times its true size, which no radiance that is positive everywhere
can have. So each coefficient L_nkc has a normal distribution around that of a constant light, with
standard deviation `BAND_SIGMA` times the constant coefficient c_nc of the lights at the start, and
all lights together one common scale around 1, of standard deviation `SCALE_SIGMA`:

    L ~ N(μ, D⁻¹ + σ² μ μᵀ)    μ_n0c = c_nc, else 0    D_nkc = (BAND_SIGMA c_nc)⁻²

and by Woodbury's formula the precision is Q = D − (D μ)(D μ)ᵀ / (1/σ² + μᵀ D μ).

The prior counts as `weight` times (L − μ)ᵀ Q (L − μ) beside the sum of squared residuals, where
Bayes' rule would have the noise's variance; `pbrfit.fit.misfit` says what stands there instead.
That is `noise`, which more pixels outweigh, and for each pixel `shared`: more pixels say no more
about what the model does not have, and shall not push lights further.

Beside it, `grey` weighs for each pixel the squared deviation of lights from their mean over the
channels: the monochrome prior (docs/fit.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.values.arrays import Array

BAND_SIGMA = 0.45
"""Standard deviation of a coefficient over the constant one. Eight panoramas, rotated at random,
have root mean squares of 0.50, 0.46, 0.44 in bands 1, 2 and 3."""

SCALE_SIGMA = 0.5
"""Relative standard deviation of the common scale: half of the albedo's range around its start."""

DIM_SHARE = 0.05
"""Least size of constant coefficients, by their mean: a dark picture's bands may be bright."""


@dataclass(frozen=True, eq=False)
class LightPrior:
    """A quadratic in the lights, as the core has them: (M,)."""

    mean: Array
    diagonal: Array
    """(M,): μ and D."""
    rank_one: Array
    """(M,): u with Q = D − u uᵀ."""
    channels: int
    """Of lights."""
    coefficients: int
    """K."""
    noise: float = 0.0
    shared: float = 0.0
    grey: float = 0.0
    pixels: int = 1
    """Beside the squared residuals of how many."""

    @property
    def weight(self) -> float:
        """Of the prior."""
        return self.noise + self.pixels * self.shared

    def weighing(self, weight: float, variance: float, pixels: int) -> LightPrior:
        """With this weight beside so many pixels, whose residuals have a variance."""
        noise = min(weight, variance)
        return replace(self, noise=noise, shared=(weight - noise) / pixels)

    def times(self, share: float) -> LightPrior:
        """With a share of the weight; that of grey lights is the user's and stays."""
        return replace(self, noise=share * self.noise, shared=share * self.shared)

    @classmethod
    def around(cls, objective: Objective, x: Array) -> LightPrior:
        """With the constant coefficients of the lights of x."""
        lights = objective.lights_in_core(x)
        constant = np.abs(lights[:, :, 0])
        constant = np.maximum(constant, DIM_SHARE * constant.mean() or MEAN_RADIANCE)
        mean = np.zeros_like(lights)
        mean[:, :, 0] = constant
        diagonal = np.broadcast_to((BAND_SIGMA * constant[:, :, None]) ** -2, lights.shape).ravel()
        mean = mean.ravel()
        along = diagonal * mean
        rank_one = along / np.sqrt(SCALE_SIGMA**-2 + along @ mean)
        return cls(mean, diagonal, rank_one, *lights.shape[::2])

    def of_pixels(self, count: int) -> LightPrior:
        """Beside the squared residuals of so many pixels."""
        return replace(self, grey=count * self.grey, pixels=count)

    def product(self, v: Array) -> Array:
        """(weight Q + grey (1 − mean over channels)) v."""
        found = self.weight * (self.diagonal * v - self.rank_one * (self.rank_one @ v))
        return np.asarray(found + self.grey * self._off_grey(v))

    def half_gradient(self, lights: Array) -> Array:
        """Half of the gradient at lights (M,)."""
        return self.product(lights - self.mean) + self.grey * self._off_grey(self.mean)

    def cost(self, lights: Array) -> float:
        """At lights (M,)."""
        change, off_grey = lights - self.mean, self._off_grey(lights)
        of_bands = float(change @ (self.diagonal * change)) - float(self.rank_one @ change) ** 2
        return self.weight * of_bands + self.grey * float(off_grey @ off_grey)

    def matrix(self, basis: Array | None = None) -> Array:
        """Of `product`, (M, M); with a basis Q (channels, N, J) that of sums Qᵀ L of the lights."""
        of_pictures = (self.channels, -1, self.coefficients)
        diagonal, rank_one = self.diagonal.reshape(of_pictures), self.rank_one.reshape(of_pictures)
        if basis is None:
            pictures = diagonal.shape[1]
            basis = np.broadcast_to(np.eye(pictures), (self.channels, pictures, pictures))
        channels, _, rank = basis.shape
        along = np.sqrt(self.weight) * np.einsum("cnj,cnk->cjk", basis, rank_one)
        found: Array = np.multiply.outer(-along, along)
        np.einsum("cikcjk->cijk", found)[:] += self.weight * np.einsum(
            "cni,cnk,cnj->cijk", basis, diagonal, basis, optimize=True
        )
        if self.grey:
            off_grey = self.grey * (np.eye(channels) - 1 / channels)
            np.einsum("cikdjk->cidjk", found)[:] += np.einsum(
                "cd,cni,dnj->cidj", off_grey, basis, basis, optimize=True
            )[..., None]
        size = channels * rank * self.coefficients
        return found.reshape(size, size)

    def of_pictures(self) -> Array:
        """(N, channels K, channels K): blocks of the matrix, without the common scale."""
        k = self.coefficients
        diagonal = self.diagonal.reshape(self.channels, -1, k).transpose(1, 0, 2)
        found = np.zeros((len(diagonal), self.channels, k, self.channels, k))
        np.einsum("nckck->nck", found)[:] = self.weight * diagonal
        off_grey = self.grey * (np.eye(self.channels) - 1 / self.channels)
        np.einsum("nckdk->ncdk", found)[:] += off_grey[:, :, None]
        return found.reshape(len(diagonal), self.channels * k, self.channels * k)

    def _off_grey(self, v: Array) -> Array:
        of_channels = v.reshape(self.channels, -1)
        return np.asarray(of_channels - of_channels.mean(axis=0)).ravel()
