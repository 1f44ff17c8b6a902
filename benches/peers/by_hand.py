"""The gradient written by hand, in the matrix form, for any array library, a block of pixels.

For one channel, with W (16, B), lights L (N, 16) and targets T (N, B):

    e = L W − T        ∂/∂W = Lᵀ e        ∂/∂L = e Wᵀ        (of ½ Σ e²)

A block is small enough for the cache, so that no intermediate array goes to memory: that is what
automatic differentiation of the whole cannot have.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from peers.case import BANDS, DIELECTRIC_F0, DIFFUSE, Case, band_polynomials

POLYNOMIALS: list[list[float]] = band_polynomials().astype(np.float32).tolist()
"""Plain numbers, which compilers take in."""


class Constants(NamedTuple):
    """What a block needs beside the unknowns; the last axis is pixels.

    `diffuse` (9, B) and `mirror` (16, B) bases, `cosine` and `schlick` (B,), `targets` (3, N, B).
    """

    diffuse: Any
    mirror: Any
    cosine: Any
    schlick: Any
    targets: Any


def constants(case: Case) -> Constants:
    """Of all pixels, as numpy arrays."""
    return Constants(
        np.ascontiguousarray(case.diffuse_basis.T),
        np.ascontiguousarray(case.mirror_basis.T),
        case.cosine,
        (1 - case.cosine) ** 5,
        np.ascontiguousarray(case.images.transpose(2, 0, 1)),
    )


def block_of(xp: Any, maps: Any, lights: Any, given: Constants) -> tuple[Any, Any, Any]:
    """Σ e², ∂/∂maps (5, B) and ∂/∂L (3, N, 16) of ½ Σ e².

    `xp` is the library: torch or jax.numpy. `maps` (5, B): albedo, roughness, metallic; `lights`
    (3, N, 16).
    """
    r, m, x = maps[3], maps[4], given.cosine
    h, dh = _band_weights(r)
    specular = xp.concatenate(
        [h[l] * given.mirror[band] for l, band in enumerate(BANDS)],
    )
    r3 = r * r * r
    k = 0.5 * (r3 * r)
    inverse = 1 / (x * (1 - k) + k)
    g1 = 0.25 * (x * inverse)
    dg1 = -0.5 * (x * (1 - x)) * (inverse * inverse) * r3
    transmission = 1 - given.schlick
    dielectric = (1 - m) * (1 / math.pi)
    by_roughness = by_metallic = squares = 0.0
    by_albedo, by_lights = [], []
    for c in range(3):
        rho = maps[c]
        f0 = DIELECTRIC_F0 + m * (rho - DIELECTRIC_F0)
        fresnel = 1 - (1 - f0) * transmission
        ks = fresnel * g1
        kd = (1 - fresnel) * dielectric * rho
        ws = ks * specular
        w = xp.concatenate([ws[:DIFFUSE] + kd * given.diffuse, ws[DIFFUSE:]])
        e = lights[c] @ w - given.targets[c]
        squares = squares + (e * e).sum()
        by_lights.append(e @ w.T)
        by_w = lights[c].T @ e
        by_kd = (by_w[:DIFFUSE] * given.diffuse).sum(0)
        mirrored = by_w * given.mirror
        sums = [mirrored[band].sum(0) for band in BANDS]
        by_ks = sum(h[l] * sums[l] for l in range(4))
        by_roughness = by_roughness + ks * sum(dh[l] * sums[l] for l in range(4))
        by_roughness = by_roughness + fresnel * dg1 * by_ks
        transmitted = (1 - fresnel) * by_kd
        by_f0 = transmission * (g1 * by_ks - dielectric * rho * by_kd)
        by_albedo.append(dielectric * transmitted + m * by_f0)
        by_metallic = by_metallic + (rho - DIELECTRIC_F0) * by_f0
        by_metallic = by_metallic - rho * transmitted * (1 / math.pi)
    return squares, xp.stack([*by_albedo, by_roughness, by_metallic]), xp.stack(by_lights)


def _band_weights(r: Any) -> tuple[list[Any], list[Any]]:
    """h_l and dh_l/dr, four of each, by Horner's rule."""
    s = 2 * r - 1
    values, slopes = [], []
    for polynomial in POLYNOMIALS:
        value, slope = polynomial[-1], 0.0
        for coefficient in polynomial[-2::-1]:
            slope = slope * s + value
            value = value * s + coefficient
        values.append(value)
        slopes.append(2 * slope)
    return values, slopes


def unknowns(case: Case) -> tuple[Any, Any]:
    """Maps (5, P) and lights (3, N, 16) of a case, float32."""
    albedo, roughness, metallic, lights = case.unpack()
    maps = np.concatenate([albedo, roughness[None], metallic[None]])
    return maps, np.ascontiguousarray(lights.transpose(2, 0, 1))


def ordered(maps: Any, by_lights: Any, scale: float) -> NDArray[np.float64]:
    """The gradient in the order of x, float64, from sums of ½ Σ e²."""
    parts = [np.asarray(maps, np.float64).ravel()]
    parts.append(np.asarray(by_lights, np.float64).transpose(1, 2, 0).ravel())
    return np.asarray(scale * np.concatenate(parts))
