"""The model again: slow, plain, float64, written from the equations and not from the package.

Derivatives are taken by complex step: f'(r) = Im f(r + ih)/h with h = 1e-30 has no truncation
and no cancellation error, and everything below is analytic in albedo, roughness, metallic and the
normal.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.legendre import Legendre, leggauss
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
RealOrComplex = NDArray[Any]  # complex while a derivative is taken
"""φ of residuals, and its derivative."""

STEP = 1e-30
CLAMP = 1e-4  # least n·v in G1 and Fresnel


def turned(normal: Array, tilts: RealOrComplex) -> RealOrComplex:
    """Normals (P, 3) turned by tilts (2, P): u/|u| with u = n + a t₁ + b t₂.

    t₁ and t₂ are the x and y axes under the smallest rotation that takes z to n,
    R = 1 + [w] + [w]²/(1 + n_z) with w = z × n; where n_z <= -0.99, those of n mirrored in z = 0,
    mirrored back.
    """
    mirrored = np.where(normal[:, 2] > -0.99, 1, -1)[:, None] ** np.array([0, 0, 1])
    x, y, z = (mirrored * normal).T
    none = np.zeros_like(x)
    cross = np.array([[none, none, x], [none, none, y], [-x, -y, none]]).transpose(2, 0, 1)
    rotation = np.eye(3) + cross + cross @ cross / (1 + z)[:, None, None]
    u = normal + np.einsum("tp,pit->pi", tilts, mirrored[..., None] * rotation[..., :2])
    return np.asarray(u / np.sqrt(np.sum(u * u, axis=-1, keepdims=True)))


def tangents(normal: Array) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """t₁ and t₂ of normals (P, 3): how those turn at tilts of zero."""
    return turned_by(normal, np.zeros((2, len(normal))))


def turned_by(normal: Array, tilts: Array) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives of `turned` normals by both tilts, (P, 3) each."""
    steps = 1j * STEP * np.eye(2)[:, :, None]
    first, second = (turned(normal, tilts + step).imag / STEP for step in steps)
    return first, second


def unit(vectors: Array) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / length, dtype=np.float64)


def seen_at(cosine: float) -> tuple[Array, Array]:
    """The normal +z, and a view in the xz plane with exactly this n·v."""
    return np.array([0.0, 0, 1]), np.array([math.sqrt(1 - cosine**2), 0, cosine])


def frames(
    count: int, seed: int | np.random.Generator, vectors: int = 2
) -> tuple[NDArray[np.float64], ...]:
    """Random normals, views and so on, (count, 3) each, all on the normal's side."""
    drawn = np.random.default_rng(seed).normal(size=(vectors, count, 3))
    normal, *others = unit(drawn)
    sides = (np.sign(np.sum(normal * other, axis=-1, keepdims=True)) for other in others)
    return normal, *(other * side for other, side in zip(others, sides, strict=True))


def sh_basis(directions: RealOrComplex) -> RealOrComplex:
    """Real SH l <= 3 without Condon–Shortley phase, index l(l+1)+m: (..., 3) -> (..., 16).

    Y_lm = N · dᵐP_l/dzᵐ(z) · {√2 Re, 1, √2 Im}(x + iy)^|m|, since sinᵐθ·cos mφ = Re(x + iy)ᵐ. Real
    and imaginary part are kept apart, so that directions may be complex themselves.
    """
    x, y, z = np.moveaxis(np.asarray(directions), -1, 0)
    powers = [(np.ones_like(x), np.zeros_like(x))]
    for _ in range(3):
        real, imaginary = powers[-1]
        powers.append((x * real - y * imaginary, x * imaginary + y * real))
    columns = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            order = abs(m)
            norm = math.sqrt(
                (2 * degree + 1)
                / (4 * math.pi)
                * math.factorial(degree - order)
                / math.factorial(degree + order)
            )
            legendre = Legendre.basis(degree)
            polar = legendre.deriv(order)(z) if order else legendre(z)
            azimuth = powers[order][m < 0] * (math.sqrt(2) if m else 1.0)
            columns.append(norm * polar * azimuth)
    return np.stack(columns, axis=-1)


