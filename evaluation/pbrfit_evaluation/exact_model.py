"""The paper's model in as many digits as mpmath is told, from the definitions in docs/model.md.

Shares nothing with the package. Import it inside functions: only tests and one suite need mpmath.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from mpmath import mp, mpf

WORKING_DIGITS = 80
CLAMP = "1e-4"  # least n·v in G1 and Fresnel

Vector = Sequence[mpf]


# --- Band weights -------------------------------------------------------------------------------
#
# Definition: h_l = 8e ∫₀¹ P_l(u) / (1 + e − (1−e)u)² du with e = r⁴.
# With s = 1 − u and x = 1 − e the denominator is D = 2e + xs, hence
#
#     h_l     = 8e ∫₀¹ P_l(1−s) / D² ds
#     dh_l/de = 8 ∫₀¹ P_l(1−s) ((1+e)s − 2e) / D³ ds          (dD/de = 2 − s)
#
# P_l(1−s) is a polynomial in s, so all that is needed are the moments
#
#     J_k = ∫ s^k/D,   M_k = ∫ s^k/D²,   K_k = ∫ s^k/D³
#
# which follow from s = (D − 2e)/x: each moment of order k comes from those of order k−1.
# The recurrence cancels about 4·log10(1/x) digits near r = 1 and the derivative 2·log10(1/e)
# near r = 0; the working precision is raised by more than that.

LEGENDRE_IN_S = (  # P_l(1−s), coefficients of s⁰, s¹, …
    (1,),
    (1, -1),
    (1, -3, mpf(3) / 2),
    (1, -6, mpf(15) / 2, mpf(-5) / 2),
)


@lru_cache(16)
def band_weights(r: mpf) -> tuple[list[mpf], list[mpf]]:
    """h_l(r) and dh_l/dr for l = 0..3."""
    if r == 0:  # the limit: the lobe is a delta, and dh/dr ~ r³ ln r
        return [mpf(4)] * 4, [mpf(0)] * 4
    with mp.workdps(30):
        lost = -8 * mp.log10(r)
        if r != 1:
            lost -= 6 * mp.log10(1 - r)
        digits = WORKING_DIGITS + int(lost)
    with mp.workdps(digits):
        e = r**4
        x = 1 - e
        if x == 0:  # D = 2 throughout
            J = [mpf(1) / (2 * (k + 1)) for k in range(5)]
            M = [value / 2 for value in J]
            K = [value / 4 for value in J]
        else:
            J = [mp.log((1 + e) / (2 * e)) / x]
            M = [1 / (2 * e * (1 + e))]
            K = [(1 + 3 * e) / (8 * e**2 * (1 + e) ** 2)]
            for k in range(1, 5):
                J.append((mpf(1) / k - 2 * e * J[k - 1]) / x)
                M.append((J[k - 1] - 2 * e * M[k - 1]) / x)
                K.append((M[k - 1] - 2 * e * K[k - 1]) / x)
        h, dh_dr = [], []
        for polynomial in LEGENDRE_IN_S:
            h.append(8 * e * sum(c * M[k] for k, c in enumerate(polynomial)))
            dh_de = 8 * sum(
                c * ((1 + e) * K[k + 1] - 2 * e * K[k]) for k, c in enumerate(polynomial)
            )
            dh_dr.append(4 * r**3 * dh_de)
    return h, dh_dr


# --- Spherical harmonics ------------------------------------------------------------------------


@lru_cache(16)
def sh_basis(x: mpf, y: mpf, z: mpf) -> list[mpf]:
    """Real SH l ≤ 3 without Condon–Shortley phase, index l(l+1)+m, from the definition.

    Y_lm = N_lm · P_l^(|m|)(z) · {√2 Re, 1, √2 Im}(x + iy)^|m| for m > 0, = 0, < 0, where P_l^(m)
    is the m-th derivative of the Legendre polynomial: sin^m θ cos mφ = Re (x + iy)^m, so no
    angle is ever formed.
    """
    basis = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            order = abs(m)
            # P_l as a polynomial in z, ascending coefficients, then differentiated.
            polynomial = [mpf(0)] * (degree + 1)
            for k in range(degree // 2 + 1):
                polynomial[degree - 2 * k] = (
                    mpf((-1) ** k)
                    * mp.binomial(degree, k)
                    * mp.binomial(2 * degree - 2 * k, degree)
                    / 2**degree
                )
            for _ in range(order):
                polynomial = [k * c for k, c in enumerate(polynomial)][1:]
            norm = mp.sqrt(
                (2 * degree + 1)
                / (4 * mp.pi)
                * mp.factorial(degree - order)
                / mp.factorial(degree + order)
            )
            power = mp.mpc(x, y) ** order
            azimuth = mpf(1) if m == 0 else mp.sqrt(2) * (power.real if m > 0 else power.imag)
            basis.append(norm * azimuth * sum(c * z**k for k, c in enumerate(polynomial)))
    return basis


# --- Shading ------------------------------------------------------------------------------------


def dot(a: Vector, b: Vector) -> mpf:
    """Scalar product."""
    return sum(x * y for x, y in zip(a, b, strict=True))


def unit(vector: Sequence[float | mpf]) -> list[mpf]:
    """The vector at length one."""
    exact = [mpf(a) for a in vector]
    length = mp.sqrt(dot(exact, exact))
    return [a / length for a in exact]


def masking(cosine: mpf, roughness: mpf) -> tuple[mpf, mpf]:
    """G1(x), and dG1/dr: dG1/dk = −x(1−x)/(x(1−k)+k)², dk/dr = 2r³."""
    k = roughness**4 / 2
    below = cosine * (1 - k) + k
    return cosine / below, -cosine * (1 - cosine) / below**2 * 2 * roughness**3


def shade(
    normal: Vector, view: Vector, albedo: mpf, roughness: mpf, metallic: mpf
) -> tuple[list[mpf], list[mpf]]:
    """The 16 weights of one channel, w_k = kd A_l Y_k(n) + ks h_l Y_k(mirror), and dw_k/dr."""
    cosine = dot(normal, view)
    mirror = [2 * cosine * n - v for n, v in zip(normal, view, strict=True)]
    clamped = max(cosine, mpf(CLAMP))
    f0 = mpf("0.04") * (1 - metallic) + metallic * albedo
    fresnel = f0 + (1 - f0) * (1 - clamped) ** 5
    g1, g1_slope = masking(clamped, roughness)
    kd = (1 - fresnel) * (1 - metallic) * albedo / mp.pi
    cosine_lobe = (mp.pi, 2 * mp.pi / 3, mp.pi / 4, mpf(0))
    h, dh_dr = band_weights(roughness)
    at_normal, at_mirror = sh_basis(*normal), sh_basis(*mirror)
    weights, d_roughness = [], []
    for degree in range(4):
        for index in range(degree**2, (degree + 1) ** 2):
            weights.append(
                kd * cosine_lobe[degree] * at_normal[index]
                + fresnel * g1 / 4 * h[degree] * at_mirror[index]
            )
            d_roughness.append(
                fresnel / 4 * (g1_slope * h[degree] + g1 * dh_dr[degree]) * at_mirror[index]
            )
    return weights, d_roughness


def shade_with_slopes(
    normal: Vector, view: Vector, albedo: mpf, roughness: mpf, metallic: mpf
) -> list[list[mpf]]:
    """The 16 weights of one channel, and their derivatives by albedo, roughness and metallic."""
    # w is a polynomial of degree two in albedo and in metallic: central differences are exact.
    step = mpf(1) / 8

    def slope(*change: mpf) -> list[mpf]:
        above, below = (
            shade(normal, view, albedo + s * change[0], roughness, metallic + s * change[1])[0]
            for s in (step, -step)
        )
        return [(a - b) / (2 * step) for a, b in zip(above, below, strict=True)]

    weights, by_roughness = shade(normal, view, albedo, roughness, metallic)
    return [weights, slope(1, 0), by_roughness, slope(0, 1)]


def lamp_parts(normal: Vector, view: Vector, light: Vector, roughness: mpf) -> list[mpf]:
    """n·l, (1 − v·h)⁵ and π D G1 G1/(4 n·v) of a lamp; 0 where n·l ≤ 0.

    From "Hard light" in docs/model.md. The normal is normalised, because D depends on 1 − (n·h)².
    """
    normal = unit(normal)
    below = dot(normal, light)
    if below <= 0:
        return [mpf(0)] * 3
    half = unit([a + b for a, b in zip(view, light, strict=True)])
    clamped, alpha = max(dot(normal, view), mpf(CLAMP)), roughness**2
    lobe = mpf(0)  # a mirror does not show a light without extent
    if alpha:
        lobe = (alpha / (dot(normal, half) ** 2 * (alpha**2 - 1) + 1)) ** 2
    masked = masking(clamped, roughness)[0] * masking(below, roughness)[0]
    return [below, (1 - dot(view, half)) ** 5, lobe * masked / (4 * clamped)]


def lamp_radiance(parts: Vector, albedo: mpf, metallic: mpf) -> mpf:
    """π f_r (n·l) of one channel."""
    below, schlick, lobe = parts
    f0 = mpf("0.04") * (1 - metallic) + metallic * albedo
    fresnel = f0 + (1 - f0) * schlick
    return (1 - fresnel) * (1 - metallic) * albedo * below + fresnel * lobe
