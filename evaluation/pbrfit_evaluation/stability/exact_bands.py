"""Band weights h_l(r) to far more digits than a float holds, and two rules to compare with.

Equations 8 to 11 of the paper, with e = r⁴, x = 1 − e and L = ln(2e/(1+e)), each as numerator over
a power of x:

    h_0 = 4/(1+e)
    h_1 = [8eL + 4x] / x²
    h_2 = [12ex + 24e(1+e)L + 4x(1+4e+e²)/(1+e)] / x³
    h_3 = [2(−17e³−24e²+39e+2) + 48e(e²+3e+1)L] / x⁴

Numerators vanish like x², x⁴ and x⁴ as x → 0, so up to five times the digits of x cancel in value
and slope. Here `DIGITS` outlast that; in float64 they do not, which is what the paper's Taylor
branch is for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

DIGITS = 150
"""The float next to 1 loses 93 digits in the slope of h_3: 5 powers of x = 4·10⁻¹⁶ and one more
because that slope vanishes at 1."""

SERIES_BELOW = 1e-3
"""Of x: where the paper switches to its Taylor expansion."""

TAYLOR = (
    (1.0, 2 / 3, 11 / 24, 13 / 40),
    (0.0, 1 / 4, 13 / 40, 13 / 40),
    (-1 / 4, 0.0, 1 / 8, 51 / 280),
)
"""Coefficients of 1, x, x², x³ in h_1 to h_3; the paper prints those of h_3."""

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class ExactBands:
    """Values and slopes at the points r, each as a float64 and what that leaves of the number.

    Attributes
    ----------
    r
        (M,) roughness.
    weight, weight_rest, slope, slope_rest
        (M, 4); the number is weight + weight_rest to 30 digits.
    """

    r: NDArray[np.float64]
    weight: NDArray[np.float64]
    weight_rest: NDArray[np.float64]
    slope: NDArray[np.float64]
    slope_rest: NDArray[np.float64]

    def weight_errors(self, found: Array) -> NDArray[np.float64]:
        """Signed, found − h: (M, 4)."""
        return (found.astype(np.float64) - self.weight) - self.weight_rest

    def slope_errors(self, found: Array) -> NDArray[np.float64]:
        """Signed, found − dh/dr: (M, 4)."""
        return (found.astype(np.float64) - self.slope) - self.slope_rest


def exact_bands(r: Array) -> ExactBands:
    """Band weights and slopes at the very floats in r, (M,), by `decimal` with `DIGITS` digits."""
    points = np.asarray(r, dtype=np.float64)
    # r⁴ of the smallest float is 10⁻¹²⁹⁴; the exponent must never be what ends the precision.
    with localcontext(Context(prec=DIGITS, Emin=-(10**8), Emax=10**8)):
        rows = [_exact(Decimal(float(point))) for point in points]
        weight, weight_rest = _split([h for h, _ in rows])
        slope, slope_rest = _split([dh for _, dh in rows])
    return ExactBands(points, weight, weight_rest, slope, slope_rest)


def _exact(r: Decimal) -> tuple[list[Decimal], list[Decimal]]:
    if r == 0:  # limits
        return [Decimal(4)] * 4, [Decimal(0)] * 4
    if r == 1:
        return (
            [Decimal(2), Decimal(1), Decimal(0), Decimal(-1) / 4],
            [Decimal(-4), Decimal(-8) / 3, Decimal(-1), Decimal(0)],
        )
    e = r**4
    x = 1 - e
    numerators, derivatives = _closed_form(e, (2 * e / (1 + e)).ln())
    h = [n / x**p for n, p in zip(numerators, _POWERS, strict=True)]
    # d(n/xᵖ)/de = n′/xᵖ + p n/xᵖ⁺¹, since dx/de = −1; and de/dr = 4r³.
    dh = [
        4 * r**3 * (d / x**p + p * n / x ** (p + 1))
        for n, d, p in zip(numerators, derivatives, _POWERS, strict=True)
    ]
    return h, dh


_POWERS = (0, 2, 3, 4)
"""Of x, below each band's numerator."""


def _closed_form(e: Any, log: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Numerators and their derivatives by e, for decimals and arrays alike.

    `log` is ln(2e/(1+e)), whose derivative is 1/(e(1+e)).
    """
    one = 1 + e
    x = 1 - e
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
    return numerators, derivatives


def _split(rows: Sequence[Sequence[Decimal]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nearest floats, and what they leave."""
    nearest = [[float(value) for value in row] for row in rows]
    rest = [
        [float(value - Decimal(near)) for value, near in zip(row, nears, strict=True)]
        for row, nears in zip(rows, nearest, strict=True)
    ]
    return np.array(nearest), np.array(rest)


def paper_rule(r: Array, dtype: type[np.floating[Any]]) -> tuple[Array, Array]:
    """Values and slopes, (M, 4) each, by the paper's rule in the given precision.

    The closed forms, and for h_1 to h_3 a Taylor expansion where x < 10⁻³. The paper computes in
    float64. Slopes are what differentiating the program gives.
    """
    r = np.asarray(r).astype(dtype)
    e = r**4
    x = 1 - e
    with np.errstate(all="ignore"):  # what is lost to underflow and 0/0 is what the report shows
        numerators, derivatives = _closed_form(e, np.log(2 * e / (1 + e)))
        by_e = [
            d / x**p + (p * n / x ** (p + 1) if p else 0)
            for n, d, p in zip(numerators, derivatives, _POWERS, strict=True)
        ]
        h = np.stack([n / x**p for n, p in zip(numerators, _POWERS, strict=True)], axis=-1)
        dh = np.stack([4 * r**3 * d for d in by_e], axis=-1)
    near_one = x < SERIES_BELOW
    for band, (c0, c1, c2, c3) in enumerate(np.array(TAYLOR, dtype=dtype), start=1):
        h[near_one, band] = (c0 + x * (c1 + x * (c2 + x * c3)))[near_one]
        dh[near_one, band] = (-4 * r**3 * (c1 + x * (2 * c2 + x * 3 * c3)))[near_one]
    return h, dh
