"""Writes `bands.json` and `shading.json`: the model in high precision, from its definitions.

    python tests/data/make_golden.py    writes both files beside this script

Needs mpmath, and of pbrfit the model in high precision. Deterministic: the same files everywhere.
"""

from __future__ import annotations

import json
import math
import random
from pathlib import Path
from typing import Any

from mpmath import mp, mpf

from pbrfit_evaluation.exact_model import (
    CLAMP,
    WORKING_DIGITS,
    band_weights,
    dot,
    shade,
    shade_with_slopes,
    unit,
)

DIGITS = 25
NEAR_CLAMP = "1e-12"  # closer to it, rounding decides on which side a slope by the normal is taken


# --- Band weights -------------------------------------------------------------------------------


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


# --- Shading ------------------------------------------------------------------------------------


def shading_outputs(case: dict[str, Any]) -> dict[str, Any]:
    """Everything that `shading.json` states about a case, from its inputs."""
    normal, view, albedo = ([mpf(s) for s in case[key]] for key in ("normal", "view", "albedo"))
    roughness, metallic = mpf(case["roughness"]), mpf(case["metallic"])
    lighting = [[mpf(s) for s in row] for row in case["lighting"]]
    names = ("radiance", "d_albedo", "d_roughness", "d_metallic")
    out: dict[str, Any] = {key: [] for key in (*names, "weights")}
    for channel in range(3):
        rows = shade_with_slopes(normal, view, albedo[channel], roughness, metallic)
        for name, row in zip(names, rows, strict=True):
            lit = (w * light[channel] for w, light in zip(row, lighting, strict=True))
            out[name].append(mp.fsum(lit))
        out["weights"].append(rows[0])
    cosine = dot(normal, view)
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
        weights, _ = shade(unit(turned), view, albedo[channel], roughness, metallic)
        return mp.fsum(w * light[channel] for w, light in zip(weights, lighting, strict=True))

    return [
        [
            (radiance(channel, axis, step) - radiance(channel, axis, -step)) / (2 * step)
            for axis in range(3)
        ]
        for channel in range(3)
    ]


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
