"""The principled model again: slow, plain, float64, from its BRDF by brute force.

The weights of a pixel are integrals over light directions in world space, without a local frame and
without a table: w_ck = ∫ f_c(l) n·l Y_k(l) dl over n·l > 0, with

    f_c = D V [(1−m) M(0.04) κ F(0.04) + m M(ρ_c) F(ρ_c)] + kd_c    F(F0) = F0 + (1−F0)(1−v·h)⁵
    kd_c = (1−m) ρ_c (1−E_d)/π                            E_d = M(0.04) ∫ D V F_glass n·l dl

κ makes the dielectric lobe reflect as much of a uniform light as with Fresnel's equations for
glass, F_glass, in place of Schlick's: κ ∫ D V F(0.04) n·l dl = ∫ D V F_glass n·l dl.

GGX D (Walter et al. 2007), V = G/(4 n·l n·v) with height-correlated Smith G (Heitz 2014),
Schlick's F (1994), Fresnel's equations for unpolarised light and a refractive index of 1.5, and M
the multiple scattering factor of a lobe (Kulla and Conty 2017, Turquin 2019).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from reference import glass, sh_basis

Array = NDArray[np.floating[Any]]

DIELECTRIC_F0 = 0.04
ORDER = np.array([0, 0, 1, 0, 1, 2, 0, 1, 2, 3])
"""m of the ten functions that are even in y, j = l(l+1)/2 + m."""
EVEN = np.array([0, 2, 3, 6, 7, 8, 12, 13, 14, 15])
"""Their index l(l+1)+m among all sixteen."""


@dataclass(frozen=True)
class Lights:
    """Directions of light over a surface, (K, 3), and the solid angle of each, (K,)."""

    directions: Array
    area: Array

    @classmethod
    def about_mirror(
        cls, normal: Array, view: Array, r: float, polar: int = 160, around: int = 320
    ) -> Lights:
        """A rule in polar coordinates about the mirror direction, up to the horizon.

        The angle ω from the mirror direction is s sinh y, dense within the lobe, and y takes the
        tanh-sinh rule, dense at the horizon; equal steps around.
        """
        cosine = float(normal @ view)
        mirror = 2 * cosine * normal - view
        aside = np.cross(mirror, np.eye(3)[np.argmin(np.abs(mirror))])
        aside /= np.linalg.norm(aside)
        azimuth = 2 * math.pi * (np.arange(around) + 0.5) / around
        outward = np.cos(azimuth)[:, None] * aside
        outward += np.sin(azimuth)[:, None] * np.cross(mirror, aside)
        horizon = np.arctan2(cosine, -(outward @ normal))  # cos ω n·R + sin ω n·outward = 0
        nodes, weights = tanh_sinh(polar)
        width = 2 * r * r * max(cosine, 0.02)
        reach = np.arcsinh(horizon / width)[:, None]
        angle = width * np.sinh(reach * nodes)
        area = np.sin(angle) * width * np.cosh(reach * nodes) * reach * weights
        directions = np.cos(angle)[..., None] * mirror + np.sin(angle)[..., None] * outward[:, None]
        return cls(directions.reshape(-1, 3), area.ravel() * 2 * math.pi / around)


def tanh_sinh(count: int) -> tuple[Array, Array]:
    """Nodes and weights on [0, 1] for functions that are rough at its ends."""
    t = np.linspace(-3.2, 3.2, count)
    nodes = 0.5 * (1 + np.tanh(0.5 * math.pi * np.sinh(t)))
    weights = np.cosh(t) / np.cosh(0.5 * math.pi * np.sinh(t)) ** 2
    return nodes, weights / weights.sum()


def lobe(normal: Array, view: Array, light: Array, r: float) -> tuple[Array, Array]:
    """D V n·l and v·h at light directions (K, 3)."""
    e = r**4
    half = view + light
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    n_h, v_h = half @ normal, half @ view
    n_l, n_v = np.maximum(light @ normal, 0), float(normal @ view)
    aside = np.sum(np.cross(normal, half) ** 2, axis=-1)
    distribution = e / (math.pi * (e * n_h**2 + aside) ** 2)
    visibility = 0.5 / (n_l * math.sqrt(n_v**2 * (1 - e) + e) + n_v * np.sqrt(n_l**2 * (1 - e) + e))
    return distribution * visibility * n_l, v_h


def schlick(f0: Array | float, cosine: Array) -> Array:
    """Schlick's fit to Fresnel's equations."""
    return np.asarray(f0 + (1 - f0) * (1 - cosine) ** 5)


def at_cosine(cosine: float) -> tuple[Array, Array]:
    """A normal and a view in the frame of the lobe functions: mirror direction towards +x."""
    return np.array([0.0, 0, 1]), np.array([-math.sqrt(1 - cosine**2), 0, cosine])


def reflectance(r: float, cosine: float, polar: int, around: int) -> float:
    """E: the part of uniform light that a lobe of F = 1 reflects."""
    normal, view = at_cosine(cosine)
    lights = Lights.about_mirror(normal, view, r, polar, around)
    return float(lobe(normal, view, lights.directions, r)[0] @ lights.area)


def mean_reflectance(r: float) -> float:
    """Ebar = 2 ∫ E x dx."""
    nodes, weights = leggauss(14)
    root = (1 + nodes) / 2  # x = root²
    values = [reflectance(r, q * q, 60, 300) for q in root]
    return float(np.sum(weights / 2 * 2 * root * 2 * root**2 * values))


def multiple_scattering(f0: Array, e: float, mean: float) -> Array:
    """M: how much brighter a lobe is by light that is reflected several times."""
    mean_fresnel = f0 + (1 - f0) / 21
    several = mean_fresnel * mean / (1 - mean_fresnel * (1 - mean))
    return np.asarray(1 + several * (1 - e) / e)


def shade(
    normal: Array, view: Array, albedo: Array, r: float, metallic: float, mean: float | None = None
) -> Array:
    """Weights of one pixel, (3, 16); `mean` is its `mean_reflectance`, if that is known."""
    lights = Lights.about_mirror(normal, view, r)
    response, v_h = lobe(normal, view, lights.directions, r)
    mean = mean_reflectance(r) if mean is None else mean
    e = float(response @ lights.area)
    gain = multiple_scattering(np.array(DIELECTRIC_F0), e, mean)
    once = float((response * glass(v_h)) @ lights.area)
    fresnel = schlick(DIELECTRIC_F0, v_h)
    kappa = once / float((response * fresnel) @ lights.area)
    kd = (1 - metallic) * albedo * (1 - float(gain) * once) / math.pi
    of_metal = multiple_scattering(albedo, e, mean)[:, None] * schlick(albedo[:, None], v_h)
    n_l = np.maximum(lights.directions @ normal, 0)
    reflected = response * ((1 - metallic) * gain * kappa * fresnel + metallic * of_metal)
    reflected = reflected + kd[:, None] * n_l
    return np.asarray((reflected * lights.area) @ sh_basis(lights.directions))
