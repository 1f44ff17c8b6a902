"""The lobe functions of the principled model by quadrature: a_j, b_j, kappa, and Ebar.

In a pixel's frame (z the normal, view direction v and mirror direction in the xz-plane, x towards
the mirror's side), with alpha = r², GGX D, height-correlated Smith V and x = n·v,

    a_j = ∫ D V n·l [1 − (1−v·h)⁵] Y_j(l) dl        b_j = ∫ D V n·l (1−v·h)⁵ Y_j(l) dl

over n·l > 0, for the ten real spherical harmonics l ≤ 3 that are even in y, j = l(l+1)/2 + m with
0 ≤ m ≤ l. Both are given divided by sinᵐ, sin² = 1 − x², which leaves smooth functions of x up to
x = 1. Ebar = 2 ∫ E x dx with E = 2√π (a_0 + b_0), the part of uniform light that is reflected.

kappa = g/(0.04 a_0 + b_0) with g = ∫ D V n·l F(v·h) Y_0 dl, F by Fresnel's equations for a
refractive index of 1.5: what a dielectric reflects of uniform light, over what it would with
Schlick's approximation.

The half vector h = (sin θ cos φ, sin θ sin φ, cos θ) is what is integrated over: dl = 4 v·h dh, and
D n·h dh = dφ/2π du with tan² θ = alpha² u/(1−u). With n·v = cos θ_v, n·l is
cos θ_v cos 2θ − sin θ_v sin 2θ cos φ: above 0 for every φ below θ₁ = (π/2 − θ_v)/2, for none above
θ₂ = (π/2 + θ_v)/2. So y with tan θ = alpha sinh y is cut at θ₁ and θ₂, into panels one long with
Gauss-Legendre nodes, and the tanh-sinh rule next to the cuts; φ takes the tanh-sinh rule from the
horizon to π.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BAND = np.array([0, 1, 1, 2, 2, 2, 3, 3, 3, 3])
ORDER = np.array([0, 0, 1, 0, 1, 2, 0, 1, 2, 3])
"""l and m of each j."""

NEAR_NORMAL = 0.95
"""Above, functions of x are interpolated: dividing by sinᵐ would lose digits."""

REFRACTIVE_INDEX = 1.5
DIELECTRIC_F0 = ((REFRACTIVE_INDEX - 1) / (REFRACTIVE_INDEX + 1)) ** 2
"""0.04"""


def fresnel(cosine: Array) -> Array:
    """Reflectance of a dielectric, mean of both polarisations, by Fresnel's equations."""
    inside = np.sqrt(REFRACTIVE_INDEX**2 - 1 + cosine * cosine)  # n times the cosine inside
    across = (cosine - inside) / (cosine + inside)
    index = REFRACTIVE_INDEX**2
    along = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (across * across + along * along)


def harmonics(x: Array, z: Array) -> Array:
    """The ten harmonics even in y, (10, ...), at unit vectors with these x and z."""
    xx, zz = x * x, z * z
    x2 = 2 * xx + zz - 1  # x² − y²
    x3 = x * (4 * xx + 3 * zz - 3)  # x³ − 3xy²
    pi = np.pi
    return np.array(
        [
            np.sqrt(1 / (4 * pi)) + 0 * x,
            np.sqrt(3 / (4 * pi)) * z,
            np.sqrt(3 / (4 * pi)) * x,
            np.sqrt(5 / (16 * pi)) * (3 * zz - 1),
            np.sqrt(15 / (4 * pi)) * x * z,
            np.sqrt(15 / (16 * pi)) * x2,
            np.sqrt(7 / (16 * pi)) * z * (5 * zz - 3),
            np.sqrt(21 / (32 * pi)) * x * (5 * zz - 1),
            np.sqrt(105 / (16 * pi)) * z * x2,
            np.sqrt(35 / (32 * pi)) * x3,
        ]
    )


def tanh_sinh(count: int, reach: float = 3.0) -> tuple[Array, Array]:
    """Nodes and weights on [0, 1] for integrands that are rough at the ends."""
    t = np.linspace(-reach, reach, count)
    q = np.exp(-np.pi * np.sinh(np.abs(t)))  # tanh-sinh, without losing the distance to an end
    nodes = np.where(t < 0, q / (1 + q), 1 / (1 + q))
    weights = (t[1] - t[0]) * np.pi * np.cosh(t) * q / (1 + q) ** 2
    return nodes, weights / weights.sum()


