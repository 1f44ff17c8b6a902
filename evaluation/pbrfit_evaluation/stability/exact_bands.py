"""Band weights h_l(r) to far more digits than a float holds.

Equations 8 to 11 of the paper, with e = r⁴, x = 1 − e and L = ln(2e/(1+e)), each as numerator over
a power of x:

    h_0 = 4/(1+e)
    h_1 = [8eL + 4x] / x²
    h_2 = [12ex + 24e(1+e)L + 4x(1+4e+e²)/(1+e)] / x³
    h_3 = [2(−17e³−24e²+39e+2) + 48e(e²+3e+1)L] / x⁴

Numerators vanish like x², x⁴ and x⁴ as x → 0, so up to five times the digits of x cancel in value
and slope. Here `DIGITS` outlast that; in float64 they do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

DIGITS = 150
"""The float next to 1 loses 93 digits in the slope of h_3: 5 powers of x = 4·10⁻¹⁶ and one more
because that slope vanishes at 1."""

Array = NDArray[np.floating[Any]]
Decimals = NDArray[np.object_]


@dataclass(frozen=True, eq=False)
class ExactBands:
    """Values and slopes, (M, 4) of `Decimal`, at the very floats r, (M,)."""

    r: NDArray[np.float64]
    weight: Decimals
    slope: Decimals


def exact_bands(r: Array) -> ExactBands:
    """Band weights and slopes with `DIGITS` digits."""
    points = np.asarray(r, dtype=np.float64)
    # r⁴ of the smallest float is 10⁻¹²⁹⁴; the exponent must never be what ends the precision.
    with localcontext(Context(prec=DIGITS, Emin=-(10**8), Emax=10**8)):
        rows = np.array([_exact(Decimal(point)) for point in points.tolist()], dtype=object)
    return ExactBands(points, rows[:, 0], rows[:, 1])


def errors_of(found: Array, exact: Decimals) -> NDArray[np.float64]:
    """Signed, found − exact."""
    stated = [[Decimal(value) for value in row] for row in found.tolist()]
    return np.asarray(np.array(stated, dtype=object) - exact, dtype=np.float64)


def _exact(r: Decimal) -> tuple[list[Any], list[Any]]:
    if r == 0:  # limits
        return [Decimal(4)] * 4, [Decimal(0)] * 4
    if r == 1:
        return (
            [Decimal(2), Decimal(1), Decimal(0), Decimal(-1) / 4],
            [Decimal(-4), Decimal(-8) / 3, Decimal(-1), Decimal(0)],
        )
    return closed_form(r, Decimal.ln)


def closed_form(r: Any, ln: Callable[[Any], Any]) -> tuple[list[Any], list[Any]]:
    """Values and slopes of the four bands, for decimals and arrays alike."""
    e = r**4
    one, x = 1 + e, 1 - e
    log = ln(2 * e / one)  # whose derivative by e is 1/(e(1+e))
    numerators = (
        4 / one,
        8 * e * log + 4 * x,
        12 * e * x + 24 * e * one * log + 4 * x * (1 + 4 * e + e * e) / one,
        2 * (-17 * e**3 - 24 * e**2 + 39 * e + 2) + 48 * e * (e * e + 3 * e + 1) * log,
    )
    derivatives = (
        -4 / one**2,
        8 * log + 8 / one - 4,
        12
        - 24 * e
        + 24 * (1 + 2 * e) * log
        + 24
        + 4 * (3 - 6 * e - 3 * e * e) / one
        - 4 * (1 + 3 * e - 3 * e * e - e**3) / one**2,
        2 * (-51 * e**2 - 48 * e + 39)
        + 48 * (3 * e * e + 6 * e + 1) * log
        + 48 * (e * e + 3 * e + 1) / one,
    )
    h, dh = [], []
    for n, d, p in zip(numerators, derivatives, (0, 2, 3, 4), strict=True):
        h.append(n / x**p)
        # d(n/xᵖ)/de = n′/xᵖ + p n/xᵖ⁺¹, since dx/de = −1; and de/dr = 4r³.
        dh.append(4 * r**3 * (d / x**p + (p * n / x ** (p + 1) if p else 0)))
    return h, dh
