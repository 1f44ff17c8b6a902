"""Print the Chebyshev coefficients in `rust/reflectance/ggx.rs` (needs mpmath).

Interpolates h_l(r) and dh_l/dr, l = 1, 2, 3, at Chebyshev nodes of [0.4, 1] in 60-digit
arithmetic. Value and derivative are fitted apart: differentiating the series of the value would
cost two digits. The last line states the largest error of the rounded coefficients, evaluated
exactly, over a dense sweep.
"""

from __future__ import annotations

from collections.abc import Callable

import mpmath as mp

mp.mp.dps = 60
LOWER, UPPER, DEGREE = mp.mpf("0.4"), mp.mpf(1), 24


def moment(j: int, r: mp.mpf) -> mp.mpf:
    """2 (1-t²) times the integral over [0,1] of u^j / (1 - t u)², t = (1-e)/(1+e), e = r⁴."""
    e = r**4
    t = (1 - e) / (1 + e)
    return 2 * (1 - t * t) * mp.quad(lambda u: u**j / (1 - t * u) ** 2, [0, mp.mpf("0.5"), 1])


def band(l: int, r: mp.mpf) -> mp.mpf:
    """h_l(r), eqs. 8-11 in integral form."""
    if l == 1:
        return moment(1, r)
    if l == 2:
        return (3 * moment(2, r) - moment(0, r)) / 2
    return (5 * moment(3, r) - 3 * moment(1, r)) / 2


def coefficients(f: Callable[[mp.mpf], mp.mpf]) -> list[mp.mpf]:
    """Chebyshev coefficients of the interpolant of f on [LOWER, UPPER]."""
    n = DEGREE + 1
    angles = [mp.pi * (k + mp.mpf("0.5")) / n for k in range(n)]
    values = [f((LOWER + UPPER) / 2 + (UPPER - LOWER) / 2 * mp.cos(a)) for a in angles]
    series = [
        2 * mp.fsum(v * mp.cos(j * a) for v, a in zip(values, angles, strict=True)) / n
        for j in range(n)
    ]
    series[0] /= 2
    return series


def evaluate(series: list[mp.mpf], r: mp.mpf) -> mp.mpf:
    """Sum of the series at r."""
    s = (2 * r - LOWER - UPPER) / (UPPER - LOWER)
    return mp.fsum(c * mp.chebyt(j, s) for j, c in enumerate(series))


def main() -> None:
    """Print both arrays and the error."""
    worst = mp.mpf(0)
    step = mp.mpf(10) ** -25  # the derivative by a complex step is exact in 60 digits
    for name, order in (("BAND", 0), ("BAND_SLOPE", 1)):
        bands = []
        for l in (1, 2, 3):
            f = (
                (lambda r, l=l: band(l, r))
                if order == 0
                else (lambda r, l=l: mp.im(band(l, mp.mpc(r, step))) / step)
            )
            series = [mp.mpf(float(c)) for c in coefficients(f)]
            bands.append(series)
            for i in range(101):
                r = LOWER + (UPPER - LOWER) * i / 100
                worst = max(worst, abs(evaluate(series, r) - f(r)))
        print(f"const {name}: [[f64; 3]; {DEGREE + 1}] = [")
        for of_term in zip(*bands, strict=True):
            print(f"    [{', '.join(repr(float(c)) for c in of_term)}],")
        print("];")
    print(f"// largest error of the rounded series: {mp.nstr(worst, 3)}")


if __name__ == "__main__":
    main()
