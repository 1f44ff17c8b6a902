"""Writes `bands.json` and `shading.json`: the model in high precision, from its definitions.

    python tests/data/make_golden.py    writes both files beside this script

Needs mpmath and nothing of pbrfit. Deterministic: the same files on every machine.
"""

from __future__ import annotations

import json
import math
import random
from pathlib import Path
from typing import Any

from mpmath import mp, mpf

DIGITS = 25
WORKING_DIGITS = 80
CLAMP = "1e-4"  # least n·v in G1 and Fresnel
NEAR_CLAMP = "1e-12"  # closer to it, rounding decides on which side a slope by the normal is taken


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


def band_weights_by_quadrature(r: mpf) -> tuple[list[mpf], list[mpf]]:
    """The same by numerical integration of the definition: checks the moments above."""
    e = r**4
    x = 1 - e
    ends = [mpf(0)]
    width = e
    while width < 1:
        ends.append(width)
        width *= 4
    ends.append(mpf(1))
    h, dh_dr = [], []
    for degree in range(4):

        def legendre(s: mpf, degree: int = degree) -> mpf:
            return mp.legendre(degree, 1 - s)

        h.append(8 * e * mp.quad(lambda s, p=legendre: p(s) / (2 * e + x * s) ** 2, ends))
        dh_de = mp.quad(
            lambda s, p=legendre: p(s) * (8 * (1 + e) * s - 16 * e) / (2 * e + x * s) ** 3, ends
        )
        dh_dr.append(4 * r**3 * dh_de)
    return h, dh_dr


def check_band_weights() -> None:
    """Stops unless moments and quadrature agree to 30 digits."""
    for r in (1e-5, 0.01, 0.1, 0.3, 0.4, 0.55, 0.7, 0.9, 0.99, 0.99975, 1 - 1e-9, 1.0):
        for exact, integrated in zip(
            band_weights(mpf(r)), band_weights_by_quadrature(mpf(r)), strict=True
        ):
            for a, b in zip(exact, integrated, strict=True):
                if abs(a - b) > mpf(10) ** -30:
                    raise SystemExit(f"r = {r}: moments {a}, quadrature {b}")


def band_roughnesses() -> list[float]:
    """Where an implementation may go wrong: the ends, likely switches, and a sweep."""
    roughnesses = {0.0, 5e-324, 2.2250738585072014e-308, 1e-300, 1e-160, 1e-81, 1e-80, 1e-40, 1.0}
    roughnesses.update(10.0**exponent for exponent in (-20, -15, -12, -10, -8, -6, -5, -4, -3))
    roughnesses.update(10.0 ** (-9 + 9 * i / 40) for i in range(40))
    roughnesses.update((i + 0.5) / 40 for i in range(40))
    roughnesses.update(1 - 2.0**-bits for bits in range(3, 54, 2))
    roughnesses.add(1 - 2.0**-52)
    # 0.4 and the paper's x = 1 − r⁴ = 10⁻³, from some distance down to neighbouring floats.
    for centre in (0.4, (1 - 1e-3) ** 0.25):
        roughnesses.update(centre + d for d in (-1e-3, -1e-6, -1e-9, 0, 1e-9, 1e-6, 1e-4))
        below = above = centre
        for _ in range(3):
            below, above = math.nextafter(below, 0), math.nextafter(above, 1)
            roughnesses.update((below, above))
    # Other round places and x = 10⁻¹, 10⁻², 10⁻⁴, with both neighbours.
    for centre in (0.1, 0.2, 0.25, 0.3, 0.5, 0.6, 0.7, 0.75, 0.8, 0.9, 0.95, 0.99, 0.999):
        roughnesses.update((math.nextafter(centre, 0), centre, math.nextafter(centre, 1)))
    for x in (1e-1, 1e-2, 1e-4):
        centre = (1 - x) ** 0.25
        roughnesses.update((math.nextafter(centre, 0), math.nextafter(centre, 1)))
    return sorted(roughnesses)


# --- Spherical harmonics ------------------------------------------------------------------------


def sh_basis(direction: list[mpf]) -> list[mpf]:
    """Real SH l ≤ 3 without Condon–Shortley phase, index l(l+1)+m, from the definition.

    Y_lm = N_lm · P_l^(|m|)(z) · {√2 Re, 1, √2 Im}(x + iy)^|m| for m > 0, = 0, < 0, where P_l^(m)
    is the m-th derivative of the Legendre polynomial: sin^m θ cos mφ = Re (x + iy)^m, so no
    angle is ever formed.
    """
    x, y, z = direction
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


