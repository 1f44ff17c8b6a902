"""Random lightings that spherical harmonics represent exactly and that are positive everywhere.

A lighting is an ambient term plus lobes. A lobe about the unit vector d is a polynomial p(u) of
u = ω·d that is non-negative on [-1, 1] and of a degree no higher than the order of the harmonics.
In Legendre polynomials p(u) = Σ_l a_l P_l(u), and the addition theorem
P_l(ω·d) = 4π/(2l+1) Σ_m Y_lm(d) Y_lm(ω) gives its coefficients without any truncation:

    L_lm = 4π/(2l+1) a_l Y_lm(d).

An ambient radiance c is the lobe p = c. A sum of non-negative lobes and a positive ambient term is
positive, so no picture of a synthetic scene is lit by negative light.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import poly2leg

from pbrfit._core import InputError
from pbrfit.model.geometry import unit
from pbrfit.model.reflection import sh_basis
from pbrfit.values.arrays import Array

# Powers of u, lowest first, by order; every lobe is 1 at u = 1.
SHARP = {
    3: (1 / 18, 5 / 18, 8 / 18, 4 / 18),
    2: (1 / 9, 4 / 9, 4 / 9),
}  # (1+u)(1+2u)²/18, (1+2u)²/9
SOFT = {3: (1 / 8, 3 / 8, 3 / 8, 1 / 8), 2: (1 / 4, 2 / 4, 1 / 4)}  # ((1+u)/2)³, ((1+u)/2)²

# Linear Rec.709: filament, warm LED, flash, overcast sky, blue sky.
_LAMPS = np.array(
    [[1.0, 0.55, 0.24], [1.0, 0.74, 0.48], [1.0, 0.96, 0.9], [0.82, 0.92, 1.0], [0.5, 0.72, 1.0]]
)
_SATURATED = 0.15  # the share of lobes with a strong, arbitrary hue
_FILLS = 3  # weaker lobes beside the key light
_TOWARDS_VIEWER = np.array([0.0, 0.3, 0.45])  # added to a uniform direction: from above and before
_MAX_CONDITION = 3000.0


def random_lights(count: int, rng: np.random.Generator, sh_order: int = 3) -> Array:
    """Draw lightings: ambient light, one key light and a few weaker fills, each of its own colour.

    The key lights of a set spread over the sphere on a lattice, the fills are independent, and all
    lean towards +Y and +Z, where the light that visible surfaces receive comes from. The same state
    of `rng` gives the same lightings; with `sh_order` 2 the coefficients of band 3 are exactly
    zero. Raises InputError when `count` is below 1 or `sh_order` is neither 2 nor 3.

    Returns (N, 16, 3): lighting, coefficient, channel. Radiance in linear Rec.709, positive in
    every direction, about 1 at the peak of the key light. Real SH without Condon-Shortley phase,
    index l(l+1)+m.

    A random square matrix is now and then close to singular, and such lights leave their own scale
    undetermined; a set is drawn again while the (N, 16) matrix of a channel has a condition number
    (largest over smallest non-zero singular value) above 3000. Of 16 lights of order 3 it is
    then 120 to 3000, with a median of 540 over 600 channels; of order 2, 10 to 50.
    """
    if count < 1:
        raise InputError(f"count: expected at least 1 lighting, found {count}")
    if sh_order not in (2, 3):
        raise InputError(f"sh_order: expected 2 or 3, found {sh_order}")
    used = (sh_order + 1) ** 2
    while True:
        lights = _draw(count, rng, sh_order)
        if condition(lights[:, :used]) <= _MAX_CONDITION:
            return lights


def condition(lights: Array) -> float:
    """Condition number of the light matrix (N, K), the worst of the channels of (N, K, 3)."""
    return float(np.linalg.cond(np.moveaxis(lights, -1, 0)).max())


def _draw(count: int, rng: np.random.Generator, sh_order: int) -> Array:
    """One set of lightings, (N, 16, 3)."""
    shape = (count, 1 + _FILLS)
    directions = unit(rng.normal(size=(*shape, 3)))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    # Of key lights a Fibonacci spiral: spread evenly over the sphere.
    i = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5)) * i
    ring = np.sqrt(1 - z**2)
    directions[:, 0] = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=-1) @ turn
    directions = unit(directions + _TOWARDS_VIEWER)

    strength = rng.uniform(0.1, 0.45, size=shape)
    strength[:, 0] = 1.0
    colors = strength[..., None] * random_colors(shape, rng)

    sharp = rng.random(shape) < 0.5
    sharp[:, 0] = True
    lobes = np.where(sharp[..., None], zonal(SHARP[sh_order]), zonal(SOFT[sh_order]))
    lights = np.einsum("nlk,nlc->nkc", lobes * sh_basis(directions), colors)

    ambient = rng.uniform(0.02, 0.1, size=(count, 1)) * random_colors((count,), rng)
    lights[:, 0] += np.sqrt(4 * np.pi) * ambient  # Y_00 = 1/√(4π)
    return np.asarray(lights)


def random_colors(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Colours (..., 3) between two neighbouring lamps, or saturated; the largest channel is 1."""
    position = rng.uniform(0, len(_LAMPS) - 1, size=shape)
    lower = np.minimum(position.astype(np.int64), len(_LAMPS) - 2)
    blend = (position - lower)[..., None]
    lamps = (1 - blend) * _LAMPS[lower] + blend * _LAMPS[lower + 1]
    hue = 0.08 + 0.92 * rng.random((*shape, 3)) ** 2
    colors = np.where(rng.random(shape)[..., None] < _SATURATED, hue, lamps)
    return np.asarray(colors / colors.max(axis=-1, keepdims=True))


def zonal(polynomial: tuple[float, ...]) -> Array:
    """(16,) factors 4π/(2l+1) a_l of a lobe, repeated over the orders m of each band."""
    bands = np.zeros(4)
    bands[: len(polynomial)] = poly2leg(polynomial)
    orders = 2 * np.arange(4) + 1
    return np.repeat(4 * np.pi / orders * bands, orders)