class Quadrature:
    """Lobe functions to about 1e-12 (fine) or 1e-9 (not fine; five times as fast)."""

    def __init__(self, fine: bool = True) -> None:
        self._gauss, self._gauss_weights = np.polynomial.legendre.leggauss(12 if fine else 8)
        self._graded, self._graded_weights = tanh_sinh(61 if fine else 33)
        self._around, self._around_weights = tanh_sinh(81 if fine else 41)
        nodes = np.cos(np.pi * (np.arange(20) + 0.5) / 20)
        self._near_normal = 0.8 + 0.2 * nodes

    def functions(self, r: float, x: float) -> Array:
        """(21,): ten a_j/sinᵐ, ten b_j/sinᵐ and kappa at roughness r and x = n·v."""
        if x <= NEAR_NORMAL:
            return self._direct(r, x)
        return self.along_cosine(r, np.array([x]))[0]

    def along_cosine(self, r: float, xs: Array) -> Array:
        """(X, 21) for one roughness."""
        values = np.empty((len(xs), 21))
        near = xs > NEAR_NORMAL
        if near.any():
            known = np.array([self._direct(r, x) for x in self._near_normal])
            values[near] = polynomial_matrix(self._near_normal, xs[near]) @ known
        for i in np.flatnonzero(~near):
            values[i] = self._direct(r, xs[i])
        return values

    def mean_reflectance(self, r: float) -> float:
        """Ebar."""
        nodes, weights = self._graded, self._graded_weights
        if r == 0:
            return 1.0
        values = self.along_cosine(r, np.clip(nodes, 1e-12, 1))
        reflectance = 2 * np.sqrt(np.pi) * (values[:, 0] + values[:, 10])
        return float(2 * np.sum(weights * nodes * reflectance))

    def _direct(self, r: float, x: float) -> Array:
        sine = np.sqrt((1 - x) * (1 + x))
        if r == 0:
            at_mirror = harmonics(np.array(sine), np.array(x))
            grazing = (1 - x) ** 5
            lobes = np.concatenate(((1 - grazing) * at_mirror, grazing * at_mirror))
            glass = fresnel(np.array(x)) * at_mirror[0]
        else:
            lobes, glass = self._integrals(r * r, x, sine)
        kappa = glass / (DIELECTRIC_F0 * lobes[0] + lobes[10])
        return np.append(lobes / sine ** np.concatenate((ORDER, ORDER)), kappa)

    def _integrals(self, alpha: float, x: float, sine: float) -> tuple[Array, Array]:
        """a_j and b_j, (20,), and kappa's numerator."""
        y, weight, cut = self._polar(alpha, x)
        # θ from tan θ = alpha sinh y
        tangent = alpha * np.sinh(y)
        cos = 1 / np.hypot(1, tangent)
        sin = tangent * cos
        weight = weight * 2 * np.tanh(y) / np.cosh(y) ** 2  # du
        with np.errstate(divide="ignore", invalid="ignore"):
            horizon = (cos - sin) * (cos + sin) / (2 * sin * cos) * (x / sine)
        first = np.where(cut, np.arccos(np.clip(horizon, -1, 1)), 0)
        span = np.pi - first
        phi = first[:, None] + span[:, None] * self._around
        cos_phi = np.cos(phi)
        weight = (weight * span / np.pi)[:, None] * self._around_weights
        cos, sin = cos[:, None], sin[:, None]
        v_h = x * cos - sine * sin * cos_phi
        z = np.maximum(x * (cos - sin) * (cos + sin) - 2 * sine * sin * cos * cos_phi, 0)
        lx = 2 * v_h * sin * cos_phi + sine
        # 4 V n·l v·h/n·h
        e = alpha * alpha
        to_view = np.sqrt(x * x * (1 - e) + e)
        weight = weight * 2 * z * v_h / (cos * (z * to_view + x * np.sqrt(z * z * (1 - e) + e)))
        basis = harmonics(lx.ravel(), z.ravel())
        bias = np.maximum(1 - v_h, 0) ** 5
        lobes = (basis @ (weight * (1 - bias)).ravel(), basis @ (weight * bias).ravel())
        return np.concatenate(lobes), basis[0] @ (weight * fresnel(v_h)).ravel()

    def _polar(self, alpha: float, x: float) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Nodes y, their weights, and whether the horizon cuts their circle."""
        half = 0.5 * np.arcsin(x)  # θ₁ = (π/2 − θ_v)/2 = π/2 − θ₂
        low = float(np.arcsinh(np.tan(half) / alpha))
        high = float(np.arcsinh(1 / (np.tan(half) * alpha)))
        y, weight, cut = [], [], []
        for begin, end, is_cut in ((0.0, low, False), (low, high, True)):
            graded = min(1.0, 0.5 * (end - begin))
            pieces = [(end - graded, end, True)]
            if is_cut:
                pieces.append((begin, begin + graded, True))
                begin += graded
            count = int(np.ceil(end - graded - begin - 1e-9))
            edges = np.linspace(begin, end - graded, count + 1)
            pieces += [(a, b, False) for a, b in itertools.pairwise(edges)]
            for a, b, rough in pieces:
                nodes = self._graded if rough else 0.5 * (1 + self._gauss)
                weights = self._graded_weights if rough else 0.5 * self._gauss_weights
                y.append(a + (b - a) * nodes)
                weight.append((b - a) * weights)
                cut.append(np.full(len(nodes), is_cut))
        return np.concatenate(y), np.concatenate(weight), np.concatenate(cut)


def polynomial_matrix(nodes: Array, at: Array) -> Array:
    """Rows that turn values at the nodes into those of their polynomial elsewhere."""
    middle, half = (nodes.max() + nodes.min()) / 2, (nodes.max() - nodes.min()) / 2
    known = np.polynomial.chebyshev.chebvander((nodes - middle) / half, len(nodes) - 1)
    wanted = np.polynomial.chebyshev.chebvander((at - middle) / half, len(nodes) - 1)
    return wanted @ np.linalg.inv(known)