def shade(
    normal: list[mpf], view: list[mpf], albedo: mpf, roughness: mpf, metallic: mpf
) -> tuple[list[mpf], list[mpf]]:
    """The 16 weights of one channel, w_k = kd A_l Y_k(n) + ks h_l Y_k(mirror), and dw_k/dr."""
    cosine = sum(a * b for a, b in zip(normal, view, strict=True))
    mirror = [2 * cosine * n - v for n, v in zip(normal, view, strict=True)]
    clamped = max(cosine, mpf(CLAMP))
    f0 = mpf("0.04") * (1 - metallic) + metallic * albedo
    fresnel = f0 + (1 - f0) * (1 - clamped) ** 5
    k = roughness**4 / 2
    g1 = clamped / (clamped * (1 - k) + k)
    # dG1/dk = −x(1−x)/(x(1−k)+k)², dk/dr = 2r³
    dg1_dr = -clamped * (1 - clamped) / (clamped * (1 - k) + k) ** 2 * 2 * roughness**3
    kd = (1 - fresnel) * (1 - metallic) * albedo / mp.pi
    cosine_lobe = (mp.pi, 2 * mp.pi / 3, mp.pi / 4, mpf(0))
    h, dh_dr = band_weights(roughness)
    at_normal, at_mirror = sh_basis(normal), sh_basis(mirror)
    weights, d_roughness = [], []
    for degree in range(4):
        for index in range(degree**2, (degree + 1) ** 2):
            weights.append(
                kd * cosine_lobe[degree] * at_normal[index]
                + fresnel * g1 / 4 * h[degree] * at_mirror[index]
            )
            d_roughness.append(
                fresnel / 4 * (dg1_dr * h[degree] + g1 * dh_dr[degree]) * at_mirror[index]
            )
    return weights, d_roughness


def shading_outputs(case: dict[str, Any]) -> dict[str, Any]:
    """Everything that `shading.json` states about a case, from its inputs."""
    normal, view, albedo = ([mpf(s) for s in case[key]] for key in ("normal", "view", "albedo"))
    roughness, metallic = mpf(case["roughness"]), mpf(case["metallic"])
    lighting = [[mpf(s) for s in row] for row in case["lighting"]]
    # w is a polynomial of degree two in albedo and in metallic: central differences are exact.
    step = mpf(1) / 8
    out: dict[str, Any] = {
        key: [] for key in ("radiance", "d_albedo", "d_roughness", "d_metallic", "weights")
    }
    for channel in range(3):
        rho = albedo[channel]
        weights, d_roughness = shade(normal, view, rho, roughness, metallic)

        def lit(row: list[mpf], channel: int = channel) -> mpf:
            return mp.fsum(w * light[channel] for w, light in zip(row, lighting, strict=True))

        def radiance(d_rho: mpf, d_metallic: mpf, rho: mpf = rho, lit: Any = lit) -> mpf:
            return lit(shade(normal, view, rho + d_rho, roughness, metallic + d_metallic)[0])

        out["radiance"].append(lit(weights))
        out["d_albedo"].append((radiance(step, 0) - radiance(-step, 0)) / (2 * step))
        out["d_metallic"].append((radiance(0, step) - radiance(0, -step)) / (2 * step))
        out["d_roughness"].append(lit(d_roughness))
        out["weights"].append(weights)
    cosine = sum(a * b for a, b in zip(normal, view, strict=True))
    if abs(cosine - mpf(CLAMP)) > mpf(NEAR_CLAMP):
        out["d_normal"] = by_normal(normal, view, albedo, roughness, metallic, lighting)
    return out


def by_normal(
    normal: list[mpf],
    view: list[mpf],
    albedo: list[mpf],
    roughness: mpf,
    metallic: mpf,
    lighting: list[list[mpf]],
) -> list[list[mpf]]:
    """dI_c/dn as a vector in the tangent plane, for each channel.

    Its entry along an axis is the derivative of I_c(n/|n|) along that axis. Central differences,
    exact to the square of their step.
    """
    step = mpf(10) ** -25

    def radiance(channel: int, axis: int, change: mpf) -> mpf:
        turned = list(normal)
        turned[axis] += change
        length = mp.sqrt(sum(a * a for a in turned))
        turned = [a / length for a in turned]
        weights, _ = shade(turned, view, albedo[channel], roughness, metallic)
        return mp.fsum(w * light[channel] for w, light in zip(weights, lighting, strict=True))

    return [
        [
            (radiance(channel, axis, step) - radiance(channel, axis, -step)) / (2 * step)
            for axis in range(3)
        ]
        for channel in range(3)
    ]


def unit(vector: list[float | mpf]) -> list[mpf]:
    """The vector at length one."""
    length = mp.sqrt(sum(mpf(a) ** 2 for a in vector))
    return [mpf(a) / length for a in vector]