def _graded_gauss_rule() -> tuple[Array, Array]:
    """Nodes and weights on [0, 1]: 20 Gauss–Legendre nodes in each of [4⁻⁴⁵, 4⁻⁴⁴] … [¼, 1].

    A function with its poles at s <= 0 is, seen from [a, 4a], analytic within the ellipse of
    parameter 3, so the error of a panel is about 3⁻⁴⁰.
    """
    nodes, weights = leggauss(20)
    ends = np.concatenate([[0.0], 4.0 ** np.arange(-45, 1)])
    half = np.diff(ends)[:, None] / 2
    return ((ends[:-1, None] + half) + half * nodes).ravel(), (half * weights).ravel()


_S, _S_WEIGHT = _graded_gauss_rule()
# 1 − P_l(1−s), as a polynomial in s: no constant term.
_DEFICIT = np.stack(
    [
        (1 - Legendre.basis(degree).convert(kind=Polynomial))(Polynomial([1, -1]))(_S)
        for degree in range(4)
    ],
    axis=-1,
)


def _bands(r: RealOrComplex) -> RealOrComplex:
    """h_l = 8e ∫₀¹ P_l(u)/(1+e−(1−e)u)² du with e = r⁴ and s = 1−u: the root is 2e + (1−e)s.

    Written as h_0 − 8e ∫₀¹ (1−P_l)/(2e + (1−e)s)² ds with h_0 = 4/(1+e), which has nothing to
    cancel in value or derivative at small e.
    """
    flat = np.reshape(r, -1)
    out = np.full((flat.size, 4), 4.0, dtype=flat.dtype)
    # Below 1e-6 the integrand is narrower than the finest panel; there |h_l − 4| < 1e-20.
    for start in range(0, flat.size, 256):
        rows = start + np.flatnonzero(flat[start : start + 256].real > 1e-6)
        e = flat[rows, None] ** 4
        kernel = 8 * e / (2 * e + (1 - e) * _S) ** 2
        out[rows] = 4 / (1 + e) - kernel @ (_DEFICIT * _S_WEIGHT[:, None])
    return out.reshape(*np.shape(r), 4)


def bands(r: Array) -> tuple[Array, Array]:
    """Band weights and dh/dr: (...,) -> (..., 4), (..., 4)."""
    stepped = _bands(np.asarray(r) + 1j * STEP)
    return stepped.real, stepped.imag / STEP


def smith_g1(cosine: RealOrComplex, r: RealOrComplex) -> RealOrComplex:
    k = r**4 / 2
    return cosine / (cosine * (1 - k) + k)


def _weights(
    normal: RealOrComplex,
    view: Array,
    albedo: RealOrComplex,
    r: RealOrComplex,
    metallic: RealOrComplex,
) -> RealOrComplex:
    """Eqs. 6 and 12: w_k = kd A_l Y_k(n) + ks h_l Y_k(mirror), (..., 3, 16)."""
    cosine = np.sum(normal * view, axis=-1)
    mirror = 2 * cosine[..., None] * normal - view
    clamped = np.where(np.real(cosine) > CLAMP, cosine, CLAMP)
    rho, m = albedo, metallic[..., None]
    f0 = 0.04 * (1 - m) + m * rho
    fresnel = f0 + (1 - f0) * (1 - clamped[..., None]) ** 5
    diffuse = (1 - fresnel) * (1 - m) * rho / math.pi
    specular = fresnel * smith_g1(clamped, r)[..., None] / 4
    degree = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3])
    cosine_lobe = np.array([math.pi, 2 * math.pi / 3, math.pi / 4, 0.0])[degree]
    at_normal = (cosine_lobe * sh_basis(normal))[..., None, :]
    at_mirror = (_bands(r)[..., degree] * sh_basis(mirror))[..., None, :]
    return np.asarray(diffuse[..., None] * at_normal + specular[..., None] * at_mirror)


def shade(normal: Array, view: Array, albedo: Array, roughness: Array, metallic: Array) -> Array:
    """Weights dI_c/dL_kc, (..., 3, 16)."""
    return _weights(normal, view, albedo, roughness, metallic).real


def shade_derivatives(
    normal: Array, view: Array, albedo: Array, roughness: Array, metallic: Array
) -> tuple[Array, Array, Array]:
    """Derivatives of the weights by each channel's albedo, by roughness and by metallic."""
    step = 1j * STEP
    by_albedo = _weights(normal, view, albedo + step, roughness, metallic)
    by_roughness = _weights(normal, view, albedo, roughness + step, metallic)
    by_metallic = _weights(normal, view, albedo, roughness, metallic + step)
    return by_albedo.imag / STEP, by_roughness.imag / STEP, by_metallic.imag / STEP


