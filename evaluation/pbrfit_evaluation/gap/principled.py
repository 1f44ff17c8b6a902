"""The principled model's integral, by brute force.

The BRDF is that of Blender's Principled and, but for the dielectric's Fresnel term, of glTF: GGX
with height-correlated Smith masking over a Lambertian body. In the pixel's frame its weights are

    w = m M(ρ) (ρ a + b) + (1−m) M(0.04) g + (1−m) ρ (1 − M(0.04) E_d)/π · A Y(n),
    a = ∫ D G/(4 n·v) (1−s) Y dl,  b = ∫ D G/(4 n·v) s Y dl,  s = (1−v·h)⁵,
    g = ∫ D G/(4 n·v) F Y dl,  F by Fresnel's equations at v·h and an index of 1.5,
    G = 2 (n·l)(n·v) / (n·l √((n·v)²(1−α²)+α²) + n·v √((n·l)²(1−α²)+α²)),

with a lobe of a metal (weight m, F0 = ρ, Schlick's Fresnel) and one of a dielectric (weight 1−m).
E_d is the directional albedo of the latter: what it reflects does not reach the body.

The package's model has κ (0.04 a + b) instead of g, one number κ(r, n·v) such that E_d is the same.

**Light between facets.** Light that leaves a facet towards another is lost in this BRDF. With
E(n·v) the albedo of the lobe without Fresnel and Ē = 2 ∫ E x dx, a share 1−E of the light goes on,
and after the first further bounce all of them do the same. Their sum is F_ms of it, and a lobe that
is simply scaled up for it is M = 1 + F_ms (1−E)/E times as bright:

    F_ms = F̄ Ē / (1 − F̄ (1−Ē)),  F̄ = 2 ∫ F x dx = F0 + (1−F0)/21.

Where F = 1, M = 1/E: nothing is lost.

E. Heitz: Understanding the masking-shadowing function in microfacet-based BRDFs. JCGT 3(2), 2014.
C. Kulla, A. Conty: Revisiting physically based shading at Imageworks. SIGGRAPH course, 2017.
E. Turquin: Practical multiple scattering compensation for microfacet models. 2019.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.gap.brute_force import (
    NODES,
    integrate_lobe,
    integrated_lobe,
    rings,
    schlick_parts,
)

F0_DIELECTRIC = 0.04
_INDEX = 1.5  # ((1.5 − 1) / (1.5 + 1))² = 0.04

_LAMBERT = np.zeros(16)  # A_l Y_l0(z), from the clamped cosine's A = π, 2π/3, π/4, 0
_LAMBERT[[0, 2, 6]] = [
    np.pi * math.sqrt(1 / (4 * np.pi)),
    2 * np.pi / 3 * math.sqrt(3 / (4 * np.pi)),
    np.pi / 4 * math.sqrt(5 / (4 * np.pi)),
]

_RINGS = 32  # values of n·v in the mean over all of them


@dataclass(frozen=True, eq=False)
class PrincipledResponse:
    """Reflection of one (r, n·v) of SH light, in the pixel's own frame.

    `base`, `grazing`, `glass` are a, b and g above, (16,); `mean_albedo` is Ē. `error` is the
    largest change of any of the integrals when the number of nodes is doubled.
    """

    base: Array
    grazing: Array
    glass: Array
    mean_albedo: float
    error: float

    @property
    def albedo(self) -> float:
        """E above: the lobe's directional albedo without Fresnel."""
        return _albedo(self.base + self.grazing)

    def factor(self, f0: Array | float) -> Array:
        """M above, of lobes of any reflectance."""
        mean_fresnel = f0 + (1 - np.asarray(f0)) / 21
        further = mean_fresnel * self.mean_albedo / (1 - mean_fresnel * (1 - self.mean_albedo))
        return np.asarray(1 + further * (1 - self.albedo) / self.albedo)

    def weights(self, albedo: Array, metallic: Array) -> Array:
        """(..., 3, 16) as `kernel.shade` gives: albedo (..., 3) in [0, 1], metallic (...,)."""
        rho = np.asarray(albedo, dtype=np.float64)[..., None]
        m = np.asarray(metallic, dtype=np.float64)[..., None, None]
        multiple = self.factor(F0_DIELECTRIC)
        metal = self.factor(rho) * (rho * self.base + self.grazing)
        body = rho * (1 - multiple * _albedo(self.glass)) / np.pi * _LAMBERT
        return np.asarray(m * metal + (1 - m) * (multiple * self.glass + body))


def respond(roughness: float, n_dot_v: float) -> PrincipledResponse:
    """Integrate the BRDF at a roughness and a view angle, both in (0, 1].

    Raises InputError if roughness or n·v lies outside its range.
    """
    (base, grazing, glass), error = _integrals(roughness, n_dot_v)
    return PrincipledResponse(base, grazing, glass, mean_albedo(roughness), error)


@lru_cache(maxsize=4096)
def _integrals(roughness: float, n_dot_v: float) -> tuple[Array, float]:
    return integrated_lobe(roughness, n_dot_v, masking, _fresnel)


@lru_cache(maxsize=1024)
def mean_albedo(roughness: float) -> float:
    """Ē above: 2 ∫ E x dx."""
    cosines, shares = rings(_RINGS)
    found = [_albedo(integrate_lobe(roughness, x, NODES, masking, _one)[0]) for x in cosines]
    return float(np.dot(shares, found))


def masking(n_dot_v: float, n_dot_l: Array, roughness: float) -> Array:
    """Smith's G of both directions at the same height of the surface."""
    square = roughness**4
    of_view = n_dot_l * math.sqrt(n_dot_v**2 * (1 - square) + square)
    of_light = n_dot_v * np.sqrt(n_dot_l**2 * (1 - square) + square)
    return np.asarray(2 * n_dot_l * n_dot_v / (of_view + of_light))


def fresnel(cosine: Array) -> Array:
    """Unpolarised reflectance of a dielectric of index 1.5 at the cosine of incidence."""
    inside = np.sqrt(_INDEX**2 - 1 + cosine**2)  # index times cosine of refraction
    across = (cosine - inside) / (cosine + inside)
    along = (_INDEX**2 * cosine - inside) / (_INDEX**2 * cosine + inside)
    return np.asarray((across**2 + along**2) / 2)


def _fresnel(v_dot_h: Array) -> Array:
    """(3, ...): Schlick's two parts, and the equations."""
    return np.concatenate([schlick_parts(v_dot_h), fresnel(v_dot_h)[None]])


def _one(v_dot_h: Array) -> Array:
    return np.ones((1, *v_dot_h.shape))


def _albedo(response: Array) -> float:
    """Share of light that comes back where it comes evenly from all around."""
    return float(2 * math.sqrt(math.pi) * response[0])