def shading_inputs() -> list[dict[str, Any]]:
    """Random pixels and the extremes of every input."""
    draw = random.Random(20250)

    def number(low: float, high: float) -> float:
        return round(low + (high - low) * draw.random(), 6)

    def direction() -> list[mpf]:
        while True:
            vector = [2 * draw.random() - 1 for _ in range(3)]
            if 0.1 < sum(a * a for a in vector) < 1:
                return unit(vector)

    def pixel(
        cosine: float, roughness: float, metallic: float, albedo: list[float], axis: bool = False
    ) -> dict[str, Any]:
        normal = [mpf(0), mpf(0), mpf(1)] if axis else direction()
        aside = [mpf(1), mpf(0), mpf(0)] if axis else direction()
        along = sum(a * b for a, b in zip(normal, aside, strict=True))
        aside = unit([a - along * n for a, n in zip(aside, normal, strict=True)])
        sine = mp.sqrt(1 - mpf(cosine) ** 2)
        view = [mpf(cosine) * n + sine * a for n, a in zip(normal, aside, strict=True)]
        lighting = [
            [number(0.2, 2) if index == 0 else number(-0.9, 0.9) for _ in range(3)]
            for index in range(16)
        ]
        return {
            "normal": strings(normal),
            "view": strings(view),
            "albedo": strings(albedo),
            "roughness": text(mpf(roughness)),
            "metallic": text(mpf(metallic)),
            "lighting": [[str(value) for value in row] for row in lighting],
        }

    def colour() -> list[float]:
        return [number(0, 1) for _ in range(3)]

    cases = [pixel(number(0.05, 1), number(0, 1), number(0, 1), colour()) for _ in range(10)]
    for roughness in (0.0, 1e-80, 1e-4, 0.4, 0.99975, 1 - 2.0**-30, 1.0):
        cases.append(pixel(number(0.1, 1), roughness, number(0, 1), colour()))
    for albedo in ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.5, 1.0]):
        for metallic in (0.0, 1.0):
            cases.append(pixel(number(0.1, 1), number(0, 1), metallic, albedo))
    # Seen from the front, grazing, at the clamp of n·v and beyond it. The grazing ones with a
    # small roughness are axis-aligned: there dG1/dr changes by 1e4 times a change of n·v.
    for cosine, roughness, axis in (
        (1.0, 0.3, False),
        (1.0, 1.0, True),
        (0.01, 0.6, False),
        (0.01, 0.1, True),
        (1e-4, 0.5, False),
        (1e-4, 0.12, True),
        (5e-5, 0.12, True),
        (0.0, 0.8, True),
        (-0.4, 0.45, False),
    ):
        cases.append(pixel(cosine, roughness, number(0, 1), colour(), axis))
    return cases


# --- Files --------------------------------------------------------------------------------------


def text(value: mpf) -> str:
    return str(mp.nstr(value, DIGITS))


def strings(values: list[Any]) -> list[str]:
    return [text(mpf(value)) for value in values]


def write(path: Path, about: str, key: str, rows: list[dict[str, Any]]) -> None:
    """One row a line, so that a change shows as a line."""
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in rows)
    path.write_text(f'{{"about":{json.dumps(about)},\n"{key}":[\n{lines}\n]}}\n', encoding="utf-8")


ROWS = ("weights", "d_normal")  # lists of lists in shading.json


def write_all(folder: Path) -> None:
    rows = []
    for r in band_roughnesses():
        h, dh_dr = band_weights(mpf(r))
        rows.append({"r": r, "h": strings(h), "dh_dr": strings(dh_dr)})
    write(
        folder / "bands.json",
        "GGX zonal band weights h_l(r), l = 0..3, and dh_l/dr at the exact float r; "
        f"decimal strings of {DIGITS} digits. Made by make_golden.py.",
        "rows",
        rows,
    )
    cases = [
        case
        | {
            key: [strings(row) for row in value] if key in ROWS else strings(value)
            for key, value in shading_outputs(case).items()
        }
        for case in shading_inputs()
    ]
    write(
        folder / "shading.json",
        "One pixel under one SH light. lighting[k][c], index k = l(l+1)+m, real SH without "
        "Condon-Shortley phase; radiance[c]; d_albedo[c] = dI_c/d albedo_c; d_roughness[c], "
        "d_metallic[c]; weights[c][k] = dI_c/dL_kc; d_normal[c] = dI_c/dn in the tangent plane, "
        "not stated where n.v is within 1e-12 of the clamp. n.v is clamped to at least 1e-4 in G1 "
        f"and Fresnel, not in the mirror direction. Decimal strings of {DIGITS} digits. "
        "Made by make_golden.py.",
        "cases",
        cases,
    )


def main() -> None:
    mp.dps = WORKING_DIGITS
    check_band_weights()
    write_all(Path(__file__).parent)


if __name__ == "__main__":
    main()
