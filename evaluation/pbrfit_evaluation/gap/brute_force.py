"""Reflection integrals by brute force: the paper's (eq. 1 with eqs. 3-5), and any GGX lobe.

One pixel in its own frame: n = z, v = (√(1 − (n·v)²), 0, n·v). Its radiance is Σ_k w_k L_k with

    w_k = ∫ f(v, l) Y_k(l) (n·l) dl over n·l > 0,
    f = (1−F)(1−m)ρ/π + D(h) G1(n·v) G1(n·l) F / (4 (n·v)(n·l)),  h = (v+l)/|v+l|.

Schlick's F = F0 + (1−F0) s with s = (1−v·h)⁵ is linear in F0, so three integrals serve every
material (F0 = 0.04(1−m) + mρ):

    w = F0 a + b + (1−F0)(1−m)ρ/π c,
    a = ∫ D G1 G1/(4 n·v) (1−s) Y dl,  b = ∫ D G1 G1/(4 n·v) s Y dl,  c = ∫ (1−s) Y (n·l) dl.

**The lobe (a, b)** is as narrow as α = r², so it is integrated over half vectors. With
u = tan²θ/(α² + tan²θ), the cumulative distribution of D cosθ over the angle θ between n and h,

    D(h) cosθ dh = du dφ/2π,  dl = 4 (v·h) dh,
    ∫ D G1 G1/(4 n·v) g dl = ∫ G1(n·v) G1(n·l) (v·h)/(n·v cosθ) g du dφ/2π:

nothing of this is narrow. What is left is the border n·l = 0. As n·l = 2 (v·h) cosθ − n·v,

    n·l > 0  ⇔  cosφ > −cot θ_v cot 2θ,

with θ_v the angle of v. So φ runs over the whole circle for θ < θ₁ = (π/2 − θ_v)/2, over a part of
it up to θ₂ = (π/2 + θ_v)/2, and nothing lies beyond. The integrand is smooth within these limits,
but has square roots at θ₁ and θ₂ and a thin layer at n·l = 0, where G1 falls to 0 within r⁴/2.

**The diffuse term (c)** has no such limits in l itself: n·l over [0, 1] and φ over the circle. Only
at l = −v, for n·v = 0, is v·h not smooth.

All of these sit at ends of intervals, which is what tanh-sinh quadrature is made for: its nodes
crowd towards the ends so fast that any integrable singularity there is passed over, and its error
falls exponentially with the number of nodes.

The masking is an argument, so that `principled.py` integrates another BRDF by the same rule.

H. Takahasi, M. Mori: Double exponential formulas for numerical integration. Publ. RIMS 9, 1974.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pbrfit._core import InputError
from pbrfit.model.geometry import unit
from pbrfit.model.reflection import sh_basis
from pbrfit_evaluation.arrays import Array

Masking = Callable[[float, Array, float], Array]
"""G of n·v, n·l and roughness, the joint masking of both directions."""

Fresnel = Callable[[Array], Array]
"""v·h -> one factor of the integrand, or a stack of them (F, ...)."""

NODES = 64
"""Number of the coarser rule's nodes, in each direction and panel; the other has twice as many."""

REACH = 3.3
"""Where tanh-sinh is cut off, in its own variable: the nodes there are 10⁻¹⁸ of the interval from
its ends."""


@dataclass(frozen=True, eq=False)
class Response:
    """The paper's reflection at one (r, n·v) of SH light, in the pixel's own frame.

    `base`, `grazing`, `diffuse` are a, b and c above, (16,); the specular response is
    F0 base + grazing. `error` is the largest change of any when the number of nodes is doubled.
    The values are those of the finer rule, so their error is smaller.
    """

    base: Array
    grazing: Array
    diffuse: Array
    error: float

    def weights(self, albedo: Array, metallic: Array) -> Array:
        """(..., 3, 16) as `kernel.shade` gives: albedo (..., 3) in [0, 1], metallic (...,)."""
        rho = np.asarray(albedo, dtype=np.float64)[..., None]
        m = np.asarray(metallic, dtype=np.float64)[..., None, None]
        f0 = 0.04 * (1 - m) + m * rho
        body = (1 - f0) * (1 - m) * rho / np.pi
        return np.asarray(f0 * self.base + self.grazing + body * self.diffuse)


@lru_cache(maxsize=4096)
def respond(roughness: float, n_dot_v: float) -> Response:
    """Integrate the paper's BRDF at a roughness and a view angle, both in (0, 1].

    Raises InputError if roughness or n·v lies outside its range.
    """
    (base, grazing), lobe_error = integrated_lobe(roughness, n_dot_v, _smith, schlick_parts)
    coarse, fine = (_body(n_dot_v, count) for count in (NODES, 2 * NODES))
    return Response(base, grazing, fine, max(lobe_error, float(np.abs(fine - coarse).max())))


def integrated_lobe(
    roughness: float, n_dot_v: float, masking: Masking, fresnel: Fresnel
) -> tuple[Array, float]:
    """`integrate_lobe` by twice `NODES`, and the largest change to there.

    Raises InputError unless roughness and n·v are in (0, 1].
    """
    for name, value in (("roughness", roughness), ("n_dot_v", n_dot_v)):
        if not 0 < value <= 1:
            raise InputError(f"{name}: expected a number in (0, 1], found {value!r}")
    coarse, fine = (
        integrate_lobe(roughness, n_dot_v, count, masking, fresnel) for count in (NODES, 2 * NODES)
    )
    return fine, float(np.abs(fine - coarse).max())


def view(n_dot_v: float) -> Array:
    """(3,) unit vector to the camera in the pixel's frame."""
    return np.array([np.sqrt((1 - n_dot_v) * (1 + n_dot_v)), 0.0, n_dot_v])