def by_turning(
    normal: Array, view: Array, albedo: Array, roughness: Array, metallic: Array, direction: Array
) -> Array:
    """Derivatives of the weights while the normal turns in a direction in its tangent plane."""
    stepped = normal + 1j * STEP * direction
    return np.asarray(_weights(stepped, view, albedo, roughness, metallic).imag / STEP)


def unpack(x: NDArray[Any], pixels: int) -> tuple[NDArray[Any], ...]:
    """x = [albedo (3 planes of P) | roughness | metallic | lighting (N·16·3)]."""
    albedo = x[: 3 * pixels].reshape(3, pixels).T
    return (
        albedo,
        x[3 * pixels : 4 * pixels],
        x[4 * pixels : 5 * pixels],
        x[5 * pixels :].reshape(-1, 16, 3),
    )


def render(normal: Array, view: Array, x: Array) -> Array:
    """Radiance of every picture, (N, P, 3)."""
    albedo, roughness, metallic, lighting = unpack(x, len(normal))
    weights = shade(normal, view, albedo, roughness, metallic)
    return np.asarray(np.einsum("pck,nkc->npc", weights, lighting, optimize=True))


def squares(e: Array) -> tuple[Array, Array]:
    """φ(e) = e² and its derivative."""
    return e**2, 2 * e


def value_and_grad(images: Array, normal: Array, view: Array, x: Array) -> tuple[float, Array]:
    """Mean over pictures, pixels and channels of (I − T)², and its gradient."""
    albedo, roughness, metallic, lighting = unpack(x, len(normal))
    residual = render(normal, view, x) - images
    # dloss/dw[p,c,k] = Σ_n 2(I−T) L[n,k,c] / samples, then the chain through w.
    scaled = 2 * residual / residual.size
    by_weight = np.einsum("npc,nkc->pck", scaled, lighting)
    at = (normal, view, albedo, roughness, metallic)
    d_albedo, d_roughness, d_metallic = shade_derivatives(*at)
    gradient = [
        np.sum(by_weight * d_albedo, axis=-1).T,
        np.sum(by_weight * d_roughness, axis=(-1, -2)),
        np.sum(by_weight * d_metallic, axis=(-1, -2)),
        np.einsum("npc,pck->nkc", scaled, shade(*at)),
    ]
    return float(np.mean(residual**2)), np.concatenate([np.ravel(block) for block in gradient])


def glass(cosine: Array) -> Array:
    """Fresnel's equations at an index of 1.5, by Snell's law."""
    inside = np.sqrt(1 - (1 - cosine**2) / 1.5**2)
    across = (cosine - 1.5 * inside) / (cosine + 1.5 * inside)
    along = (1.5 * cosine - inside) / (1.5 * cosine + inside)
    return np.asarray((across**2 + along**2) / 2)


def directional(
    normal: Array, view: Array, albedo: Array, roughness: Array, metallic: Array, light: Array
) -> Array:
    """Eqs. 1 and 3-5 as printed, (..., 3): radiance under light of irradiance π from one direction.

    As printed D loses digits where roughness is below 0.1.
    """
    half = unit(view + light)
    n_v = np.maximum(np.sum(normal * view, axis=-1), CLAMP)
    n_l, n_h, v_h = (np.sum(a * b, -1) for a, b in ((normal, light), (normal, half), (view, half)))
    alpha = roughness**2
    d = alpha**2 / (math.pi * (n_h**2 * (alpha**2 - 1) + 1) ** 2)
    g = smith_g1(n_v, roughness) * smith_g1(np.abs(n_l), roughness)
    rho, m = albedo, metallic[..., None]
    f0 = 0.04 * (1 - m) + m * rho
    fresnel = f0 + (1 - f0) * (1 - v_h[..., None]) ** 5
    specular = fresnel * (d * g / (4 * n_v * np.abs(n_l)))[..., None]
    brdf = (1 - fresnel) * (1 - m) * rho / math.pi + specular
    return np.asarray(math.pi * brdf * np.maximum(n_l, 0)[..., None])