def rings(count: int) -> tuple[tuple[float, ...], Array]:
    """Values of n·v, and their shares of a sphere's picture.

    A pixel's share is 2 (n·v) d(n·v). The error's square rises like 1/(n·v)² towards the rim, and
    only levels out where n·v falls below r⁴/2, so the nodes crowd there: n·v = t³, Gauss-Legendre
    in t.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    t = (1 + nodes) / 2
    return tuple((t**3).tolist()), 3 * weights * t**5


def integrate_lobe(
    roughness: float, n_dot_v: float, nodes: int, masking: Masking, fresnel: Fresnel
) -> Array:
    """∫ D G/(4 n·v) g Y dl over n·l > 0, (F, 16), for each of the F factors g of `fresnel`.

    In the pixel's own frame; 0 for the functions odd in y. `nodes` are those in each direction and
    panel.
    """
    at, weights = _tanh_sinh(nodes)
    v = view(n_dot_v)
    alpha = roughness**2
    view_angle = np.arctan2(v[0], v[2])
    whole, end = (np.pi / 2 - view_angle) / 2, (np.pi / 2 + view_angle) / 2
    total: Array | float = 0.0
    for low, high in ((0.0, whole), (whole, end)):
        # 1 − u = α²/(α² + tan²θ) = (α cosθ)²/((α cosθ)² + sin²θ), and only it keeps its digits
        # where the lobe is narrow.
        first, last = (_beyond(alpha, theta) for theta in (low, high))
        beyond = last + (first - last) * at[::-1]
        sine = alpha * np.sqrt((1 - beyond) / (beyond + alpha**2 * (1 - beyond)))
        cosine = np.sqrt(beyond / (beyond + alpha**2 * (1 - beyond)))
        limit = np.full_like(sine, np.pi)
        if low > 0:
            # −cot θ_v cot 2θ with 2θ from its sine and cosine.
            border = -v[2] * (cosine**2 - sine**2) / np.maximum(v[0] * 2 * sine * cosine, 1e-300)
            limit = np.arccos(np.clip(border, -1, 1))
        azimuth = limit[:, None] * at
        h = _directions(sine, cosine, azimuth)
        v_dot_h = h @ v
        l = 2 * v_dot_h[..., None] * h - v  # noqa: E741
        n_dot_l = np.maximum(l[..., 2], 0.0)
        # Twice, because φ and −φ are alike but for the functions that are odd in y, which cancel.
        element = (first - last) * weights[::-1, None] * limit[:, None] * weights / np.pi
        element *= masking(n_dot_v, n_dot_l, roughness)
        element *= v_dot_h / (n_dot_v * cosine[:, None])
        total = total + _even(l, fresnel(v_dot_h) * element)
    return np.asarray(total)


def _body(n_dot_v: float, nodes: int) -> Array:
    """(16,): c."""
    n_dot_l, weights = _tanh_sinh(nodes)
    azimuth = np.broadcast_to(np.pi * n_dot_l, (nodes, nodes))
    l = _directions(np.sqrt((1 - n_dot_l) * (1 + n_dot_l)), n_dot_l, azimuth)  # noqa: E741
    v_dot_h = np.sqrt(np.maximum((1 + l @ view(n_dot_v)) / 2, 0.0))
    element = 2 * np.pi * weights[:, None] * weights * n_dot_l[:, None] * (1 - _schlick(v_dot_h))
    return np.asarray(_even(l, element[None])[0])


def _directions(sine: Array, cosine: Array, azimuth: Array) -> Array:
    """(M, M, 3): a ring for each sine and cosine (M,), at azimuths (M, M)."""
    ring = np.broadcast_to(cosine[:, None], azimuth.shape)
    around = sine[:, None]
    return np.stack([around * np.cos(azimuth), around * np.sin(azimuth), ring], axis=-1)


def _even(directions: Array, elements: Array) -> Array:
    """Σ element Y_k(direction) for each stack of elements; 0 for the functions odd in y."""
    basis = sh_basis(unit(directions).reshape(-1, 3))
    basis[:, [1, 4, 5, 9, 10, 11]] = 0.0  # Y_lm with m < 0
    return np.asarray(elements.reshape(len(elements), -1) @ basis)


def _beyond(alpha: float, theta: float) -> float:
    """1 − u: the share of D cosθ at angles larger than theta."""
    wide, high = (alpha * np.cos(theta)) ** 2, np.sin(theta) ** 2
    return float(wide / (wide + high))


def _smith(n_dot_v: float, n_dot_l: Array, roughness: float) -> Array:
    """Smith's G1 of both directions with the paper's k = α²/2 = r⁴/2."""
    k = roughness**4 / 2
    of_view = n_dot_v / (n_dot_v * (1 - k) + k)
    return np.asarray(of_view * n_dot_l / (n_dot_l * (1 - k) + k))


def _schlick(v_dot_h: Array) -> Array:
    return np.asarray((1 - np.minimum(v_dot_h, 1.0)) ** 5)


def schlick_parts(v_dot_h: Array) -> Array:
    """(2, ...): what F0 is multiplied with, and what is added."""
    grazing = _schlick(v_dot_h)
    return np.stack([1 - grazing, grazing])


def _tanh_sinh(nodes: int) -> tuple[Array, Array]:
    """Nodes in [0, 1] and weights: x = (1 + tanh(π/2 sinh t))/2 at equal steps of t."""
    t = np.linspace(-REACH, REACH, nodes)
    x = 1 / (1 + np.exp(-np.pi * np.sinh(t)))
    slope = np.pi * np.cosh(t) * x / (1 + np.exp(np.pi * np.sinh(t)))
    return x, (t[1] - t[0]) * slope
